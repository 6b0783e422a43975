//! The audit log.

use jostle_proto::{Audit, AuditLine, AuditOutcome};

use crate::audit::AuditBody;
use crate::store::{self, AuditPage};

pub fn audit(page: AuditPage) -> Audit {
    let (mut lines, mut damaged) = (Vec::new(), page.damaged);
    for stored in page.lines {
        match line(stored) {
            Some(line) => lines.push(line),
            None => damaged += 1,
        }
    }
    Audit {
        lines,
        oldest: page.oldest,
        newest: page.newest,
        damaged,
    }
}

/// A line; `None` if its body cannot be read.
fn line(line: store::AuditLine) -> Option<AuditLine> {
    let body: AuditBody = serde_json::from_slice(&line.body).ok()?;
    let outcomes = body.outcomes.into_iter();
    Some(AuditLine {
        number: line.number,
        unix_secs: line.first_ms as f64 / 1000.0,
        last_unix_secs: line.last_ms as f64 / 1000.0,
        count: body.count,
        user: Some(line.user).filter(|user| !user.is_empty()),
        client: line.client,
        verb: line.verb,
        action: body.action,
        name: line.name,
        outcomes: outcomes
            .map(|(outcome, count)| AuditOutcome { outcome, count })
            .collect(),
    })
}
