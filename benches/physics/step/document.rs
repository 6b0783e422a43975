//! Updates the measured tables in `docs/performance.md`. The prose around them is written by hand.

use super::backend::Backend;
use super::table::{self, Row, figures};

/// Returns the page with new tables between their marks.
pub fn with_tables(page: &str, rows: &[Row]) -> String {
    let page = replace(page, "table", &table::markdown(rows));
    let page = replace(&page, "faster", &faster(rows));
    replace(&page, "errors", &table::errors_markdown(rows))
}

/// Replaces the text between `<!-- name -->` and `<!-- /name -->`.
fn replace(page: &str, name: &str, text: &str) -> String {
    let (open, close) = (format!("<!-- {name} -->"), format!("<!-- /{name} -->"));
    let (before, rest) = page.split_once(&open).expect("the page has the mark");
    let (_, after) = rest.split_once(&close).expect("the mark is closed");
    format!("{before}{open}\n{text}\n{close}{after}")
}

/// Lists the groups for which the whole step of another solver takes less time than that of the
/// exact solver, with the errors of its velocities.
fn faster(rows: &[Row]) -> String {
    let mut lines = Vec::new();
    for row in table::inexact(rows) {
        let same =
            |ours: &&Row| ours.backend == Backend::Exact && (ours.pi1, ours.n) == (row.pi1, row.n);
        let Some(ours) = rows.iter().find(same) else {
            continue;
        };
        if row.step_us < ours.step_us {
            lines.push(format!(
                "- {} at π1 = {}, n = {}: {} µs a step against our {}. Velocities are off by {} % \
                 at worst, {} % on average.",
                row.backend.name(),
                row.pi1,
                row.n,
                figures(row.step_us),
                figures(ours.step_us),
                percent(row.quality.worst_velocity_error),
                percent(row.quality.mean_velocity_error),
            ));
        }
    }
    if lines.is_empty() {
        return "Nowhere in this table.".to_owned();
    }
    lines.join("\n")
}

/// Formats a share in per cent: whole numbers from 1 on, below that two decimals or one figure.
fn percent(share: f64) -> String {
    match 100.0 * share {
        value if value >= 1.0 => format!("{value:.0}"),
        value if value >= 0.01 => format!("{value:.2}"),
        value => format!("{value:.0e}"),
    }
}
