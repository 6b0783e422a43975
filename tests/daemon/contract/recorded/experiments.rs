//! Experiments in every phase.

use std::fs;

use jostle_proto::keys;
use serde_json::{Value, json};

use super::documents::Recorded;
use super::lab::{LAB, Lab};
use crate::support::{PREFIX, until};

/// An experiment of four short runs, two of them with an informed individual.
const SMALL: &str = r#"
name = "small"
seed = 1
replicates = 2
duration = 1.0
spec = { pi1 = 4.0 }

[[grid]]
n = [2]

[[grid]]
n = [5]
informed = [1]

[measure]
order_every = 10
"#;

/// An experiment of one run that takes longer than the test.
fn endless(name: &str) -> Value {
    let toml = format!("name = \"{name}\"\nduration = 1e6\nspec = {{ n = 20 }}\n");
    json!({"submit": {"toml": toml}})
}

async fn progress(lab: &Lab<'_>, name: &str) -> Value {
    let key = keys::experiment(PREFIX, LAB, name, "progress");
    lab.ask("", &key, None).await
}

/// Waits until an experiment is in a phase.
async fn reach(lab: &Lab<'_>, name: &str, phase: &str) {
    until(&format!("{name} is {phase}"), async || {
        progress(lab, name).await["phase"] == phase
    })
    .await;
}

/// Does something with an experiment.
async fn send(lab: &Lab<'_>, verb: &str, name: &str) {
    let args = json!({verb: {"name": name}});
    lab.node_cmd("", "experiment", args).await;
}

pub async fn play(recorded: &Recorded) {
    let lab = Lab::start(recorded).await;
    // Bodies that turn at a touch, in the longest step: two of them cross within a while.
    let crossing = "name = \"first\"\nseed = 2\nreplicates = 2\nduration = 1000\n\
        spec = { n = 60, pi4 = 1e6, dt = 0.2 }\n";
    let crossing = json!({"submit": {"toml": crossing}});
    lab.node_cmd("", "experiment", crossing).await;
    reach(&lab, "first", "finished").await;

    lab.node_cmd("", "experiment", endless("still")).await;
    reach(&lab, "still", "running").await;
    let small = json!({"submit": {"toml": SMALL}});
    lab.node_cmd("experiment.reply", "experiment", small).await;
    for name in ["odd", "half"] {
        lab.node_cmd("", "experiment", endless(name)).await;
    }
    send(&lab, "cancel", "half").await;
    // There is no folder for its rows.
    let folder = lab.data.join("experiments/odd");
    fs::remove_dir_all(&folder).unwrap();
    fs::write(&folder, "").unwrap();
    send(&lab, "pause", "still").await;
    reach(&lab, "small", "finished").await;
    reach(&lab, "odd", "failed").await;
    let key = |noun: &str| keys::experiment(PREFIX, LAB, "small", noun);
    lab.ask("experiment.progress", &key("progress"), None).await;
    lab.ask("experiment.results", &key("results"), None).await;
    let order = format!("{}?run=n=5 informed=1 #0;limit=3", key("order"));
    lab.ask("experiment.order", &order, None).await;

    for name in ["long", "next"] {
        lab.node_cmd("", "experiment", endless(name)).await;
    }
    until("it is told how long the rest takes", async || {
        progress(&lab, "long").await["left_secs"].is_number()
    })
    .await;
    lab.node_get("node.experiments.reply", "experiments").await;
    lab.stop().await;
}
