//! Recordings that cannot continue: no swarm waits for them, and each is an event of its swarm.

use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use jostle_proto::State;
use jostle_results::recording::{self, parts};
use serde_json::{Value, json};

use crate::support::daemon_process::{DaemonProcess, daemon};
use crate::support::recording::{
    assert_holds, error_of, folder_of, has, ok, recording_status, start_daemon, stop,
};
use crate::support::small_disk::SmallDisk;
use crate::support::{Client, until};

/// Opening the files takes so long that a test can interfere.
const SLOW: &str = "recording-resume=sleep(1000)";

async fn step(client: &Client, swarm: &str) -> u64 {
    client.get(swarm, "status").await["step"].as_u64().unwrap()
}

/// Waits until a swarm has taken many steps. A request to the swarm would wake it, so this reads the
/// list of swarms.
async fn steps_on(client: &Client, swarm: &str) {
    let step = async || {
        let swarms = client.node("swarms").await["swarms"].take();
        let found = swarms
            .as_array()
            .unwrap()
            .iter()
            .find(|it| it["swarm"] == swarm);
        found.unwrap()["step"].as_u64().unwrap()
    };
    let before = step().await;
    until("it steps on", async || step().await > before + 1000).await;
}

async fn begin(client: &Client, args: Value) {
    ok(client, json!({"begin": args})).await;
}

/// A stopped daemon that recorded every state of a running swarm twice, as `bad` and `good`.
async fn recorded_twice(data: &Path) {
    let (mut process, client) = start_daemon(data, "").await;
    // 3,000 steps a second, so that the files stay small.
    client.create("school", json!({"n": 5, "rate": 60})).await;
    for name in ["bad", "good"] {
        begin(
            &client,
            json!({"swarm": "school", "recording": name, "every": 1}),
        )
        .await;
    }
    client.ok("school", "run", json!({})).await;
    for name in ["bad", "good"] {
        has(&client, name, "frames", 2000).await;
    }
    process.stop();
    assert_eq!(process.end(), Some(0));
}

