//! Recordings that go on, end and fail, and a recording that is shown.

use std::fs;
use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::keys;
use serde_json::{Value, json};

use super::documents::Recorded;
use super::lab::{LAB, Lab, args};
use crate::support::{Client, PREFIX, until};

pub async fn play(recorded: &Recorded) {
    let data = tempfile::tempdir().unwrap();
    // A recording in Parquet by version 1a581a9.
    let stored = Path::new("tests/stored/1a581a9/data/recordings/table/recording.json");
    let folder = data.path().join("recordings/table");
    fs::create_dir_all(&folder).unwrap();
    fs::copy(stored, folder.join("recording.json")).unwrap();
    let life = Lab::life_in(&data, "", &[]);
    let client = Client::open(&life.endpoint).await;
    let lab = Lab::of(recorded, life, client, data);
    let events = lab.subscribe(keys::event(PREFIX, "school")).await;
    let spec = json!({"n": 4, "seed": 1, "start": {"kind": "disc", "radius": 4.0}});
    lab.create("school", spec).await;
    lab.node_cmd("record.reply", "record", args("record.args"))
        .await;
    // It is fetched and deleted by its client, unlike the one before it.
    let name = json!({"recording": "school-1"});
    for verb in ["stop", "delete"] {
        lab.node_cmd("", "record", json!({verb: name})).await;
    }
    let begin = json!({"begin": {"swarm": "school", "temporary": true}});
    lab.node_cmd("", "record", begin).await;
    let take = args("record.args.named");
    lab.node_cmd("", "record", take).await;
    for name in ["night", "demo"] {
        let begin = json!({"begin": {"swarm": "school", "recording": name, "every": 5}});
        lab.node_cmd("", "record", begin).await;
    }
    lab.cmd("", "school", "step", json!({"steps": 200})).await;
    for name in ["school-1", "night", "demo"] {
        has(&lab, name, 41).await;
    }
    has(&lab, "take", 5).await;
    for name in ["take", "demo"] {
        let stop = json!({"stop": {"recording": name}});
        lab.node_cmd("", "record", stop).await;
    }
    fs::remove_dir_all(lab.data.join("recordings/night")).unwrap();
    let stop = json!({"stop": {"recording": "night"}});
    lab.node_cmd("", "record", stop).await;
    lab.event("event.recording_failed", &events, "recording_failed")
        .await;
    piece(&lab).await;
    shown(&lab).await;
    let delete = json!({"delete": {"recording": "demo"}});
    lab.node_cmd("", "record", delete).await;
    lab.node_get("node.recordings.reply", "recordings").await;
    lab.stop().await;
}

/// Waits until a recording has so many frames.
async fn has(lab: &Lab<'_>, name: &str, frames: u64) {
    until("they are recorded", async || {
        let reply = lab.node_get("", "recordings").await;
        let list = reply["result"]["recordings"].as_array().unwrap().clone();
        let mut found = list.iter().filter(|it| it["recording"] == name);
        found.next().unwrap()["frames"] == frames
    })
    .await;
}

/// The last eight bytes of a part.
async fn piece(lab: &Lab<'_>) {
    let key = keys::node_get(PREFIX, LAB, "recording");
    let whole = lab.ask("", &format!("{key}?name=demo"), None).await;
    let length = whole["result"]["length"].as_u64().unwrap();
    let last = format!("{key}?name=demo;part=0;offset={}", length - 8);
    lab.ask("node.recording.reply", &last, None).await;
}

async fn shown(lab: &Lab<'_>) {
    let open = json!({"open": {"name": "tape", "recording": "demo"}});
    lab.node_cmd("replay.reply", "replay", open).await;
    lab.cmd("seek.reply", "tape", "seek", args("seek.args"))
        .await;
    lab.get("status.reply.replay", "tape", "status").await;

    let last = args("replay.args.upload");
    let [offset, length] = ["offset", "length"].map(|it| last["upload"][it].as_u64().unwrap());
    let zeros = STANDARD.encode(vec![0; usize::try_from(offset).unwrap()]);
    let mut first: Value = last.clone();
    first["upload"] = json!({"name": "tape-2", "offset": 0, "length": length, "bytes": zeros});
    lab.node_cmd("", "replay", first).await;
    let mut last = last;
    last["upload"]["name"] = json!("tape-2");
    lab.node_cmd("replay.reply.upload", "replay", last).await;
}
