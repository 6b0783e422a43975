//! Solvers that come as Python wheels: programs out as JSON, times and multipliers back.

use std::fs;
use std::process::Command;

use serde_json::{Value, json};

use super::arguments::Arguments;
use super::backend::{Backend, Quality};
use super::record::Recorded;
use super::settled::{Case, target};

/// The script, beside this file.
const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/step/outsiders.py");

/// DAQP is dense: beyond this its matrices cost memory and minutes.
const MOST_DENSE: usize = 120;

/// What a wheel made of the programs.
pub struct Answers {
    /// µs of a call, the quickest pass's mean, the wheel's own overhead included.
    pub microseconds: f64,
    iterations: f64,
    multipliers: Vec<Vec<f64>>,
}

/// Hands `records` to a wheel; none if it was not asked for, is not installed or is too dear.
pub fn ask(
    backend: Backend,
    case: Case,
    records: &[Recorded],
    arguments: &Arguments,
) -> Option<Answers> {
    if !arguments.wants(backend) || backend == Backend::Daqp && case.n > MOST_DENSE {
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
    /// How good the multipliers are.
    pub fn judge(&self, records: &[Recorded], truth: &[Vec<[f64; 3]>]) -> Quality {
        let mut quality = Quality::default();
        for ((recorded, exact), multipliers) in records.iter().zip(truth).zip(&self.multipliers) {
            quality.add(recorded, multipliers, exact);
        }
        quality.iterations = self.iterations * records.len() as f64;
        quality.divide(records.len());
        quality
    }
}

/// Columns of every program: drags, free displacements, and per contact i, j, gap, the normal and
/// the levers, and the multiplier guessed from the step before.
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