/// Waits until one of both recordings has failed for this reason, which must be an event of the swarm,
/// while the swarm continues and the other recording lacks no state.
async fn check(what: &str, data: &Path, client: &Client, reason: &str) {
    let mut failed = Value::Null;
    until(&format!("{what}: one has failed"), async || {
        for name in ["bad", "good"] {
            let status = recording_status(client, name).await;
            if status["phase"] == "failed" {
                failed = status;
            }
        }
        !failed.is_null()
    })
    .await;
    let told = failed["reason"].as_str().unwrap();
    assert!(told.contains(reason), "{what}: {failed}");
    until(&format!("{what}: the event"), async || {
        let events = client.get("school", "events").await["result"]["events"].take();
        let events = events.as_array().unwrap();
        events.iter().any(|it| {
            let event = &it["event"];
            event["kind"] == "recording_failed"
                && event["recording"] == failed["recording"]
                // The status names the parts that are missing, too.
                && told.contains(event["reason"].as_str().unwrap())
        })
    })
    .await;
    steps_on(client, "school").await;

    let other = match failed["recording"] == "bad" {
        true => "good",
        false => "bad",
    };
    let stopped = stop(client, other).await;
    assert_eq!(
        (&stopped["phase"], &stopped["missed"]),
        (&json!("ended"), &json!(0)),
        "{what}"
    );
    assert_holds(data, &stopped);
    let mut steps = Vec::new();
    for part in parts(&folder_of(data, other)).unwrap() {
        recording::read(&part, |message| {
            if message.topic == "state" {
                steps.push(
                    State::from_cbor(message.bytes)
                        .map_err(|it| it.to_string())?
                        .step,
                );
            }
            Ok(())
        })
        .unwrap();
    }
    steps.dedup();
    let all = 0..=*steps.last().unwrap();
    assert!(
        steps.iter().copied().eq(all),
        "{what}: {other} lacks states"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_that_cannot_resume_fails_and_its_swarm_and_the_other_one_continue() {
    let recorded = tempfile::tempdir().unwrap();
    recorded_twice(recorded.path()).await;
    for (what, points, reason) in [
        (
            "thread",
            "recording-thread=1*return->off",
            "no thread can be started",
        ),
        (
            "panic",
            "recording-resume=1*panic->off",
            "a defect of the daemon",
        ),
        ("damaged part", "", "part-00000.mcap"),
        ("deleted folder", SLOW, "recordings/bad"),
    ] {
        let data = tempfile::tempdir().unwrap();
        let data = data.path();
        copy(recorded.path(), data);
        let bad = folder_of(data, "bad");
        if what == "damaged part" {
            let part = bad.join("part-00000.mcap");
            let mut bytes = fs::read(&part).unwrap();
            let middle = bytes.len() / 2;
            bytes[middle] ^= 4;
            fs::write(part, bytes).unwrap();
        }
        let (process, client) = start_daemon(data, points).await;
        if what == "deleted folder" {
            fs::remove_dir_all(&bad).unwrap();
        }
        check(what, data, &client, reason).await;
        drop(process);
    }
}

fn copy(from: &Path, to: &Path) {
    let copied = Command::new("cp")
        .arg("-a")
        .arg(from.join("."))
        .arg(to)
        .status();
    assert!(copied.unwrap().success());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_disk_that_is_full_when_a_recording_resumes_fails_it_and_its_swarm_continues() {
    let Some(disk) = SmallDisk::mount(32) else {
        return;
    };
    let data = disk.path();
    recorded_twice(data).await;
    let (process, client) = start_daemon(data, SLOW).await;
    disk.fill();
    for name in ["bad", "good"] {
        until("it has failed", async || {
            disk.fill_more();
            recording_status(&client, name).await["phase"] == "failed"
        })
        .await;
        let failed = recording_status(&client, name).await;
        assert!(
            failed["reason"]
                .as_str()
                .unwrap()
                .contains("the disk is full"),
            "{failed}"
        );
        assert_holds(data, &failed);
    }
    steps_on(&client, "school").await;
    let events = client.get("school", "events").await["result"]["events"].to_string();
    assert_eq!(events.matches("recording_failed").count(), 2, "{events}");
    drop(process);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_beyond_the_quota_fails_and_its_swarm_continues() {
    let data = tempfile::tempdir().unwrap();
    let data = data.path();
    recorded_twice(data).await;
    let mut command = daemon(data);
    command.args(["--recordings-quota-mb", "1"]);
    let process = DaemonProcess::start(&mut command).unwrap();
    let client = Client::open(&process.endpoint).await;
    for name in ["bad", "good"] {
        until("it has failed", async || {
            recording_status(&client, name).await["phase"] == "failed"
        })
        .await;
        let failed = recording_status(&client, name).await;
        let reason = failed["reason"].as_str().unwrap();
        assert!(reason.contains("recordings_quota_mb"), "{failed}");
        assert_holds(data, &failed);
    }
    steps_on(&client, "school").await;
    let events = client.get("school", "events").await["result"]["events"].to_string();
    assert_eq!(events.matches("recording_failed").count(), 2, "{events}");
}

#[tokio::test(flavor = "multi_thread")]
async fn while_its_files_are_opened_a_swarm_waits_answers_and_may_lose_the_recording() {
    let data = tempfile::tempdir().unwrap();
    let data = data.path();
    recorded_twice(data).await;
    let (mut process, client) = start_daemon(data, "recording-resume=sleep(2000)").await;
    let began = Instant::now();
    // Its queue is soon full. It executes commands, and other swarms step.
    tokio::time::sleep(Duration::from_millis(200)).await;
    let held = step(&client, "school").await;
    client.ok("school", "set", json!({"pi3": 1.1})).await;
    client.create("other", json!({"n": 5, "rate": null})).await;
    client.ok("other", "step", json!({"steps": 2000})).await;
    assert!(
        began.elapsed() < Duration::from_millis(1900),
        "too slow to tell"
    );
    assert_eq!(step(&client, "school").await, held);
    // A client deletes one of them meanwhile, which waits for its thread; the swarm waits for the other.
    ok(&client, json!({"delete": {"recording": "bad"}})).await;
    steps_on(&client, "school").await;
    let good = recording_status(&client, "good").await;
    assert_eq!(
        (&good["phase"], &good["missed"]),
        (&json!("recording"), &json!(0))
    );

    // A daemon that stops while it opens them stops in time, and resumes them when it is back.
    process.kill();
    let (mut process, _) = start_daemon(data, "recording-resume=sleep(60000)").await;
    let began = Instant::now();
    process.stop();
    assert_eq!(process.end(), Some(0));
    assert!(began.elapsed() < Duration::from_secs(20));
    let (_process, client) = start_daemon(data, "").await;
    let frames = good["frames"].as_u64().unwrap();
    has(&client, "good", "frames", frames + 1000).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dropping_recording_holds_no_swarm_back_while_its_files_are_opened() {
    let data = tempfile::tempdir().unwrap();
    let data = data.path();
    let (mut process, client) = start_daemon(data, "").await;
    client.create("school", json!({"n": 5, "rate": null})).await;
    let args =
        json!({"swarm": "school", "recording": "take", "every": 1, "drop_when_behind": true});
    begin(&client, args).await;
    client.ok("school", "step", json!({"steps": 30})).await;
    process.stop();
    assert_eq!(process.end(), Some(0));
    let (_process, client) = start_daemon(data, "recording-resume=sleep(600000)").await;
    client.ok("school", "step", json!({"steps": 2000})).await;
    // From step 30, at which it resumes, 64 states are in its queue.
    let status = recording_status(&client, "take").await;
    assert_eq!(status["missed"], 2001 - 64, "{status}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_fails_if_its_swarm_cannot_be_recovered() {
    let data = tempfile::tempdir().unwrap();
    let data = data.path();
    let (mut process, client) = start_daemon(data, "").await;
    client.create("school", json!({"n": 5})).await;
    begin(&client, json!({"swarm": "school", "recording": "take"})).await;
    process.kill();
    let database = rusqlite::Connection::open(data.join("jostle.sqlite")).unwrap();
    database
        .execute("UPDATE checkpoint SET body = zeroblob(8)", [])
        .unwrap();
    drop(database);
    let (_process, client) = start_daemon(data, "").await;
    let failed = recording_status(&client, "take").await;
    assert_eq!(failed["phase"], "failed", "{failed}");
    let reason = failed["reason"].as_str().unwrap();
    assert!(reason.contains("could not be recovered"), "{failed}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_faulted_swarm_is_recorded_again_after_a_restart_and_a_reset() {
    let data = tempfile::tempdir().unwrap();
    let data = data.path();
    let (mut process, client) = start_daemon(data, "step=50*off->1*panic->off").await;
    client.create("school", json!({"n": 5, "rate": null})).await;
    begin(
        &client,
        json!({"swarm": "school", "recording": "take", "every": 1}),
    )
    .await;
    client.ok("school", "run", json!({})).await;
    client
        .get("school", "wait?phase=faulted;timeout_secs=20")
        .await;
    process.stop();
    assert_eq!(process.end(), Some(0));
    let (_process, client) = start_daemon(data, "").await;
    assert_eq!(client.get("school", "status").await["phase"], "faulted");
    client.ok("school", "reset", json!({})).await;
    client.ok("school", "step", json!({"steps": 9})).await;
    let stopped = stop(&client, "take").await;
    assert_eq!(
        (&stopped["phase"], &stopped["missed"]),
        (&json!("ended"), &json!(0))
    );
    // 0 to 50, the fault, 50 again, 0 to 9.
    assert_eq!(stopped["frames"], 51 + 1 + 10, "{stopped}");
    assert_holds(data, &stopped);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_swarm_that_waits_for_a_recording_that_is_then_rejected_steps_on() {
    let data = tempfile::tempdir().unwrap();
    let points = "recording-frame=3*off->sleep(600000)";
    let (_process, client) = start_daemon(data.path(), points).await;
    for swarm in ["school", "other"] {
        client.create(swarm, json!({"n": 5, "rate": null})).await;
        client.ok(swarm, "run", json!({})).await;
    }
    begin(
        &client,
        json!({"swarm": "other", "recording": "take", "every": 1}),
    )
    .await;
    until("the writer hangs", async || {
        recording_status(&client, "take").await["frames"] == 3
    })
    .await;
    // This request waits for the writer for some seconds, and the next one for this request.
    let stops = async { error_of(&client, json!({"stop": {"recording": "take"}})).await };
    let rejected = async {
        tokio::time::sleep(Duration::from_millis(300)).await;
        let args = json!({"swarm": "school", "recording": "take", "every": 1});
        error_of(&client, json!({"begin": args})).await
    };
    let (_, (code, _)) = tokio::join!(stops, rejected);
    assert_eq!(code, jostle_proto::ErrorCode::AlreadyExists);
    steps_on(&client, "school").await;
}
