//! What the doctor found, for people and for programs.

use jostle_proto::WIRE_VERSION;
use serde_json::{Map, Value, json};

use crate::failure::Failure;
use crate::output::Output;

/// All that was checked.
pub struct Report {
    endpoint: String,
    checks: Vec<Check>,
}

/// One thing that was checked.
pub struct Check {
    name: &'static str,
    verdict: Verdict,
    said: String,
    figures: Map<String, Value>,
}

enum Verdict {
    Well,
    Wrong { code: &'static str, remedy: String },
    Untried,
}

impl Check {
    /// It works.
    pub fn well(name: &'static str, said: String) -> Self {
        Check {
            name,
            verdict: Verdict::Well,
            said,
            figures: Map::new(),
        }
    }

    /// It does not work, and this helps.
    pub fn wrong(name: &'static str, code: &'static str, said: String, remedy: &str) -> Self {
        let remedy = remedy.to_owned();
        Check {
            verdict: Verdict::Wrong { code, remedy },
            ..Check::well(name, said)
        }
    }

    /// It does not work; a failure says its remedy after the colon.
    pub fn failed(name: &'static str, failure: &Failure) -> Self {
        let text = failure.to_string();
        let (said, remedy) = text.split_once(": ").unwrap_or((&text, ""));
        Check::wrong(name, failure.code(), said.to_owned(), remedy)
    }

    /// There was nothing to try it with.
    pub fn untried(name: &'static str, said: &str) -> Self {
        Check {
            verdict: Verdict::Untried,
            ..Check::well(name, said.to_owned())
        }
    }

    /// The same with figures for programs.
    pub fn with(mut self, figures: Value) -> Self {
        if let Value::Object(figures) = figures {
            self.figures = figures;
        }
        self
    }

    fn lines(&self) -> String {
        let mark = match self.verdict {
            Verdict::Well => '✓',
            Verdict::Wrong { .. } => '✗',
            Verdict::Untried => '-',
        };
        let line = format!("{mark} {:13}  {}", self.name, self.said);
        match &self.verdict {
            Verdict::Wrong { remedy, .. } if !remedy.is_empty() => {
                format!("{line}\n{:17}{remedy}", "")
            }
            _ => line,
        }
    }

    /// The check as programs read it.
    pub fn to_json(&self) -> Value {
        let (ok, remedy) = match &self.verdict {
            Verdict::Well => (Some(true), None),
            Verdict::Wrong { remedy, .. } => (Some(false), Some(remedy)),
            Verdict::Untried => (None, None),
        };
        json!({
            "check": self.name,
            "ok": ok,
            "message": self.said,
            "remedy": remedy,
            "figures": self.figures,
        })
    }
}

impl Report {
    /// About a daemon at `endpoint`.
    pub fn new(endpoint: String) -> Self {
        Report {
            endpoint,
            checks: Vec::new(),
        }
    }

    /// Something that was checked.
    pub fn add(&mut self, check: Check) {
        self.checks.push(check);
    }

    /// Prints it all.
    ///
    /// # Errors
    ///
    /// [`Failure::Unwell`] when something is wrong, [`Failure::Output`] when it cannot be written.
    pub fn print(&self, output: Output) -> Result<(), Failure> {
        let failed: Vec<&'static str> = self
            .checks
            .iter()
            .filter_map(|check| match check.verdict {
                Verdict::Wrong { code, .. } => Some(code),
                _ => None,
            })
            .collect();
        let data = if output.json {
            let checks: Vec<Value> = self.checks.iter().map(Check::to_json).collect();
            json!({
                "endpoint": self.endpoint,
                "version": env!("CARGO_PKG_VERSION"),
                "wire_version": WIRE_VERSION,
                "ok": failed.is_empty(),
                "checks": checks,
            })
            .to_string()
        } else {
            let lines: Vec<String> = self.checks.iter().map(Check::lines).collect();
            lines.join("\n")
        };
        output.data(&data)?;
        match failed.first() {
            None => Ok(()),
            Some(code) => Err(Failure::Unwell {
                count: failed.len(),
                of: self.checks.len(),
                code,
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_check_that_failed_says_what_to_do() {
        let failure = Failure::NoDaemon {
            endpoint: "tcp/127.0.0.1:1".into(),
            cause: String::new(),
        };
        let check = Check::failed("connection", &failure);
        let lines = check.lines();
        assert!(
            lines.starts_with("✗ connection     no daemon answers at tcp/127.0.0.1:1\n"),
            "{lines}"
        );
        assert!(lines.ends_with("with -e"), "{lines}");
        let json = check.to_json();
        assert_eq!(json["ok"], false);
        assert!(
            json["remedy"]
                .as_str()
                .is_some_and(|it| it.starts_with("start one"))
        );
    }

    #[test]
    fn what_was_not_tried_is_neither_well_nor_wrong() {
        let check = Check::untried("subscriptions", "there is no swarm");
        assert_eq!(check.lines(), "- subscriptions  there is no swarm");
        assert_eq!(check.to_json()["ok"], Value::Null);
    }
}
