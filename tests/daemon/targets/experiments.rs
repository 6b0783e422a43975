//! An experiment's file.

use std::collections::BTreeSet;

use jostle_experiment::{Plan, PlanError};

/// A file is an experiment of runs with names of their own, whose swarms can begin, or the line
/// that is wrong is named.
pub fn check(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    match Plan::parse(text) {
        Ok(plan) => {
            assert_eq!(plan.files.toml, text);
            let names: BTreeSet<&str> = plan.runs().iter().map(|run| &*run.name).collect();
            assert_eq!(names.len(), plan.runs().len());
            for run in plan.runs() {
                let point = plan.point(run);
                assert!(point.informed <= point.spec.n && point.steps > 0, "{run:?}");
                assert_eq!(plan.spec(run).seed, run.seed);
            }
        }
        Err(PlanError::Field { line, reason, .. }) => {
            assert!((1..=text.lines().count().max(1)).contains(&line), "{line}");
            assert!(!reason.is_empty());
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}
