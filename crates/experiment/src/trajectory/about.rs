//! The metadata of a trajectory.

use jostle_convert::spec;
use jostle_results::table::trajectory::About;
use serde_json::{Map, Value, json};

use crate::plan::{Plan, PlannedRun};

/// Returns the metadata of the trajectory of a run.
pub fn about(plan: &Plan, run: &PlannedRun) -> About {
    let spec = plan.spec(run);
    let spec = serde_json::to_string(&spec::to_proto(&spec, run.seed));
    let every = plan.record_every.unwrap_or(1);
    let pairs = [
        ("experiment", plan.name.clone()),
        ("run", run.name.clone()),
        ("seed", run.seed.to_string()),
        ("spec", spec.expect("a spec is valid JSON")),
        ("informed", plan.point(run).informed.to_string()),
        ("variables", Value::Object(variables(&run.name)).to_string()),
        ("every", every.to_string()),
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("units", units().to_string()),
    ];
    About::from(pairs.map(|(key, value)| (key.to_owned(), value)))
}

/// Returns the values that vary, from the name of a run: numbers, or text.
fn variables(run: &str) -> Map<String, Value> {
    let pairs = run.split(' ').filter_map(|pair| pair.split_once('='));
    let value = |text: &str| {
        let number = serde_json::from_str(text).ok().filter(Value::is_number);
        number.unwrap_or_else(|| text.into())
    };
    pairs
        .map(|(name, text)| (name.to_owned(), value(text)))
        .collect()
}

/// Returns the unit of each column.
fn units() -> Value {
    json!({
        "step": "1",
        "time": "body sizes over free speed",
        "id": "1",
        "x": "body sizes",
        "y": "body sizes",
        "alpha": "radians",
        "informed": "1",
    })
}
