//! Recordings over stops and kills of the daemon: what they contain, and what they say is missing.

use std::collections::BTreeSet;
use std::path::Path;

use jostle_proto::{RecordedAt, RecordingGap, State, keys};
use jostle_results::recording::{self, About};
use serde_json::{Value, json};

use crate::support::daemon_process::{DaemonProcess, log};
use crate::support::recording::{
    assert_holds, folder_of, has, ok, recording_status, start_daemon, stop,
};
use crate::support::{Client, PREFIX, until};

/// The first part ends after this time, the others after a minute.
const ONE_SHORT_PART: &str = "recording-part=1*return(100)->off";

/// The epoch and step of each state of a recording, and the metadata of its parts.
fn read(data: &Path, recording: &str) -> (Vec<RecordedAt>, Vec<About>) {
    let (mut states, mut abouts) = (Vec::new(), Vec::new());
    for part in recording::parts(&folder_of(data, recording)).unwrap() {
        let about = recording::read(&part, |message| {
            if message.topic == "state" {
                let State { epoch, step, .. } =
                    State::from_cbor(message.bytes).map_err(|it| it.to_string())?;
                states.push(RecordedAt { epoch, step });
            }
            Ok(())
        });
        abouts.push(about.unwrap());
    }
    (states, abouts)
}

fn distinct(states: &[RecordedAt]) -> BTreeSet<u64> {
    states.iter().map(|state| state.step).collect()
}

/// The gaps in the metadata of the last part.
fn gaps(abouts: &[About]) -> Vec<RecordingGap> {
    let gaps = abouts.last().unwrap().get("gaps");
    gaps.map_or(Vec::new(), |gaps| serde_json::from_str(gaps).unwrap())
}

async fn begin(client: &Client, args: Value) {
    ok(client, json!({"begin": args})).await;
}

async fn create(client: &Client) {
    client.create("school", json!({"n": 5, "rate": null})).await;
}

async fn steps(client: &Client, count: u64) {
    client.ok("school", "step", json!({"steps": count})).await;
}

/// Executes a command, at whose step the swarm continues after a kill. Returns this step.
async fn mark(client: &Client) -> u64 {
    let marked = client.ok("school", "set", json!({"pi3": 1.1})).await;
    marked["step"].as_u64().unwrap()
}

/// Stops a daemon as an operator does, and starts it again.
async fn restart(data: &Path, mut process: DaemonProcess, points: &str) -> (DaemonProcess, Client) {
    process.stop();
    assert_eq!(process.end(), Some(0));
    start_daemon(data, points).await
}

