//! A daemon on data of an earlier version of the model.

use serde_json::{Value, json};
use zenoh::bytes::Encoding;

use super::documents::{Document, Recorded};
use super::recording_client::RecordingClient;
use crate::models::{aged, killed};
use crate::support::{Client, until};

pub async fn record_fixtures(recorded: &Recorded) {
    let folder = killed(async |client: &Client| {
        client.create("school", json!({"n": 4, "seed": 1})).await;
        client.ok("school", "step", json!({"steps": 50})).await;
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
