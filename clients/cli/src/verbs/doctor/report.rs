//! The report of `doctor`, as text and as JSON.

use jostle_proto::WIRE_VERSION;
use serde_json::{Map, Value, json};

use crate::failure::Failure;
use crate::format;
use crate::output::Output;

/// The outcome of all checks.
pub struct Report {
    endpoint: String,
    /// The checks with their names.
    checks: Vec<(&'static str, Check)>,
}

/// The outcome of one check.
pub struct Check {
    verdict: Verdict,
    text: String,
    figures: Map<String, Value>,
}

enum Verdict {
    Passed,
    Failed { code: String, remedy: String },
    Skipped,
}

impl Check {
    /// A check that passed.
    pub fn passed(text: impl Into<String>) -> Self {
        Check {
            verdict: Verdict::Passed,
            text: text.into(),
            figures: Map::new(),
        }
    }

    /// A check that failed, with the remedy.
    pub fn failed(code: &str, text: impl Into<String>, remedy: &str) -> Self {
        let (code, remedy) = (code.to_owned(), remedy.to_owned());
        Check {
            verdict: Verdict::Failed { code, remedy },
            ..Check::passed(text)
        }
    }

    /// A check that failed with an error, which has its remedy after the colon.
    pub fn of_failure(failure: &Failure) -> Self {
        let text = failure.to_string();
        let (text, remedy) = text.split_once(": ").unwrap_or((&text, ""));
        Check::failed(failure.code(), text, remedy)
    }

    /// A check that could not be executed.
    pub fn skipped(text: impl Into<String>) -> Self {
        Check {
            verdict: Verdict::Skipped,
            ..Check::passed(text)
        }
    }

    /// Adds figures to the JSON.
    pub fn with(mut self, figures: Value) -> Self {
        if let Value::Object(figures) = figures {
            self.figures = figures;
        }
        self
    }

    fn lines(&self, name: &str) -> String {
        let mark = match self.verdict {
            Verdict::Passed => '✓',
            Verdict::Failed { .. } => '✗',
            Verdict::Skipped => '-',
        };
        let line = format!("{mark} {name:13}  {}", self.text);
        match &self.verdict {
            Verdict::Failed { remedy, .. } if !remedy.is_empty() => {
                format!("{line}\n{:17}{remedy}", "")
            }
            _ => line,
        }
    }

    /// The check as JSON.
    pub fn to_json(&self, name: &str) -> Value {
        let (ok, remedy) = match &self.verdict {
            Verdict::Passed => (Some(true), None),
            Verdict::Failed { remedy, .. } => (Some(false), Some(remedy)),
            Verdict::Skipped => (None, None),
        };
        json!({
            "check": name,
            "ok": ok,
            "message": self.text,
            "remedy": remedy,
            "figures": self.figures,
        })
    }
}

impl Report {
    /// A report about the daemon at `endpoint`.
    pub fn new(endpoint: String) -> Self {
        Report {
            endpoint,
            checks: Vec::new(),
        }
    }

    /// Adds a check, which has failed if it could not be executed.
    pub fn add(&mut self, name: &'static str, check: Result<Check, Failure>) {
        let check = check.unwrap_or_else(|failure| Check::of_failure(&failure));
        self.checks.push((name, check));
    }

    pub fn print(&self, output: Output) -> Result<(), Failure> {
        let failed: Vec<&String> = self
            .checks
            .iter()
            .filter_map(|(_, check)| match &check.verdict {
                Verdict::Failed { code, .. } => Some(code),
                _ => None,
            })
            .collect();
        let checks = self.checks.iter().map(|(name, check)| check.to_json(name));
        let document = json!({
            "endpoint": self.endpoint,
            "version": env!("CARGO_PKG_VERSION"),
            "wire_version": WIRE_VERSION,
            "ok": failed.is_empty(),
            "checks": checks.collect::<Vec<_>>(),
        });
        let lines = self.checks.iter().map(|(name, check)| check.lines(name));
        output.print(&document, &lines.collect::<Vec<_>>().join("\n"))?;
        match failed.first() {
            None => Ok(()),
            Some(&code) => {
                let count = format::count(self.checks.len() as u64, "check");
                let message = format!("{} of {count} failed", failed.len());
                Err(Failure::new(code, message))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use jostle_client::Error;

    use super::*;

    #[test]
    fn a_failed_check_has_a_remedy() {
        let (endpoint, cause) = ("tcp/127.0.0.1:1".into(), String::new());
        let check = Check::of_failure(&Error::NoDaemon { endpoint, cause }.into());
        let lines = check.lines("connection");
        assert!(
            lines.starts_with("✗ connection     no daemon answers at tcp/127.0.0.1:1\n"),
            "{lines}"
        );
        assert!(lines.ends_with("with -e"), "{lines}");
        let json = check.to_json("connection");
        assert_eq!(json["ok"], false);
        assert!(
            json["remedy"]
                .as_str()
                .is_some_and(|it| it.starts_with("start one"))
        );
    }

    #[test]
    fn a_skipped_check_neither_passes_nor_fails() {
        let check = Check::skipped("there is no swarm");
        let line = "- subscriptions  there is no swarm";
        assert_eq!(check.lines("subscriptions"), line);
        assert_eq!(check.to_json("subscriptions")["ok"], Value::Null);
    }
}
