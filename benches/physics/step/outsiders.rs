//! Solvers that are installed as Python wheels. A script reads the programs as JSON and returns
//! times and multipliers.

use std::fs;
use std::process::Command;

use serde_json::{Value, json};

use super::arguments::Arguments;
use super::backend::{Backend, Quality};
use super::record::Recorded;
use super::settled::{Case, target};

/// The script that calls the wheel.
const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/step/outsiders.py");

/// Maximum number of individuals for DAQP, which is dense: larger groups take minutes and much
/// memory.
const MAX_DENSE: usize = 120;

/// The answers of a wheel to the programs.
pub struct Answers {
    /// Mean time of a call in µs, of the quickest pass, including the wheel's overhead.
    pub microseconds: f64,
    iterations: f64,
    multipliers: Vec<Vec<f64>>,
}

/// Solves `records` with a wheel. None if the backend is not selected, is not installed, or takes
/// too long for the group.
pub fn measure(
    backend: Backend,
    case: Case,
    records: &[Recorded],
    arguments: &Arguments,
) -> Option<Answers> {
    if !arguments.selects(backend) || backend == Backend::Daqp && case.n > MAX_DENSE {
        return None;
    }
    let module = backend.name();
    let run = |parts: &[&str]| Command::new(&arguments.python).args(parts).output().ok();
    if !run(&["-c", &format!("import {module}, scipy")])?
        .status
        .success()
    {
        return None;
    }
    let path = target().join("programs.json");
    fs::write(&path, programs(records)).expect("target/ can be written");
    let output = run(&[SCRIPT, &module, path.to_str()?])?;
    assert!(
        output.status.success(),
        "{SCRIPT}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    let value: Value = serde_json::from_slice(&output.stdout).expect("the script writes JSON");
    let column = |value: &Value| -> Option<Vec<f64>> {
        value.as_array()?.iter().map(Value::as_f64).collect()
    };
    Some(Answers {
        microseconds: value["microseconds"].as_f64()?,
        iterations: value["iterations"].as_f64()?,
        multipliers: value["multipliers"]
            .as_array()?
            .iter()
            .map(column)
            .collect::<Option<_>>()?,
    })
}

impl Answers {
    /// Returns the quality of the multipliers; `truth` are the exact displacements.
    pub fn quality(&self, records: &[Recorded], truth: &[Vec<[f64; 3]>]) -> Quality {
        let mut quality = Quality::default();
        for ((recorded, exact), multipliers) in records.iter().zip(truth).zip(&self.multipliers) {
            quality.add(recorded, multipliers, exact);
        }
        quality.iterations = self.iterations * records.len() as f64;
        quality.divide(records.len());
        quality
    }
}

/// Returns the programs as JSON. Each has the drags, the free displacements, and columns of the
/// contacts: i, j, gap, normal, levers, and the multiplier guessed from the step before.
fn programs(records: &[Recorded]) -> String {
    let program = |recorded: &Recorded| {
        let contacts = &recorded.qp.contacts;
        json!({
            "weights": recorded.qp.weights,
            "free": recorded.qp.free,
            "i": contacts.iter().map(|contact| contact.i).collect::<Vec<_>>(),
            "j": contacts.iter().map(|contact| contact.j).collect::<Vec<_>>(),
            "gap": contacts.iter().map(|contact| contact.gap).collect::<Vec<_>>(),
            "normal": contacts.iter().map(|contact| contact.normal).collect::<Vec<_>>(),
            "lever": contacts.iter().map(|contact| contact.lever).collect::<Vec<_>>(),
            "guess": recorded.guess,
        })
    };
    Value::from_iter(records.iter().map(program)).to_string()
}
