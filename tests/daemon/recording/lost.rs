//! Finished parts that are missing or damaged are noticed, and the rest stays readable.

use std::fs;
use std::path::{Path, PathBuf};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::{EventKind, keys};
use jostle_results::recording;
use serde_json::{Value, json};

use crate::support::recording::{begin, folder_of, has, recording_status, run, start_daemon, stop};
use crate::support::streams::{next_event, subscribe};
use crate::support::{Client, NODE, PREFIX, until};

fn part(data: &Path, recording: &str, number: u64) -> PathBuf {
    folder_of(data, recording).join(format!("part-{number:05}.mcap"))
}

/// The number of states in a part.
fn frames(part: &Path) -> u64 {
    let mut frames = 0;
    let read = recording::read(part, |message| {
        frames += u64::from(message.topic == "state");
        Ok(())
    });
    read.unwrap();
    frames
}

/// Checks that the status of a recording, which lacks a finished part, has the counts of the others and
/// the reason.
fn assert_lacks(data: &Path, status: &Value, reason: &str) {
    let recording = status["recording"].as_str().unwrap();
    let mut parts = recording::parts(&folder_of(data, recording)).unwrap();
    // A kill may leave the file of one more part, which was not finished without its status.
    let finished = status["parts"].as_u64().unwrap() + status["lost_parts"].as_u64().unwrap();
    let next = part(data, recording, finished);
    parts.retain(|it| *it != next);
    let there: Vec<_> = parts
        .iter()
        .filter(|it| recording::read(it, |_| Ok(())).is_ok())
        .collect();
    let bytes = there.iter().map(|it| fs::metadata(it).unwrap().len());
    assert_eq!(status["lost_parts"], 1, "{status}");
    assert_eq!(status["phase"], "failed", "{status}");
    assert_eq!(status["parts"], there.len(), "{status}");
    assert_eq!(status["bytes"], bytes.sum::<u64>(), "{status}");
    let frames = there.iter().map(|it| frames(it)).sum::<u64>();
    assert_eq!(status["frames"], frames, "{status}");
    let text = status["reason"].as_str().unwrap();
    assert!(text.contains(reason) && text.contains("put back"), "{text}");
}

async fn warnings(client: &Client) -> String {
    client.node("metrics").await["warnings"].to_string()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_that_lacks_a_part_says_so_until_the_file_is_back() {
    let data = tempfile::tempdir().unwrap();
    let data = data.path();
    let (mut process, client) = start_daemon(data, "recording-part=return(100)").await;
    run(&client, "school", 5).await;
    begin(&client, "school", "take").await;
    has(&client, "take", "parts", 3).await;
    let whole = stop(&client, "take").await;
    assert_eq!(
        (&whole["lost_parts"], &whole["phase"]),
        (&json!(0), &json!("ended"))
    );

    // The list notices a file that is gone, and what is there can be fetched.
    let file = part(data, "take", 1);
    let bytes = fs::read(&file).unwrap();
    fs::remove_file(&file).unwrap();
    let missing = "1 is missing (part-00001.mcap)";
    let lacking = recording_status(&client, "take").await;
    assert_lacks(data, &lacking, missing);
    let warned = warnings(&client).await;
    assert!(
        warned.contains("take") && warned.contains(missing),
        "{warned}"
    );
    let key = keys::node_get(PREFIX, NODE, "recording");
    let files = recording::parts(&folder_of(data, "take")).unwrap();
    for (number, file) in files.iter().enumerate() {
        let selector = format!("{key}?name=take;part={number}");
        let piece = client.query(&selector, None).await.unwrap();
        let fetched = STANDARD.decode(piece["result"]["bytes"].as_str().unwrap());
        assert!(fs::read(file).unwrap() == fetched.unwrap(), "{number}");
    }

    // A restart notices it, also if an earlier version wrote the status.
    for _ in 0..2 {
        process.kill();
        let (restarted, client) = start_daemon(data, "").await;
        process = restarted;
        let warned = warnings(&client).await;
        assert!(warned.contains(missing), "{warned}");
        assert_eq!(recording_status(&client, "take").await, lacking);
        let path = folder_of(data, "take").join("recording.json");
        let mut stored: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
        assert_eq!(stored["phase"], "ended", "what is stored is unchanged");
        stored.as_object_mut().unwrap().remove("part_bytes");
        fs::write(&path, stored.to_string()).unwrap();
    }

    // A part that is cut short is noticed, too, and a recording whose files are back is complete.
    for cut in [true, false] {
        process.kill();
        let length = if cut { bytes.len() / 2 } else { bytes.len() };
        fs::write(&file, &bytes[..length]).unwrap();
        let (restarted, client) = start_daemon(data, "").await;
        process = restarted;
        let status = recording_status(&client, "take").await;
        match cut {
            true => assert_lacks(data, &status, "1 is damaged (part-00001.mcap)"),
            false => assert_eq!(status, whole),
        }
        assert_eq!(warnings(&client).await.contains("take"), cut);
    }
    // While the daemon runs as well.
    let client = Client::open(&process.endpoint).await;
    fs::remove_file(&file).unwrap();
    assert_lacks(data, &recording_status(&client, "take").await, missing);
    fs::write(&file, &bytes).unwrap();
    assert_eq!(recording_status(&client, "take").await, whole);
    assert!(!warnings(&client).await.contains("take"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_running_recording_that_lacks_a_part_goes_on_and_fails_at_the_restart() {
    let data = tempfile::tempdir().unwrap();
    let data = data.path();
    let points = "recording-part=return(100)";
    let (mut process, client) = start_daemon(data, points).await;
    run(&client, "school", 5).await;
    for name in ["take", "other"] {
        begin(&client, "school", name).await;
        has(&client, name, "parts", 3).await;
    }
    fs::remove_file(part(data, "take", 0)).unwrap();
    let lacking = recording_status(&client, "take").await;
    assert_eq!(
        (&lacking["phase"], &lacking["lost_parts"]),
        (&json!("recording"), &json!(1)),
        "{lacking}"
    );
    let missing = "1 is missing (part-00000.mcap)";
    assert!(
        lacking["reason"].as_str().unwrap().contains(missing),
        "{lacking}"
    );
    has(
        &client,
        "take",
        "parts",
        lacking["parts"].as_u64().unwrap() + 1,
    )
    .await;
    process.kill();

    let (_process, client) = start_daemon(data, points).await;
    let events = subscribe(&client, keys::event(PREFIX, "school")).await;
    until("it has failed", async || {
        recording_status(&client, "take").await["phase"] == "failed"
    })
    .await;
    let failed = recording_status(&client, "take").await;
    assert_lacks(data, &failed, missing);
    let history = client.get("school", "events").await["result"]["events"].take();
    let is_failure = |it: &Value| it["event"]["kind"] == "recording_failed";
    if !history.as_array().unwrap().iter().any(is_failure) {
        while !matches!(
            next_event(&events).await.event,
            EventKind::RecordingFailed { .. }
        ) {}
    }
    // Another recording of the swarm goes on, and so does the swarm.
    let parts = recording_status(&client, "other").await["parts"].as_u64();
    has(&client, "other", "parts", parts.unwrap() + 1).await;
    let other = recording_status(&client, "other").await;
    assert_eq!(
        (&other["phase"], &other["lost_parts"]),
        (&json!("recording"), &json!(0))
    );
}
