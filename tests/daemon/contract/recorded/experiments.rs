//! Experiments in every phase.

use std::fs;

use jostle_proto::keys;
use serde_json::{Value, json};

use super::documents::Recorded;
use super::recording_client::{FIXTURE_NODE, RecordingClient, args};
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
columns = ["order", "drift"]
series_every = 10
record_every = 25
"#;

/// An experiment of a run with commands, which needs not be submitted.
const TURN: &str = r#"
name = "turn"
duration = 4.0
spec = { n = 3 }

[[at]]
time = 1
inform = { select = { count = 1 }, direction = 0.5 }

[stop]
when = "drift > 0.9 for 1"
"#;

/// An experiment of one run that takes longer than the test.
fn endless(name: &str) -> Value {
    let toml = format!("name = \"{name}\"\nduration = 1e6\nspec = {{ n = 20 }}\n");
    json!({"submit": {"toml": toml}})
}

async fn progress(recorder: &RecordingClient<'_>, name: &str) -> Value {
    let key = keys::experiment(PREFIX, FIXTURE_NODE, name, "progress");
    recorder.query("", &key, None).await
}

/// Waits until an experiment is in a phase.
pub async fn wait_for_phase(recorder: &RecordingClient<'_>, name: &str, phase: &str) {
    until(&format!("{name} is {phase}"), async || {
        progress(recorder, name).await["phase"] == phase
    })
    .await;
}

/// Sends an action on an experiment.
async fn send(recorder: &RecordingClient<'_>, verb: &str, name: &str) {
    let args = json!({verb: {"name": name}});
    recorder.node_cmd("", "experiment", args).await;
}

pub async fn record_fixtures(recorded: &Recorded) {
    let recorder = RecordingClient::start(recorded).await;
    // Bodies that turn at a touch, in the longest step: two of them cross within a while.
    let crossing = "name = \"first\"\nseed = 2\nreplicates = 2\nduration = 1000\n\
        spec = { n = 60, pi4 = 1e6, dt = 0.2 }\n";
    let crossing = json!({"submit": {"toml": crossing}});
    recorder.node_cmd("", "experiment", crossing).await;
    wait_for_phase(&recorder, "first", "finished").await;

    recorder.node_cmd("", "experiment", endless("still")).await;
    wait_for_phase(&recorder, "still", "running").await;
    let small = json!({"submit": {"toml": SMALL}});
    recorder
        .node_cmd("experiment.reply", "experiment", small)
        .await;
    for name in ["odd", "half"] {
        recorder.node_cmd("", "experiment", endless(name)).await;
    }
    send(&recorder, "cancel", "half").await;
    // There is no folder for its rows.
    let folder = recorder.data.join("experiments/odd");
    fs::remove_dir_all(&folder).unwrap();
    fs::write(&folder, "").unwrap();
    send(&recorder, "pause", "still").await;
    wait_for_phase(&recorder, "small", "finished").await;
    wait_for_phase(&recorder, "odd", "failed").await;
    let faulted = keys::experiment(PREFIX, FIXTURE_NODE, "first", "results");
    recorder
        .query("experiment.results.faulted", &faulted, None)
        .await;
    let key = |noun: &str| keys::experiment(PREFIX, FIXTURE_NODE, "small", noun);
    recorder
        .query("experiment.progress", &key("progress"), None)
        .await;
    recorder
        .query("experiment.results", &key("results"), None)
        .await;
    let order = format!("{}?run=n=5 informed=1 #0;limit=3", key("order"));
    recorder.query("experiment.order", &order, None).await;
    let series = format!("{}?run=n=5 informed=1 #0;limit=3", key("series"));
    recorder.query("experiment.series", &series, None).await;
    let individuals = format!("{series};of=individuals");
    recorder
        .query("experiment.series.individuals", &individuals, None)
        .await;

    let turn = json!({"expand": {"toml": TURN}});
    recorder
        .node_cmd("experiment.reply.expanded", "experiment", turn)
        .await;
    let start = &args("experiment.args.expand_files")["expand"]["start"];
    let later = "name = \"later\"\nduration = 1.0\nstart = \"school.snapshot\"\n";
    let later = json!({"expand": {"toml": later, "start": start}});
    recorder
        .node_cmd("experiment.reply.expanded_start", "experiment", later)
        .await;

    for name in ["long", "next"] {
        recorder.node_cmd("", "experiment", endless(name)).await;
    }
    until("the remaining time is known", async || {
        progress(&recorder, "long").await["left_secs"].is_number()
    })
    .await;
    recorder
        .node_get("node.experiments.reply", "experiments")
        .await;
    recorder.stop().await;
}
