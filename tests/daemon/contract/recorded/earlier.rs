//! A daemon on data of an earlier version of the model.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::{keys, to_cbor};
use serde_json::{Value, json};
use zenoh::bytes::Encoding;

use super::documents::{Document, Recorded};
use super::experiments;
use super::recording_client::{FIXTURE_NODE, RecordingClient};
use crate::experiments::{submit, wait_for_phase};
use crate::models::{aged, killed};
use crate::states::swarms;
use crate::support::{Client, PREFIX, until};

/// An experiment of one short run, with a line more.
fn short(name: &str, line: &str) -> String {
    format!("name = \"{name}\"\nseed = 3\nduration = 1\n{line}\n")
}

pub async fn record_fixtures(recorded: &Recorded) {
    let folder = killed(async |client: &Client| {
        client.create("school", json!({"n": 4, "seed": 1})).await;
        client.ok("school", "step", json!({"steps": 50})).await;
        submit(client, &short("before", "spec = { n = 4 }")).await;
        wait_for_phase(client, "before", "finished").await;
    })
    .await;
    let folder = aged(folder.path(), |record| record);
    let process = RecordingClient::start_process(&folder, "", &[]);
    let client = Client::open(&process.endpoint).await;
    until("the swarm is where it was", async || {
        client.get("school", "status").await["step"] == 50
    })
    .await;
    let recorder = RecordingClient::with_daemon(recorded, process, client, folder);
    recorder
        .get("status.reply.earlier_model", "school", "status")
        .await;
    recorder
        .get("snapshot.reply.earlier_model", "school", "snapshot")
        .await;
    recorder
        .node_get("node.swarms.reply.earlier_model", "swarms")
        .await;
    let progress = |name: &str| keys::experiment(PREFIX, FIXTURE_NODE, name, "progress");
    let earlier = "experiment.progress.earlier_model";
    recorder.query(earlier, &progress("before"), None).await;
    let snapshot = swarms::snapshot(&recorder.client, "school").await;
    let toml = short("after", "start = \"school.snapshot\"");
    let start = STANDARD.encode(to_cbor(&snapshot));
    let submitted = json!({"submit": {"toml": toml, "start": start}});
    recorder.node_cmd("", "experiment", submitted).await;
    experiments::wait_for_phase(&recorder, "after", "finished").await;
    let start = "experiment.progress.earlier_start";
    recorder.query(start, &progress("after"), None).await;
    let events = recorder.client.get("school", "events?limit=1000").await;
    let events = events["result"]["events"].as_array().unwrap();
    let event: &Value = events
        .iter()
        .find(|it| it["event"]["kind"] == "model")
        .unwrap();
    let document = Document {
        encoding: Encoding::APPLICATION_JSON,
        bytes: event.to_string().into_bytes(),
    };
    recorder.record_document("event.model", &document);
    recorder.stop().await;
}
