//! Recordings by the daemon: complete files after resets, kills and disk failures.

mod failures;
mod fetched;
mod lost;
mod restarts;
mod steps;

use std::fs;
use std::process::Command;

use jostle_proto::{ErrorCode, EventKind, keys};
use jostle_results::recording::parts;
use serde_json::json;

use crate::health::series;
use crate::support::daemon_process::log;
use crate::support::http::{health, of_daemon};
use crate::support::recording::{
    assert_holds, begin, error_of, files, folder_of, has, ok, read, recording_status, run, send,
    start_daemon, stop,
};
use crate::support::small_disk::SmallDisk;
use crate::support::streams::{next_event, subscribe};
use crate::support::{Daemon, PREFIX, until};

#[tokio::test(flavor = "multi_thread")]
async fn a_swarm_is_recorded_twice_at_once_and_the_files_are_whole() {
    let data = tempfile::tempdir().unwrap();
    let (_process, client) = start_daemon(data.path(), "").await;
    run(&client, "school", 10).await;
    let begun = ok(&client, json!({"begin": {"swarm": "school"}})).await;
    assert_eq!(
        (&begun["recording"], &begun["phase"], &begun["format"]),
        (&json!("school-1"), &json!("recording"), &json!("mcap"))
    );
    let begin = json!({"swarm": "school", "every": 20});
    let begun = ok(&client, json!({"begin": begin})).await;
    assert_eq!(begun["recording"], "school-2");
    has(&client, "school-1", "frames", 60).await;
    has(&client, "school-2", "frames", 3).await;
    let [all, some] = [
        stop(&client, "school-1").await,
        stop(&client, "school-2").await,
    ];
    for status in [&all, &some] {
        assert_eq!(status["phase"], "ended", "{status}");
        assert_eq!(status["reason"], "stopped", "{status}");
        assert_eq!(status["missed"], 0, "{status}");
        assert_eq!(status["parts"], 1, "{status}");
        assert_holds(data.path(), status);
    }
    let [frames, few] = [&all, &some].map(|it| it["frames"].as_u64().unwrap());
    assert!(few >= 3 && few <= frames / 20 + 2, "{few} of {frames}");
    let names = fs::read_dir(folder_of(data.path(), "school-1")).unwrap();
    assert_eq!(names.count(), 3, "the part, and how it stands and stood");

    // A second `stop` changes nothing, and a deleted recording is gone.
    assert_eq!(stop(&client, "school-1").await, all);
    let delete = json!({"delete": {"recording": "school-1"}});
    assert_eq!(ok(&client, delete.clone()).await, all);
    assert!(!folder_of(data.path(), "school-1").exists());
    assert_eq!(error_of(&client, delete).await.0, ErrorCode::NotFound);
    let list = client.node("recordings").await;
    assert_eq!(list["recordings"], json!([some]));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_continues_after_a_reset_and_ends_with_a_deletion() {
    let data = tempfile::tempdir().unwrap();
    let (_process, client) = start_daemon(data.path(), "").await;
    client.create("school", json!({"n": 5})).await;
    // The state of a paused swarm is recorded once.
    begin(&client, "school", "take").await;
    has(&client, "take", "frames", 1).await;
    client.ok("school", "step", json!({"steps": 20})).await;
    let before = has(&client, "take", "frames", 2).await["frames"].as_u64();
    client.ok("school", "reset", json!({})).await;
    has(&client, "take", "frames", before.unwrap() + 1).await;
    assert_eq!(
        recording_status(&client, "take").await["phase"],
        "recording"
    );
    client.ok("school", "delete", json!({})).await;
    until("the recording has ended", async || {
        recording_status(&client, "take").await["phase"] == "ended"
    })
    .await;
    let ended = recording_status(&client, "take").await;
    assert_eq!(ended["reason"], "its swarm was deleted");
    assert_holds(data.path(), &ended);
    let bytes = fs::read(&parts(&folder_of(data.path(), "take")).unwrap()[0]).unwrap();
    for event in ["\"verb\":\"reset\"", "\"kind\":\"deleted\""] {
        let mut windows = bytes.windows(event.len());
        assert!(windows.any(|it| it == event.as_bytes()), "{event}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_resumes_after_a_kill_and_its_parts_are_complete() {
    let data = tempfile::tempdir().unwrap();
    let points = "recording-part=return(200)";
    let (mut process, mut client) = start_daemon(data.path(), points).await;
    run(&client, "school", 10).await;
    run(&client, "gone", 10).await;
    for recording in ["first", "second"] {
        begin(&client, "school", recording).await;
    }
    begin(&client, "gone", "other").await;
    for kill in 1..=3 {
        let mut before = Vec::new();
        for name in ["first", "second"] {
            let status = recording_status(&client, name).await["parts"]
                .as_u64()
                .unwrap();
            has(&client, name, "parts", status + 2).await;
        }
        process.kill();
        for name in ["first", "second"] {
            before.push(files(data.path(), name));
        }
        (process, client) = start_daemon(data.path(), points).await;
        for (name, before) in ["first", "second"].iter().zip(before) {
            until("it goes on", async || {
                log(data.path()).matches("resumed with a new part").count() >= 2 * kill
            })
            .await;
            let now = recording_status(&client, name).await;
            assert_eq!(now["phase"], "recording", "{now}");
            assert!(now["parts"].as_u64() >= Some(before.len() as u64), "{now}");
            has(&client, name, "parts", before.len() as u64 + 1).await;
            let after = files(data.path(), name);
            for (part, bytes) in before {
                assert_eq!(after[&part], bytes, "{}", part.display());
            }
        }
    }
    for name in ["first", "second"] {
        let ended = stop(&client, name).await;
        assert_holds(data.path(), &ended);
    }

    // The recording ends if its swarm was deleted while the daemon was down.
    process.kill();
    let folder = folder_of(data.path(), "other");
    let text = fs::read_to_string(folder.join("recording.json")).unwrap();
    let text = text.replace("\"gone\"", "\"nobody\"");
    fs::write(folder.join("recording.json"), text).unwrap();
    let (_process, client) = start_daemon(data.path(), points).await;
    until("it is over", async || {
        recording_status(&client, "other").await["phase"] == "ended"
    })
    .await;
    let ended = recording_status(&client, "other").await;
    assert!(ended["reason"].as_str().unwrap().contains("did not exist"));
    assert_holds(data.path(), &ended);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_stops_ends_the_parts_in_hand_and_goes_on_when_it_is_back() {
    let data = tempfile::tempdir().unwrap();
    let (mut process, client) = start_daemon(data.path(), "").await;
    run(&client, "school", 10).await;
    begin(&client, "school", "take").await;
    has(&client, "take", "frames", 20).await;
    let id = process.child.id().to_string();
    let signalled = Command::new("kill").args(["-TERM", &id]).status();
    assert!(signalled.unwrap().success());
    assert_eq!(process.end(), Some(0));
    let folder = folder_of(data.path(), "take");
    let names = fs::read_dir(&folder).unwrap().count();
    assert_eq!(names, 3, "one part, and how it stands and stood");
    let whole = read(data.path(), "take");
    assert!(whole.frames >= 20, "{whole:?}");

    let (_process, client) = start_daemon(data.path(), "").await;
    has(&client, "take", "frames", whole.frames + 5).await;
    let ended = stop(&client, "take").await;
    assert_eq!(ended["parts"], 2);
    assert_holds(data.path(), &ended);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_disk_ends_a_recording_and_harms_no_swarm() {
    let Some(disk) = SmallDisk::mount(16) else {
        return;
    };
    let (mut process, client) = start_daemon(disk.path(), "recording-settled=sleep(300)").await;
    run(&client, "school", 200).await;
    begin(&client, "school", "take").await;
    begin(&client, "school", "table").await;
    has(&client, "take", "frames", 5).await;
    for name in ["take", "table"] {
        until("the disk is full", async || {
            // Fills the space that the end of a part frees.
            disk.fill_more();
            recording_status(&client, name).await["phase"] == "failed"
        })
        .await;
        let failed = recording_status(&client, name).await;
        let reason = failed["reason"].as_str().unwrap();
        assert!(reason.contains("the disk is full"), "{failed}");
        assert!(failed["frames"].as_u64() >= Some(5), "{failed}");
        assert_holds(disk.path(), &failed);
        let step = client.get("school", "status").await["step"].as_u64();
        client.wait_for_step("school", step.unwrap() + 10).await;
        let (code, _) = error_of(&client, json!({"stop": {"recording": name}})).await;
        assert_eq!(code, ErrorCode::IncorrectState);
        let warnings = client.node("metrics").await["warnings"].to_string();
        assert!(warnings.contains(name), "{warnings}");
    }
    disk.fill_more();
    let (code, message) = error_of(&client, json!({"begin": {"swarm": "school"}})).await;
    assert_eq!(code, ErrorCode::StorageFull, "{message}");
    let before = client.node("recordings").await;
    assert_eq!(before["recordings"].as_array().unwrap().len(), 2);
    process.kill();
    disk.make_room();
    let (_process, client) = start_daemon(disk.path(), "").await;
    assert_eq!(client.node("recordings").await, before);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_failed_recording_is_an_event_a_metric_and_a_warning_until_it_is_deleted() {
    let daemon = Daemon::start().await;
    let (client, http) = (&daemon.client, of_daemon(&daemon));
    let count = |phase: &str| series(&http)[&format!("jostle_recordings{{phase=\"{phase}\"}}")];
    client.create("school", json!({"n": 3})).await;
    let events = subscribe(client, keys::event(PREFIX, "school")).await;
    begin(client, "school", "take").await;
    begin(client, "school", "other").await;
    has(client, "take", "frames", 1).await;
    assert_eq!(["recording", "ended", "failed"].map(count), [2.0, 0.0, 0.0]);
    let (status, report) = health(&http);
    assert_eq!((status, &report["warnings"]), (200, &json!([])));

    // The part cannot be renamed.
    fs::remove_dir_all(folder_of(daemon.data_dir(), "take")).unwrap();
    let failed = stop(client, "take").await;
    assert_eq!(failed["phase"], "failed", "{failed}");
    let expected = failed["reason"].as_str().unwrap();
    let (recording, reason) = loop {
        if let EventKind::RecordingFailed { recording, reason } = next_event(&events).await.event {
            break (recording, reason);
        }
    };
    assert_eq!((&*recording, &*reason), ("take", expected));
    let history = client.get("school", "events").await["result"]["events"].take();
    let kinds = history.as_array().unwrap().iter();
    let mut kinds = kinds.map(|it| it["event"]["kind"].as_str().unwrap());
    assert!(kinds.any(|kind| kind == "recording_failed"), "{history}");

    assert_eq!(["recording", "ended", "failed"].map(count), [1.0, 0.0, 1.0]);
    let (status, report) = health(&http);
    assert_eq!((status, &report["healthy"]), (200, &json!(true)));
    assert_eq!(
        report["warnings"][0]["code"], "recording_failed",
        "{report}"
    );
    let message = report["warnings"][0]["message"].as_str().unwrap();
    assert!(message.contains(&format!("take ({expected})")), "{message}");
    assert!(message.contains("--delete NAME"), "{message}");
    let metrics = client.node("metrics").await;
    assert_eq!(metrics["warnings"], json!([message]));
    let counts = json!({"recording": 1, "ended": 0, "failed": 1});
    assert_eq!(metrics["recordings"], counts);

    fs::create_dir(folder_of(daemon.data_dir(), "take")).unwrap();
    ok(client, json!({"delete": {"recording": "take"}})).await;
    assert_eq!(["recording", "ended", "failed"].map(count), [1.0, 0.0, 0.0]);
    assert_eq!(health(&http).1["warnings"], json!([]));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_and_bytes_are_counted_while_a_part_is_written() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    run(client, "school", 10).await;
    begin(client, "school", "take").await;
    let mut before = (0, 0);
    for _ in 0..4 {
        let now = has(client, "take", "frames", before.0 + 1).await;
        assert_eq!(now["parts"], 0, "{now}");
        let now = ["frames", "bytes"].map(|it| now[it].as_u64().unwrap());
        assert!(now[1] > before.1, "{now:?} after {before:?}");
        before = now.into();
    }
    let ended = stop(client, "take").await;
    assert!(ended["bytes"].as_u64() >= Some(before.1), "{ended}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_impossible_recording_is_rejected_and_leaves_nothing() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("school", json!({"n": 3})).await;
    let (code, message) = error_of(client, json!({"begin": {"swarm": "nobody"}})).await;
    assert_eq!(code, ErrorCode::NotFound, "{message}");
    for action in ["stop", "delete"] {
        let (code, message) = error_of(client, json!({action: {"recording": "take"}})).await;
        assert_eq!(code, ErrorCode::NotFound, "{message}");
        assert!(message.contains("get/recordings"), "{message}");
    }
    let args = json!({"begin": {"swarm": "school", "recording": "take"}});
    let request = json!({"client": "me", "request_id": "one", "args": args});
    let begun = send(client, &request).await.unwrap();
    assert_eq!(send(client, &request).await.unwrap(), begun, "once");
    let (code, message) = error_of(client, args).await;
    assert_eq!(code, ErrorCode::AlreadyExists);
    assert!(message.contains("another name"), "{message}");

    for number in 1..64 {
        let begun = ok(client, json!({"begin": {"swarm": "school"}})).await;
        assert_eq!(begun["recording"], format!("school-{number}"));
    }
    let (code, message) = error_of(client, json!({"begin": {"swarm": "school"}})).await;
    assert_eq!(code, ErrorCode::ResourceExhausted);
    assert!(message.contains("stop one"), "{message}");
    stop(client, "school-7").await;
    let begun = ok(client, json!({"begin": {"swarm": "school"}})).await;
    assert_eq!(begun["recording"], "school-64");
    let list = client.node("recordings").await;
    assert_eq!(list["recordings"].as_array().unwrap().len(), 65);
    daemon.stop().await;
}