#[tokio::test(flavor = "multi_thread")]
async fn three_orderly_restarts_at_rate_max_lose_no_state_of_any_recording() {
    let data = tempfile::tempdir().unwrap();
    let data = data.path();
    let (mut process, mut client) = start_daemon(data, "").await;
    create(&client).await;
    for (name, every) in [("all", 1), ("third", 3)] {
        let args = json!({"swarm": "school", "recording": name, "every": every});
        begin(&client, args).await;
    }
    client.ok("school", "run", json!({})).await;
    let mut frames = 0;
    for life in 0..4 {
        frames = has(&client, "all", "frames", frames + 2000).await["frames"]
            .as_u64()
            .unwrap();
        if life < 3 {
            // Opening the files takes a while; the last stop comes before they are open.
            let points = [
                "",
                "recording-resume=sleep(200)",
                "recording-resume=sleep(300)",
            ];
            (process, client) = restart(data, process, points[life]).await;
        }
        if life == 2 {
            (process, client) = restart(data, process, "").await;
        }
    }
    for (name, every) in [("all", 1), ("third", 3)] {
        let stopped = stop(&client, name).await;
        assert_holds(data, &stopped);
        assert_eq!(
            (&stopped["missed"], &stopped["lost"]),
            (&json!(0), &json!(0))
        );
        assert_eq!(stopped["gap"], Value::Null);
        let (states, abouts) = read(data, name);
        assert!(gaps(&abouts).is_empty());
        let last = states.last().unwrap();
        let wanted: BTreeSet<u64> = (0..=last.step).step_by(every).collect();
        let lacks: Vec<_> = wanted.difference(&distinct(&states)).copied().collect();
        assert!(
            lacks.is_empty(),
            "{name} lacks {} states: {:?}…",
            lacks.len(),
            &lacks[..1]
        );
        assert_eq!(last.epoch - states[0].epoch, 4, "five lives");
        // Each state is recorded once in an epoch.
        for pair in states.windows(2) {
            let [a, b] = pair else { unreachable!() };
            assert!((a.epoch, a.step) < (b.epoch, b.step), "{a:?} {b:?}");
        }
    }
    drop(process);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_kill_lost_is_counted_and_named_over_two_kills_and_a_reset() {
    let data = tempfile::tempdir().unwrap();
    let data = data.path();
    let (mut process, client) = start_daemon(data, ONE_SHORT_PART).await;
    create(&client).await;
    begin(
        &client,
        json!({"swarm": "school", "recording": "take", "every": 3}),
    )
    .await;
    steps(&client, 20).await;
    has(&client, "take", "parts", 1).await;
    // 0 to 18 are in the first part; 21 to 48 are lost, and so is 51, at which it resumes, once more.
    steps(&client, 31).await;
    assert_eq!(mark(&client).await, 51);
    process.kill();
    let (mut process, client) = start_daemon(data, "").await;
    until_resumed(data, 1).await;
    let status = recording_status(&client, "take").await;
    assert_eq!(
        (&status["missed"], &status["lost"]),
        (&json!(10), &json!(10))
    );
    process.kill();

    let (mut process, client) = start_daemon(data, ONE_SHORT_PART).await;
    let status = has(&client, "take", "parts", 2).await;
    assert_eq!(
        status["missed"], 10,
        "the same states are not counted twice"
    );
    let (states, abouts) = read(data, "take");
    let [before, after] = [6, 7].map(|at| states[at]);
    assert_eq!((before.step, after.step), (18, 51));
    let gap = RecordingGap {
        after: Some(before),
        until: after,
        missed: 10,
    };
    assert_eq!(gaps(&abouts), [gap]);
    assert_eq!(status["gap"], json!(gap));
    assert_eq!(abouts.last().unwrap()["missed"], "10");

    // 54 to 60, and, after the reset, 0 to 27: of these 30 is the state at which it resumes.
    steps(&client, 9).await;
    client.ok("school", "reset", json!({})).await;
    steps(&client, 30).await;
    mark(&client).await;
    process.kill();
    let (process, client) = start_daemon(data, "").await;
    until_resumed(data, 3).await;
    steps(&client, 3).await;
    let stopped = stop(&client, "take").await;
    assert_holds(data, &stopped);
    assert_eq!(stopped["missed"], 10 + 3 + 10, "{stopped}");
    let (states, abouts) = read(data, "take");
    let named = gaps(&abouts);
    assert_eq!(named[0], gap);
    assert_eq!(named[1].after.map(|at| at.step), Some(51));
    assert_eq!((named[1].until.step, named[1].missed), (30, 13));
    let last: Vec<u64> = states[states.len() - 2..]
        .iter()
        .map(|it| it.step)
        .collect();
    assert_eq!(last, [30, 33]);
    drop(process);
}

/// Waits until the only recording has opened its files for so many times.
async fn until_resumed(data: &Path, times: usize) {
    until("it has resumed", async || {
        log(data).matches("resumed with a new part").count() == times
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_kill_that_rolls_the_swarm_back_behind_the_last_state_misses_none() {
    let data = tempfile::tempdir().unwrap();
    let (mut process, client) = start_daemon(data.path(), ONE_SHORT_PART).await;
    // Slow enough that no checkpoint follows the command.
    client.create("school", json!({"n": 5, "rate": 4})).await;
    begin(
        &client,
        json!({"swarm": "school", "recording": "take", "every": 1}),
    )
    .await;
    client.ok("school", "run", json!({})).await;
    let before = has(&client, "take", "parts", 1).await["frames"].as_u64();
    process.kill();
    let (process, client) = start_daemon(data.path(), "").await;
    has(&client, "take", "frames", before.unwrap() + 5).await;
    let stopped = stop(&client, "take").await;
    assert_eq!(
        (&stopped["missed"], &stopped["gap"]),
        (&json!(0), &Value::Null)
    );
    let (states, abouts) = read(data.path(), "take");
    assert!(gaps(&abouts).is_empty());
    let again = states
        .windows(2)
        .find(|it| it[0].epoch < it[1].epoch)
        .unwrap();
    assert!(again[1].step < again[0].step, "rolled back: {again:?}");
    // The last state in the files of the first epoch may be later than the last one.
    let steps = distinct(&states);
    let last = *steps.last().unwrap();
    assert!(steps.into_iter().eq(0..=last));
    drop(process);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reset_that_was_scheduled_counts_at_the_step_at_which_it_was_executed() {
    let data = tempfile::tempdir().unwrap();
    let data = data.path();
    let (mut process, client) = start_daemon(data, ONE_SHORT_PART).await;
    create(&client).await;
    begin(
        &client,
        json!({"swarm": "school", "recording": "take", "every": 1}),
    )
    .await;
    steps(&client, 10).await;
    has(&client, "take", "parts", 1).await;
    client.ok("school", "reset", json!({"at_step": 20})).await;
    steps(&client, 10).await;
    until("it is reset", async || {
        client.get("school", "status").await["step"] == 0
    })
    .await;
    steps(&client, 7).await;
    assert_eq!(mark(&client).await, 7);
    process.kill();
    let (process, client) = start_daemon(data, "").await;
    until_resumed(data, 1).await;
    let stopped = stop(&client, "take").await;
    // 11 to 20, and 0 to 6.
    assert_eq!(stopped["missed"], 10 + 7, "{stopped}");
    assert_eq!(stopped["gap"]["until"]["step"], 7);
    drop(process);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reset_that_a_protected_swarm_rejects_counts_nothing() {
    let data = tempfile::tempdir().unwrap();
    let data = data.path();
    // After `protect`, the next line is durable without its outcome.
    let points = format!("{ONE_SHORT_PART};swarm-durable=1*off->return");
    let (mut process, client) = start_daemon(data, &points).await;
    create(&client).await;
    begin(
        &client,
        json!({"swarm": "school", "recording": "take", "every": 1}),
    )
    .await;
    steps(&client, 10).await;
    has(&client, "take", "parts", 1).await;
    client.ok("school", "protect", json!({"on": true})).await;
    steps(&client, 10).await;
    let reset = keys::cmd(PREFIX, "school", "reset");
    assert!(client.query_all(&reset, Some(b"{}")).await.is_empty());
    assert_eq!(process.end(), None);
    let (process, client) = start_daemon(data, "").await;
    until_resumed(data, 1).await;
    assert_eq!(client.get("school", "status").await["step"], 20);
    let stopped = stop(&client, "take").await;
    // 11 to 19: 20 is the state at which it resumes.
    assert_eq!(stopped["missed"], 9, "{stopped}");
    assert_eq!(stopped["gap"]["until"]["step"], 20);
    drop(process);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_kill_before_the_first_part_loses_all_from_the_first_state_on() {
    let data = tempfile::tempdir().unwrap();
    let (mut process, client) = start_daemon(data.path(), "").await;
    create(&client).await;
    steps(&client, 10).await;
    begin(
        &client,
        json!({"swarm": "school", "recording": "take", "every": 5}),
    )
    .await;
    steps(&client, 22).await;
    mark(&client).await;
    process.kill();
    let (process, client) = start_daemon(data.path(), "").await;
    steps(&client, 5).await;
    let stopped = stop(&client, "take").await;
    // 10, 15, 20, 25, 30.
    assert_eq!(
        (&stopped["missed"], &stopped["lost"]),
        (&json!(5), &json!(5))
    );
    assert_eq!(stopped["gap"]["after"], Value::Null);
    assert_eq!(stopped["gap"]["until"]["step"], 32);
    assert_eq!(distinct(&read(data.path(), "take").0), BTreeSet::from([35]));
    drop(process);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_limit_of_steps_counts_those_that_a_kill_lost() {
    for (limit, missed) in [(100, 19), (45, 15)] {
        let data = tempfile::tempdir().unwrap();
        let data = data.path();
        // The 32nd state is not written, so that the kill comes before the end.
        let points = format!("{ONE_SHORT_PART};recording-frame=31*off->sleep(600000)");
        let (mut process, client) = start_daemon(data, &points).await;
        create(&client).await;
        let args = json!({"swarm": "school", "recording": "take", "every": 1, "steps": limit});
        begin(&client, args).await;
        steps(&client, 30).await;
        has(&client, "take", "parts", 1).await;
        steps(&client, 20).await;
        assert_eq!(mark(&client).await, 50);
        process.kill();
        let (process, client) = start_daemon(data, "").await;
        steps(&client, 1000).await;
        until("it is over", async || {
            recording_status(&client, "take").await["phase"] == "ended"
        })
        .await;
        let ended = recording_status(&client, "take").await;
        assert_eq!(ended["missed"], missed, "{ended}");
        let mut wanted: BTreeSet<u64> = (0..=30).collect();
        let reason = match limit {
            45 => "its last steps were lost when the daemon ended",
            _ => "all its steps are recorded",
        };
        if limit > 50 {
            wanted.extend(50..=limit);
        }
        assert_eq!(ended["reason"], reason);
        assert_eq!(distinct(&read(data, "take").0), wanted);
        drop(process);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_dropping_recording_dropped_and_lost_is_missed_once() {
    let data = tempfile::tempdir().unwrap();
    let data = data.path();
    let points = "recording-frame=sleep(2);recording-part=return(150)";
    let (mut process, mut client) = start_daemon(data, points).await;
    create(&client).await;
    let args =
        json!({"swarm": "school", "recording": "take", "every": 1, "drop_when_behind": true});
    begin(&client, args).await;
    let mut last = 0;
    for (life, is_killed) in [false, true, false, true].into_iter().enumerate() {
        let parts = recording_status(&client, "take").await["parts"].as_u64();
        steps(&client, 1000).await;
        has(&client, "take", "parts", parts.unwrap() + 1).await;
        steps(&client, 1000).await;
        last = mark(&client).await;
        (process, client) = if is_killed {
            process.kill();
            start_daemon(data, points).await
        } else {
            restart(data, process, points).await
        };
        until_resumed(data, life + 1).await;
    }
    let stopped = stop(&client, "take").await;
    let [missed, lost] = ["missed", "lost"].map(|it| stopped[it].as_u64().unwrap());
    let (states, abouts) = read(data, "take");
    // The state at which it continues is recorded again; at an orderly stop the one before it counts, too.
    assert_eq!(last, 8000);
    assert_eq!(states.len() as u64 + missed, 8000 + 1 + 2, "{stopped}");
    assert!(lost > 0 && missed > lost, "{stopped}");
    assert_eq!(abouts.last().unwrap()["missed"], missed.to_string());
    drop(process);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_limit_of_steps_goes_on_over_orderly_restarts() {
    for every in [1, 5] {
        let data = tempfile::tempdir().unwrap();
        let data = data.path();
        let (mut process, mut client) = start_daemon(data, "").await;
        create(&client).await;
        steps(&client, 7).await;
        let args = json!({"swarm": "school", "recording": "take", "every": every, "steps": 40});
        begin(&client, args).await;
        for _ in 0..3 {
            steps(&client, 6).await;
            (process, client) = restart(data, process, "").await;
        }
        // 22 are left.
        steps(&client, 21).await;
        assert_eq!(
            recording_status(&client, "take").await["phase"],
            "recording"
        );
        steps(&client, 1).await;
        until("it is over", async || {
            recording_status(&client, "take").await["phase"] == "ended"
        })
        .await;
        steps(&client, 1000).await;
        let ended = recording_status(&client, "take").await;
        assert_eq!(ended["reason"], "all its steps are recorded", "{ended}");
        assert_eq!(ended["missed"], 0, "{ended}");
        let wanted = (7..=47).filter(|step| step % every == 0);
        assert_eq!(distinct(&read(data, "take").0), wanted.collect());
        drop(process);
    }
}
