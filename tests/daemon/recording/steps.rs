//! The states in a recording by the daemon, and which swarms wait while the disk is slow.

use std::path::Path;
use std::time::{Duration, Instant};

use jostle_physics::simulation::Simulation;
use jostle_proto::State;
use jostle_proto::verbs::CreateArgs;
use jostle_results::recording::{self, About};
use jostled::convert::commands::create;
use jostled::swarm::registry::Limits;
use serde_json::{Value, json};

use crate::support::recording::{
    assert_holds, error_of, folder_of, has, ok, recording_status, start_daemon, stop,
};
use crate::support::small_disk::SmallDisk;
use crate::support::{Client, until};

/// The states and the metadata of a recording in MCAP, by a reader that rejects an incomplete
/// file.
fn states(data: &Path, recording: &str) -> (Vec<State>, About) {
    let (mut states, mut about) = (Vec::new(), About::new());
    for part in recording::parts(&folder_of(data, recording)).unwrap() {
        about.extend(
            recording::read(&part, |message| {
                if message.topic == "state" {
                    states.push(State::from_cbor(message.bytes).map_err(|it| it.to_string())?);
                }
                Ok(())
            })
            .unwrap(),
        );
    }
    (states, about)
}

fn steps_of(states: &[State]) -> Vec<u64> {
    states.iter().map(|state| state.step).collect()
}

async fn begin(client: &Client, args: Value) -> Value {
    ok(client, json!({"begin": args})).await
}

async fn wait_until_ended(client: &Client, recording: &str) -> Value {
    until(&format!("{recording} has ended"), async || {
        recording_status(client, recording).await["phase"] != "recording"
    })
    .await;
    recording_status(client, recording).await
}

/// The same swarm as a simulation alone.
fn simulation(spec: &Value) -> Simulation {
    let args: CreateArgs = serde_json::from_value(json!({"name": "twin", "spec": spec})).unwrap();
    let limits = Limits {
        max_individuals: 2000,
        max_swarms: 1,
        max_memory_bytes: 1 << 32,
        max_hz: 50,
    };
    let recipe = create::spec(&args, limits).unwrap();
    Simulation::new(&recipe).unwrap()
}

/// The hash of a recorded state, completed with the parts that are not recorded and do not change.
fn hash(state: &State, of: &Simulation) -> [u8; 32] {
    let mut rebuilt = of.state.clone();
    let configuration = &mut rebuilt.configuration;
    rebuilt.step = state.step;
    configuration.origin = state.origin;
    configuration.id.clone_from(&state.id);
    configuration.x.clone_from(&state.x);
    configuration.y.clone_from(&state.y);
    configuration.alpha.clone_from(&state.alpha);
    rebuilt.hash()
}

