//! Recordings that run, end and fail, and a playback.

use std::fs;
use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::keys;
use serde_json::{Value, json};

use super::documents::Recorded;
use super::recording_client::{FIXTURE_NODE, RecordingClient, args};
use crate::support::programs::ROOT;
use crate::support::{Client, PREFIX, until};

pub async fn record_fixtures(recorded: &Recorded) {
    let data = tempfile::tempdir().unwrap();
    // A daemon rejects a folder with recordings and no database.
    let mut first = RecordingClient::start_process(&data, "", &[]);
    first.stop();
    first.end();
    // A recording in Parquet by version 1a581a9.
    let parquet = Path::new(ROOT).join("tests/stored/1a581a9/data/recordings/table");
    let stored = fs::read(parquet.join("recording.json")).unwrap();
    let stored: Value = serde_json::from_slice(&stored).unwrap();
    // One that has lost states when the daemon was killed.
    let mut cut = stored.clone();
    cut["format"] = json!("mcap");
    for count in ["frames", "parts", "bytes"] {
        cut[count] = json!(0);
    }
    (cut["missed"], cut["lost"]) = (json!(8), json!(5));
    let [after, until] = [(2, 100), (3, 220)].map(|it| json!({"epoch": it.0, "step": it.1}));
    cut["gaps"] = json!([{"after": after, "until": until, "missed": 5}]);
    for (name, status) in [("table", stored), ("cut", cut)] {
        let folder = data.path().join("recordings").join(name);
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("recording.json"), status.to_string()).unwrap();
    }
    for number in 0..3 {
        let part = format!("part-{number:05}.parquet");
        let folder = data.path().join("recordings/table");
        fs::copy(parquet.join(&part), folder.join(&part)).unwrap();
    }
    let process = RecordingClient::start_process(&data, "", &[]);
    let client = Client::open(&process.endpoint).await;
    let recorder = RecordingClient::with_daemon(recorded, process, client, data);
    let events = recorder.subscribe(keys::event(PREFIX, "school")).await;
    let spec = json!({"n": 4, "seed": 1, "start": {"kind": "disc", "radius": 4.0}});
    recorder.create("school", spec).await;
    recorder
        .node_cmd("record.reply", "record", args("record.args"))
        .await;
    // It is fetched and deleted by its client, unlike the one before it.
    let name = json!({"recording": "school-1"});
    for verb in ["stop", "delete"] {
        recorder.node_cmd("", "record", json!({verb: name})).await;
    }
    let begin = json!({"begin": {"swarm": "school", "temporary": true}});
    recorder.node_cmd("", "record", begin).await;
    let take = args("record.args.named");
    recorder.node_cmd("", "record", take).await;
    for name in ["night", "demo"] {
        let begin = json!({"begin": {"swarm": "school", "recording": name, "every": 5}});
        recorder.node_cmd("", "record", begin).await;
    }
    recorder
        .cmd("", "school", "step", json!({"steps": 200}))
        .await;
    for name in ["school-1", "night", "demo"] {
        has(&recorder, name, 41).await;
    }
    has(&recorder, "take", 5).await;
    for name in ["take", "demo"] {
        let stop = json!({"stop": {"recording": name}});
        recorder.node_cmd("", "record", stop).await;
    }
    fs::remove_dir_all(recorder.data.join("recordings/night")).unwrap();
    let stop = json!({"stop": {"recording": "night"}});
    recorder.node_cmd("", "record", stop).await;
    recorder
        .event("event.recording_failed", &events, "recording_failed")
        .await;
    last_piece(&recorder).await;
    play_back(&recorder).await;
    let delete = json!({"delete": {"recording": "demo"}});
    recorder.node_cmd("", "record", delete).await;
    recorder
        .node_get("node.recordings.reply", "recordings")
        .await;
    recorder.stop().await;
}

/// Waits until a recording has so many frames.
async fn has(recorder: &RecordingClient<'_>, name: &str, frames: u64) {
    until("they are recorded", async || {
        let reply = recorder.node_get("", "recordings").await;
        let list = reply["result"]["recordings"].as_array().unwrap().clone();
        let mut found = list.iter().filter(|it| it["recording"] == name);
        found.next().unwrap()["frames"] == frames
    })
    .await;
}

/// The last eight bytes of a part.
async fn last_piece(recorder: &RecordingClient<'_>) {
    let key = keys::node_get(PREFIX, FIXTURE_NODE, "recording");
    let whole = recorder.query("", &format!("{key}?name=demo"), None).await;
    let length = whole["result"]["length"].as_u64().unwrap();
    let last = format!("{key}?name=demo;part=0;offset={}", length - 8);
    recorder.query("node.recording.reply", &last, None).await;
}

async fn play_back(recorder: &RecordingClient<'_>) {
    let open = json!({"open": {"name": "tape", "recording": "demo"}});
    recorder.node_cmd("replay.reply", "replay", open).await;
    recorder
        .cmd("seek.reply", "tape", "seek", args("seek.args"))
        .await;
    recorder.get("status.reply.replay", "tape", "status").await;

    let last = args("replay.args.upload");
    let [offset, length] = ["offset", "length"].map(|it| last["upload"][it].as_u64().unwrap());
    let zeros = STANDARD.encode(vec![0; usize::try_from(offset).unwrap()]);
    let mut first: Value = last.clone();
    first["upload"] = json!({"name": "tape-2", "offset": 0, "length": length, "bytes": zeros});
    recorder.node_cmd("", "replay", first).await;
    let mut last = last;
    last["upload"]["name"] = json!("tape-2");
    recorder
        .node_cmd("replay.reply.upload", "replay", last)
        .await;
}
