//! Recordings by the daemon: the effect of each change of state on everything that can be observed.

use std::fs;
use std::path::Path;

use jostle_proto::State;
use jostle_results::recording::{parts, read};
use serde_json::{Value, json};

use super::{End, Observation, Served, Table};
use crate::support::recording::{folder_of, has, ok, recording_status, stop};
use crate::support::small_disk::SmallDisk;
use crate::support::{Client, until};

/// Steps between two recorded states.
const EVERY: u64 = 5;

/// The complete parts with their content.
fn whole(data: &Path) -> Value {
    let parts = parts(&folder_of(data, "take")).unwrap().into_iter();
    parts
        .map(|part| {
            let bytes = fs::read(&part).unwrap();
            let name = part.file_name().unwrap().to_string_lossy().into_owned();
            json!([
                name,
                bytes.len(),
                format!("{:x?}", &bytes[bytes.len() / 2..][..32])
            ])
        })
        .collect()
}

async fn observe(client: &Client, data: &Path) -> Observation {
    let parts = whole(data);
    let list = client.node("recordings").await;
    let status = recording_status(client, "take").await;
    let full = |reason: &str| reason.contains("the disk is full");
    let reason = match status["reason"].as_str() {
        Some(reason) if full(reason) => json!("the disk is full"),
        _ => status["reason"].clone(),
    };
    Observation::from([
        ("phase", status["phase"].clone()),
        ("reason", reason),
        ("frames", status["frames"].clone()),
        ("bytes", status["bytes"].clone()),
        ("whole parts", parts),
        ("missed", status["missed"].clone()),
        ("began_unix_secs", status["began_unix_secs"].clone()),
        (
            "recordings",
            json!(list["recordings"].as_array().unwrap().len()),
        ),
    ])
}

/// The content of the files of a recording that has ended.
async fn read_all(client: &Client, data: &Path) -> [(&'static str, Value); 2] {
    let mut states: Vec<(u64, u64)> = Vec::new();
    for part in parts(&folder_of(data, "take")).unwrap() {
        read(&part, |message| {
            if message.topic == "state" {
                let state = State::from_cbor(message.bytes).map_err(|it| it.to_string())?;
                states.push((state.epoch, state.step));
            }
            Ok(())
        })
        .unwrap();
    }
    let is_even = |pair: &[(u64, u64)]| match (pair[0], pair[1]) {
        ((epoch, step), (next, later)) if epoch == next => later == step + EVERY,
        ((epoch, _), (next, step)) => epoch < next && step % EVERY == 0,
    };
    let steps = match states.windows(2).find(|pair| !is_even(pair)) {
        None if states.len() > 10 => json!("even"),
        odd => json!(format!("{} states, {odd:?}", states.len())),
    };
    let reported = recording_status(client, "take").await["frames"].clone();
    let frames = match reported == states.len() {
        true => json!("all"),
        false => json!(format!("{reported} reported, {} there", states.len())),
    };
    [
        ("steps in the files", steps),
        ("frames in the files", frames),
    ]
}

/// A recording of a running swarm, with some complete parts.
async fn begin(data: &Path, points: &str) -> (Served, Observation, Observation) {
    // A part ends after this many milliseconds.
    let points = format!("recording-part=return(200){points}");
    let daemon = Served::on(data, &points).await;
    let client = &daemon.client;
    let spec = json!({"n": 12, "seed": 3, "rate": 4});
    client.create("school", spec).await;
    let args = json!({"swarm": "school", "recording": "take", "every": EVERY});
    ok(client, json!({"begin": args})).await;
    client.ok("school", "run", json!({})).await;
    has(client, "take", "parts", 2).await;
    let mut before = observe(client, data).await;
    before.insert("steps in the files", json!("even"));
    before.insert("frames in the files", json!("all"));
    let made = Observation::from([("frames", json!(0)), ("bytes", json!(0))]);
    (daemon, made, before)
}

#[tokio::test(flavor = "multi_thread")]
async fn each_change_of_a_recording_restarts_and_continues_the_values_in_the_table() {
    let mut table = Table::of("recordings");
    for change in [
        "swarm paused",
        "swarm paused, run",
        "swarm reset",
        "swarm forked",
        "swarm faulted",
        "swarm deleted",
        "stopped",
        "daemon stops, starts",
        "daemon killed, starts",
    ] {
        let data = tempfile::tempdir().unwrap();
        let data = data.path();
        let points = match change {
            "swarm faulted" => ";step=300*off->1*panic->off",
            _ => "",
        };
        let (mut daemon, made, before) = begin(data, points).await;
        let client = &daemon.client;
        let assert_continues = async |client: &Client| {
            let parts = before["whole parts"].as_array().unwrap().len() as u64;
            has(client, "take", "parts", parts + 2).await;
        };
        match change {
            "swarm paused" => drop(client.ok("school", "pause", json!({})).await),
            "swarm paused, run" => {
                client.ok("school", "pause", json!({})).await;
                client.ok("school", "run", json!({})).await;
                assert_continues(client).await;
            }
            "swarm reset" => {
                client.ok("school", "reset", json!({})).await;
                client.ok("school", "run", json!({})).await;
                assert_continues(client).await;
            }
            "swarm forked" => {
                client.ok("school", "fork", json!({"name": "copy"})).await;
                client.ok("copy", "step", json!({"steps": 50})).await;
                assert_continues(client).await;
            }
            "swarm faulted" => {
                let wait = "wait?phase=faulted;timeout_secs=20";
                client.get("school", wait).await;
            }
            "swarm deleted" => {
                client.ok("school", "delete", json!({})).await;
                until("it has ended", async || {
                    recording_status(client, "take").await["phase"] != "recording"
                })
                .await;
            }
            "stopped" => drop(stop(client, "take").await),
            _ => {
                daemon.end(match change.contains("stops") {
                    true => End::Stop,
                    false => End::Kill,
                });
                daemon = Served::on(data, "recording-part=return(200)").await;
                if change.contains("killed") {
                    assert_continues(&daemon.client).await;
                }
            }
        }
        let client = &daemon.client;
        let mut after = observe(client, data).await;
        if change.starts_with("daemon stops") {
            assert_continues(client).await;
        }
        stop(client, "take").await;
        after.extend(read_all(client, data).await);
        table.judge(change, &made, &before, &after);
    }
    full_disk(&mut table).await;
    table.finish();
}

async fn full_disk(table: &mut Table) {
    let Some(disk) = SmallDisk::mount(16) else {
        return;
    };
    let data = disk.path();
    let (daemon, made, before) = begin(data, "").await;
    let client = &daemon.client;
    until("it has failed", async || {
        // Fills the space that the end of a part frees.
        disk.fill_more();
        recording_status(client, "take").await["phase"] == "failed"
    })
    .await;
    let mut full = observe(client, data).await;
    full.extend(read_all(client, data).await);
    table.judge("disk full", &made, &before, &full);
    disk.make_room();
    until("there is room", async || {
        client
            .cmd("school", "set", json!({"pi3": 1.0}))
            .await
            .is_ok()
    })
    .await;
    let step = client.get("school", "status").await["step"].as_u64();
    client.wait_for_step("school", step.unwrap() + 20).await;
    let mut after = observe(client, data).await;
    after.extend(read_all(client, data).await);
    table.judge("room again", &made, &full, &after);
}