#[tokio::test(flavor = "multi_thread")]
async fn at_rate_max_every_kth_state_is_recorded_to_the_bit_for_each_recording() {
    let data = tempfile::tempdir().unwrap();
    let (_process, client) = start_daemon(data.path(), "").await;
    let mut spec = json!({"n": 10, "seed": 3, "rate": null, "publish_every": 10});
    client.create("school", spec.clone()).await;
    // The default of a recording is the present one.
    spec["publish_every"] = json!(40);
    let present = json!({"publish_every": 40});
    client.ok("school", "set", present).await;
    for (name, every) in [
        ("all", json!(1)),
        ("some", json!(7)),
        ("shown", Value::Null),
    ] {
        let mut args = json!({"swarm": "school", "recording": name});
        if !every.is_null() {
            args["every"] = every;
        }
        begin(&client, args).await;
    }
    let until_step = json!({"until_step": 2000});
    client.ok("school", "run", until_step).await;
    client.wait_for_step("school", 2000).await;
    for (name, every) in [("all", 1), ("some", 7), ("shown", 40)] {
        let stopped = stop(&client, name).await;
        assert_eq!(stopped["missed"], 0, "{stopped}");
        assert_eq!(stopped["every"], every, "{stopped}");
        assert_holds(data.path(), &stopped);
        let (states, about) = states(data.path(), name);
        let wanted: Vec<u64> = (0..=2000).step_by(every).collect();
        assert_eq!(stopped["frames"], wanted.len(), "{stopped}");
        assert_eq!(steps_of(&states), wanted, "{name}");
        assert_eq!(about["source"], "steps");
        assert_eq!(about["every"], every.to_string());
        let numbers: Vec<u64> = states.iter().map(|state| state.frame).collect();
        assert!(numbers.iter().copied().eq(1..=wanted.len() as u64));
        let mut reference = simulation(&spec);
        let mut recorded = states.iter().peekable();
        for step in 0..=2000 {
            if let Some(state) = recorded.next_if(|state| state.step == step) {
                assert_eq!(
                    hash(state, &reference),
                    reference.state.hash(),
                    "{name}, step {step}"
                );
            }
            reference.step().unwrap();
        }
        assert!(recorded.next().is_none());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_that_begins_between_two_multiples_keeps_to_multiples_over_a_reset() {
    let data = tempfile::tempdir().unwrap();
    let (_process, client) = start_daemon(data.path(), "").await;
    client.create("school", json!({"n": 5, "rate": null})).await;
    client.ok("school", "step", json!({"steps": 7})).await;
    begin(
        &client,
        json!({"swarm": "school", "recording": "take", "every": 5}),
    )
    .await;
    client.ok("school", "step", json!({"steps": 9})).await;
    // A command between two steps adds no state.
    let inform = json!({"select": {"count": 2}, "direction": 0.5});
    client.ok("school", "inform", inform).await;
    client.ok("school", "step", json!({"steps": 5})).await;
    client.ok("school", "reset", json!({})).await;
    client.ok("school", "step", json!({"steps": 6})).await;
    let stopped = stop(&client, "take").await;
    let (states, _) = states(data.path(), "take");
    let epoch = states[0].epoch;
    let at: Vec<_> = states
        .iter()
        .map(|it| (it.epoch - epoch, it.step))
        .collect();
    assert_eq!(at, [(0, 10), (0, 15), (0, 20), (1, 0), (1, 5)], "{stopped}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_of_so_many_steps_ends_with_the_last_of_them() {
    let data = tempfile::tempdir().unwrap();
    let (_process, client) = start_daemon(data.path(), "").await;
    client.create("school", json!({"n": 5, "rate": null})).await;
    client.ok("school", "step", json!({"steps": 3})).await;
    let args = json!({"swarm": "school", "recording": "take", "every": 1, "steps": 100});
    begin(&client, args).await;
    client.ok("school", "step", json!({"steps": 1000})).await;
    let ended = wait_until_ended(&client, "take").await;
    assert_eq!(ended["phase"], "ended", "{ended}");
    assert_eq!(ended["reason"], "all its steps are recorded");
    let steps = steps_of(&states(data.path(), "take").0);
    assert_eq!(steps, (3..=103).collect::<Vec<_>>());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_swarm_waits_for_a_slow_disk_and_answers_commands_meanwhile() {
    let data = tempfile::tempdir().unwrap();
    let (_process, client) = start_daemon(data.path(), "recording-frame=sleep(20)").await;
    client.create("school", json!({"n": 5, "rate": null})).await;
    begin(
        &client,
        json!({"swarm": "school", "recording": "take", "every": 1}),
    )
    .await;
    let began = Instant::now();
    client.ok("school", "run", json!({"until_step": 250})).await;
    // The queue is soon full: 250 states take 5 s to write, and a moment to step.
    tokio::time::sleep(Duration::from_secs(1)).await;
    let step = client.get("school", "status").await["step"]
        .as_u64()
        .unwrap();
    assert!(step < 150, "it is at {step} and waits for nothing");
    for verb in ["set", "pause", "run"] {
        let args = match verb {
            "set" => json!({"pi3": 1.1}),
            "run" => json!({"until_step": 250}),
            _ => json!({}),
        };
        client.ok("school", verb, args).await;
    }
    client.wait_for_step("school", 250).await;
    let took = began.elapsed();
    assert!(took > Duration::from_secs(3), "it did not wait: {took:?}");
    let stopped = stop(&client, "take").await;
    assert_eq!(stopped["missed"], 0, "{stopped}");
    let steps = steps_of(&states(data.path(), "take").0);
    assert_eq!(steps, (0..=250).collect::<Vec<_>>());
}

#[tokio::test(flavor = "multi_thread")]
async fn stopping_a_recording_that_holds_its_swarm_up_lets_it_step_on() {
    let data = tempfile::tempdir().unwrap();
    let (_process, client) =
        start_daemon(data.path(), "recording-frame=3*off->sleep(600000)").await;
    for swarm in ["school", "other"] {
        client.create(swarm, json!({"n": 5, "rate": null})).await;
    }
    begin(
        &client,
        json!({"swarm": "school", "recording": "take", "every": 1}),
    )
    .await;
    for swarm in ["school", "other"] {
        client.ok(swarm, "run", json!({})).await;
    }
    let mut last = 0;
    until("the queue is full", async || {
        let step = client.get("school", "status").await["step"]
            .as_u64()
            .unwrap();
        let stands_still = step > 0 && step == last;
        last = step;
        tokio::time::sleep(Duration::from_millis(100)).await;
        stands_still
    })
    .await;
    assert!(last < 200, "{last}");
    // While the writer thread sleeps for ten minutes, commands are executed and another swarm steps.
    for (verb, args) in [
        ("set", json!({"pi3": 1.1})),
        ("pause", json!({})),
        ("run", json!({})),
    ] {
        client.ok("school", verb, args).await;
    }
    let step = client.get("other", "status").await["step"]
        .as_u64()
        .unwrap();
    client.wait_for_step("other", step + 1000).await;
    // The writer thread is blocked on the disk, so `stop` fails as `busy`; the swarm continues.
    let (code, message) = error_of(&client, json!({"stop": {"recording": "take"}})).await;
    assert_eq!(code, jostle_proto::ErrorCode::Busy, "{message}");
    client.wait_for_step("school", last + 1000).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_recorded_and_what_was_left_out_are_all_the_steps() {
    let data = tempfile::tempdir().unwrap();
    let (_process, client) = start_daemon(data.path(), "recording-frame=sleep(5)").await;
    client.create("school", json!({"n": 5, "rate": null})).await;
    let args =
        json!({"swarm": "school", "recording": "take", "every": 1, "drop_when_behind": true});
    begin(&client, args).await;
    client.ok("school", "step", json!({"steps": 2000})).await;
    let stopped = stop(&client, "take").await;
    let (frames, missed) = (&stopped["frames"], &stopped["missed"]);
    let all = frames.as_u64().unwrap() + missed.as_u64().unwrap();
    assert_eq!(all, 2001, "{stopped}");
    assert!(missed.as_u64() > Some(0), "{stopped}");
    assert_eq!(states(data.path(), "take").1["missed"], missed.to_string());
}

#[tokio::test(flavor = "multi_thread")]
async fn the_count_of_missed_states_survives_a_restart() {
    let data = tempfile::tempdir().unwrap();
    let (mut process, client) = start_daemon(data.path(), "recording-frame=sleep(5)").await;
    client.create("school", json!({"n": 5, "rate": null})).await;
    let args =
        json!({"swarm": "school", "recording": "take", "every": 1, "drop_when_behind": true});
    begin(&client, args).await;
    client.ok("school", "step", json!({"steps": 2000})).await;
    let before = recording_status(&client, "take").await["missed"].as_u64();
    assert!(before > Some(0), "{before:?}");
    process.stop();
    assert_eq!(process.end(), Some(0));
    let (_process, client) = start_daemon(data.path(), "").await;
    let stopped = stop(&client, "take").await;
    assert_eq!(stopped["missed"].as_u64(), before, "{stopped}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_disk_ends_a_lossless_recording_and_its_swarm_steps_on() {
    let Some(disk) = SmallDisk::mount(16) else {
        return;
    };
    let (_process, client) = start_daemon(disk.path(), "").await;
    client
        .create("school", json!({"n": 200, "rate": null}))
        .await;
    begin(
        &client,
        json!({"swarm": "school", "recording": "take", "every": 1}),
    )
    .await;
    client.ok("school", "run", json!({})).await;
    let failed = wait_until_ended(&client, "take").await;
    assert_eq!(failed["phase"], "failed", "{failed}");
    let reason = failed["reason"].as_str().unwrap();
    assert!(reason.contains("the disk is full"), "{failed}");
    assert_holds(disk.path(), &failed);
    let steps = steps_of(&states(disk.path(), "take").0);
    assert!(
        steps.iter().copied().eq(0..steps.len() as u64),
        "no step is missing before"
    );
    let step = client.get("school", "status").await["step"]
        .as_u64()
        .unwrap();
    client.wait_for_step("school", step + 100).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_ends_at_its_size_and_all_of_them_at_the_quota() {
    let data = tempfile::tempdir().unwrap();
    let mut command = crate::support::daemon_process::daemon(data.path());
    command.args(["--recordings-quota-mb", "4"]);
    let process = crate::support::daemon_process::DaemonProcess::start(&mut command).unwrap();
    let client = Client::open(&process.endpoint).await;
    client
        .create("school", json!({"n": 100, "rate": null}))
        .await;
    let args = json!({"swarm": "school", "recording": "small", "every": 1, "max_bytes": 2_000_000});
    let begun = begin(&client, args).await;
    assert_eq!(begun["max_bytes"], 2_000_000);
    client.ok("school", "run", json!({})).await;
    let small = wait_until_ended(&client, "small").await;
    assert_eq!(small["phase"], "ended", "{small}");
    assert!(
        small["reason"]
            .as_str()
            .unwrap()
            .contains("max_bytes (2000000)"),
        "{small}"
    );
    let bytes = small["bytes"].as_u64().unwrap();
    assert!((1_500_000..=2_000_000).contains(&bytes), "{small}");
    assert_holds(data.path(), &small);

    let args = json!({"swarm": "school", "recording": "large", "every": 1});
    let begun = begin(&client, args).await;
    assert_eq!(begun["max_bytes"], 1_u64 << 30);
    let large = wait_until_ended(&client, "large").await;
    assert_eq!(large["phase"], "failed", "{large}");
    assert!(
        large["reason"]
            .as_str()
            .unwrap()
            .contains("recordings_quota_mb"),
        "{large}"
    );
    assert_holds(data.path(), &large);
    let step = client.get("school", "status").await["step"]
        .as_u64()
        .unwrap();
    client.wait_for_step("school", step + 100).await;
    let begin_another = json!({"begin": {"swarm": "school"}});
    let (code, message) = error_of(&client, begin_another.clone()).await;
    assert_eq!(
        code,
        jostle_proto::ErrorCode::ResourceExhausted,
        "{message}"
    );
    assert!(message.contains("delete one"), "{message}");
    ok(&client, json!({"delete": {"recording": "large"}})).await;
    ok(&client, begin_another).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn after_a_kill_the_steps_are_evenly_spaced_in_each_epoch() {
    let data = tempfile::tempdir().unwrap();
    let points = "recording-part=return(200)";
    let (mut process, client) = start_daemon(data.path(), points).await;
    client
        .create("school", json!({"n": 10, "rate": null}))
        .await;
    let args = json!({"swarm": "school", "recording": "take", "every": 3, "steps": 1_000_000_000});
    begin(&client, args).await;
    client.ok("school", "run", json!({})).await;
    has(&client, "take", "parts", 2).await;
    process.kill();
    let (_process, client) = start_daemon(data.path(), points).await;
    let before = recording_status(&client, "take").await["parts"]
        .as_u64()
        .unwrap();
    has(&client, "take", "parts", before + 2).await;
    let stopped = stop(&client, "take").await;
    assert_eq!(stopped["every"], 3);
    let (states, _) = states(data.path(), "take");
    for pair in states.windows(2) {
        let [a, b] = pair else { unreachable!() };
        assert_eq!(b.step % 3, 0);
        assert!(
            b.epoch > a.epoch || b.step == a.step + 3,
            "{} {}",
            a.step,
            b.step
        );
    }
    let epochs = states.last().unwrap().epoch - states[0].epoch;
    assert_eq!(epochs, 1, "both lives are in it");
}
