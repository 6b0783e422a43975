//! Conditions: a swarm pauses or changes at the first step after which one holds, also after kills, in
//! forks and in restored snapshots.

mod costs;
mod events;
mod past;
mod played;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_experiment::{Plan, execute_run};
use jostle_physics::model::selection::Selection;
use jostle_physics::simulation::{Change, Simulation, Spec};
use jostle_proto::{ErrorCode, Reply, Snapshot, keys};
use serde_json::{Value, json};

use crate::commands::fault;
use crate::support::daemon_process::{killed, start};
use crate::support::process::Process;
use crate::support::{Client, Daemon, NODE, PREFIX};

const N: usize = 12;
const SEED: u64 = 5;

/// Holds for the first time long after the order has exceeded 0.9 for the first time.
pub const CONDITION: &str = "order > 0.9 for 4";

pub fn spec() -> Value {
    json!({"n": N, "seed": SEED, "rate": null})
}

pub fn inform() -> Value {
    json!({"select": {"ids": [0, 1, 2, 3, 4]}, "direction": 1.0})
}

pub fn pause(condition: &str) -> Value {
    json!({"condition": condition, "pause": true})
}

/// The states after each step: positions and headings.
type Poses = Vec<[f64; 3]>;

/// The number of steps after which `holds` first holds on the states so far.
fn first_step(mut holds: impl FnMut(&[Poses]) -> bool) -> u64 {
    let mut simulation = Simulation::new(&Spec::new(N, SEED)).unwrap();
    simulation
        .apply(&Change::inform(Selection::Ids((0..5).collect()), 1.0))
        .unwrap();
    let mut states: Vec<Poses> = Vec::new();
    loop {
        let it = &simulation.state.configuration;
        states.push((0..N).map(|k| [it.x[k], it.y[k], it.alpha[k]]).collect());
        if states.len() > 1 && holds(&states) {
            return states.len() as u64 - 1;
        }
        assert!(states.len() < 20_000, "it does not hold");
        simulation.step().unwrap();
    }
}

/// The first step after which the order was above 0.9 for 4 time units, which are 200 steps.
pub fn expected_step() -> u64 {
    let mut in_a_row = 0;
    first_step(|states| {
        let sum = |of: fn(f64) -> f64| {
            states
                .last()
                .unwrap()
                .iter()
                .map(|it| of(it[2]))
                .sum::<f64>()
        };
        let order = sum(f64::cos).hypot(sum(f64::sin)) / N as f64;
        in_a_row = if order > 0.9 { in_a_row + 1 } else { 0 };
        in_a_row == 201
    })
}

async fn create_informed(client: &Client, name: &str) {
    client.create(name, spec()).await;
    client.ok(name, "inform", inform()).await;
}

/// Runs a swarm until it pauses, and returns its status.
async fn run(client: &Client, swarm: &str) -> Value {
    client.ok(swarm, "run", json!({"rate": null})).await;
    client.get(swarm, "wait?phase=paused").await
}

/// Runs a swarm, which must pause because of its condition at `step`.
async fn pauses_at(client: &Client, swarm: &str, step: u64) {
    let status = run(client, swarm).await;
    assert_eq!(status["step"], step, "{swarm}: {status}");
    assert_eq!(status["result"]["reason"], "condition", "{swarm}");
    assert_eq!(status["result"]["when"], Value::Null, "{swarm}");
}

async fn waiting(client: &Client, swarm: &str) -> Value {
    client.get(swarm, "status").await["result"]["when"].take()
}

/// The steps and the arguments of the internal commands in the journal.
async fn fired(client: &Client, swarm: &str) -> Vec<(u64, Value)> {
    let journal = client.get(swarm, "journal?limit=1000").await;
    let entries = journal["result"]["entries"].as_array().unwrap().iter();
    let fired = entries.filter(|entry| entry["verb"] == "fired");
    fired
        .map(|entry| (entry["step"].as_u64().unwrap(), entry["args"].clone()))
        .collect()
}

async fn verifies(client: &Client, swarm: &str) {
    let verified = client.get(swarm, "verify").await["result"].take();
    assert_eq!(verified["differs_at"], Value::Null, "{verified}");
    let step = client.get(swarm, "status").await["step"].clone();
    assert_eq!(verified["to_step"], step, "{verified}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_swarm_pauses_once_at_the_first_step_after_which_the_condition_holds() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let step = expected_step();
    assert!(step > 201, "it holds from the start");
    for name in ["run", "stepped", "ends"] {
        create_informed(client, name).await;
        assert_eq!(waiting(client, name).await, Value::Null);
        let reply = client.ok(name, "when", pause(" order>0.90 for 4.0")).await;
        assert_eq!(reply["result"]["holds"], Value::Null);
        assert_eq!(waiting(client, name).await, json!([CONDITION]));
    }
    pauses_at(client, "run", step).await;
    assert_eq!(fired(client, "run").await, [(step, pause(CONDITION))]);
    let events = client.get("run", "events?limit=1000").await;
    let events = events["result"]["events"].as_array().unwrap().clone();
    let of_verb = |verb: &str| {
        let mut events = events.iter();
        let event = events.find(|it| it["event"]["verb"] == verb);
        event.unwrap_or_else(|| panic!("no event {verb}"))["step"].clone()
    };
    assert_eq!([of_verb("when"), of_verb("fired")], [json!(0), json!(step)]);
    verifies(client, "run").await;

    // A `step` is cut short, and takes the rest afterwards.
    let request = json!({"timeout_secs": 60, "args": {"steps": step + 50}});
    let reply = client.ok("stepped", "step", request).await;
    assert_eq!(reply["result"]["steps"], step, "{reply}");
    let reply = client.ok("stepped", "step", json!({"steps": 50})).await;
    assert_eq!(reply["result"]["steps"], 50, "{reply}");
    verifies(client, "stepped").await;

    // The end of the run and the condition at the same step.
    let until = json!({"until_step": step, "rate": null});
    client.ok("ends", "run", until).await;
    let status = client.wait_for_step("ends", step).await;
    assert_eq!(status["result"]["reason"], "condition");
    assert_eq!(fired(client, "ends").await.len(), 1);
    verifies(client, "ends").await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn kills_do_not_change_the_step() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    let step = expected_step();
    create_informed(&daemon.1, "a").await;
    daemon.1.ok("a", "when", pause(CONDITION)).await;
    // In the middle of the duration, once with a durable command there.
    for (to, is_durable) in [(step - 150, false), (step - 100, true), (step - 1, true)] {
        let until = json!({"until_step": to, "rate": null});
        daemon.1.ok("a", "run", until).await;
        daemon.1.wait_for_step("a", to).await;
        if is_durable {
            daemon.1.ok("a", "pause", json!({})).await;
        }
        daemon = killed(folder.path(), daemon).await;
        assert_eq!(waiting(&daemon.1, "a").await, json!([CONDITION]));
    }
    pauses_at(&daemon.1, "a", step).await;
    let before = daemon.1.get("a", "status").await;
    // The command is durable, so that the swarm stays paused.
    daemon.1.ok("a", "annotate", json!({"text": "here"})).await;
    daemon = killed(folder.path(), daemon).await;
    let after = daemon.1.get("a", "status").await;
    for field in ["step", "phase"] {
        assert_eq!(after[field], before[field]);
    }
    for field in ["state_hash", "reason", "when"] {
        assert_eq!(after["result"][field], before["result"][field]);
    }
    assert_eq!(fired(&daemon.1, "a").await, [(step, pause(CONDITION))]);
    verifies(&daemon.1, "a").await;
    daemon.0.kill();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_condition_whose_normal_form_is_too_long_survives_a_kill_and_is_copied() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    create_informed(&daemon.1, "a").await;
    let dense = ["order>0.999"; 66].join(" or ");
    let normal = dense.replace('>', " > ");
    assert!(dense.len() < 1000 && normal.len() > 1000);
    // The second one replaces the first.
    for _ in 0..2 {
        daemon.1.ok("a", "when", pause(&dense)).await;
    }
    daemon.1.ok("a", "step", json!({"steps": 5})).await;
    daemon = killed(folder.path(), daemon).await;
    assert_eq!(waiting(&daemon.1, "a").await, json!([normal]));
    let copy = snapshot_of(&daemon.1, "a").await;
    restore(&daemon.1, &copy, "b").await;
    assert_eq!(waiting(&daemon.1, "b").await, json!([normal]));
    verifies(&daemon.1, "a").await;
    daemon.0.kill();
}

/// The snapshot file of a swarm.
pub async fn snapshot_of(client: &Client, swarm: &str) -> Vec<u8> {
    let replies = client.session.get(keys::get(PREFIX, swarm, "snapshot"));
    let sample = replies.await.unwrap().recv_async().await.unwrap();
    let sample = sample.into_result().unwrap();
    let reply: Reply<Snapshot> = ciborium::from_reader(&*sample.payload().to_bytes()).unwrap();
    jostle_proto::to_cbor(&reply.result)
}

/// Creates a swarm from a snapshot file.
pub async fn restore(client: &Client, snapshot: &[u8], name: &str) {
    let args = json!({"name": name, "snapshot": STANDARD.encode(snapshot)}).to_string();
    let key = keys::node_cmd(PREFIX, NODE, "restore");
    client.query(&key, Some(args.as_bytes())).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn copies_in_the_middle_of_a_duration_pause_at_the_same_step() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let step = expected_step();
    create_informed(client, "a").await;
    client.ok("a", "when", pause(CONDITION)).await;
    let before = json!({"timeout_secs": 60, "args": {"steps": step - 80}});
    client.ok("a", "step", before).await;
    client.ok("a", "fork", json!({"name": "forked"})).await;
    restore(client, &snapshot_of(client, "a").await, "restored").await;
    let earlier = json!({"name": "earlier", "step": step - 120});
    client.ok("a", "fork", earlier).await;
    let daemon = daemon.restart().await;
    let client = &daemon.client;
    for name in ["a", "forked", "restored", "earlier"] {
        assert_eq!(waiting(client, name).await, json!([CONDITION]), "{name}");
        pauses_at(client, name, step).await;
        verifies(client, name).await;
    }
    // A fork at the step itself is made after the condition, as after scheduled commands.
    client.ok("a", "step", json!({"steps": 3})).await;
    let there = json!({"name": "there", "step": step});
    client.ok("a", "fork", there).await;
    assert_eq!(waiting(client, "there").await, Value::Null);
    daemon.stop().await;
}

/// Two changes that draw, and one that is executed at the same step because it is scheduled.
fn drawing(condition: &str, count: u64) -> Value {
    json!({"condition": condition, "commands": [
        {"verb": "inject", "args": {"count": count}},
        {"verb": "inform", "args": {"select": {"fraction": 0.3}, "direction": -1.0}},
    ]})
}

#[tokio::test(flavor = "multi_thread")]
async fn commands_that_draw_are_applied_once_and_replayed() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    let step = expected_step();
    create_informed(&daemon.1, "a").await;
    for request in [
        drawing(CONDITION, 2),
        drawing("order > 0.9 for 4 and order < 2", 3),
    ] {
        daemon.1.ok("a", "when", request).await;
    }
    let scheduled = json!({"at_step": step, "args": {"select": {"count": 2}}});
    daemon.1.ok("a", "remove", scheduled).await;
    let steps = json!({"timeout_secs": 60, "args": {"steps": step + 40}});
    daemon.1.ok("a", "step", steps).await;
    assert_eq!(waiting(&daemon.1, "a").await, Value::Null);
    let status = daemon.1.get("a", "status").await;
    assert_eq!(status["result"]["n"], N + 2 + 3 - 2, "{status}");
    let fired_before = fired(&daemon.1, "a").await;
    assert_eq!(
        fired_before,
        [
            (step, drawing(CONDITION, 2)),
            (step, drawing("order > 0.9 for 4 and order < 2", 3)),
        ]
    );
    verifies(&daemon.1, "a").await;

    // The file has the changes at their step, with the same draws.
    let reply = daemon.1.get("a", "experiment").await;
    let file = reply["result"]["file"].as_str().unwrap();
    let plan = Plan::parse(file).unwrap_or_else(|error| panic!("{error}\n{file}"));
    let finished = execute_run(&plan, &plan.runs()[0], |_| true).unwrap();
    let hash = finished.row.unwrap().state_hash;
    assert_eq!(hash, status["result"]["state_hash"], "{file}");

    daemon = killed(folder.path(), daemon).await;
    let again = daemon.1.hash_at("a", step + 40).await;
    assert_eq!(again, status["result"]["state_hash"]);
    assert_eq!(fired(&daemon.1, "a").await, fired_before);
    daemon.1.ok("a", "pause", json!({})).await;
    verifies(&daemon.1, "a").await;
    daemon.0.kill();
}

#[tokio::test(flavor = "multi_thread")]
async fn commands_that_are_impossible_are_rejected_once() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    create_informed(&daemon.1, "a").await;
    let remove = json!({"verb": "remove", "args": {"select": {"ids": [7]}}});
    let request = json!({"condition": "order >= 0", "commands": [remove]});
    daemon.1.ok("a", "when", request.clone()).await;
    daemon
        .1
        .ok("a", "remove", json!({"select": {"ids": [7]}}))
        .await;
    for _ in 0..2 {
        daemon.1.ok("a", "step", json!({"steps": 5})).await;
        assert_eq!(waiting(&daemon.1, "a").await, Value::Null);
        let events = daemon.1.get("a", "events?limit=1000").await;
        let events = events["result"]["events"].as_array().unwrap();
        let refused = events.iter().filter(|it| it["event"]["kind"] == "refused");
        let refused: Vec<_> = refused
            .map(|it| [&it["step"], &it["event"]["verb"]])
            .collect();
        assert_eq!(refused, [[&json!(1), &json!("fired")]]);
        assert_eq!(fired(&daemon.1, "a").await, []);
        verifies(&daemon.1, "a").await;
        daemon = killed(folder.path(), daemon).await;
    }
    daemon.0.kill();
}

#[tokio::test(flavor = "multi_thread")]
async fn reset_and_cancel_remove_all_conditions() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", spec()).await;
    let texts = ["order >= 0", "order > 0.2"];
    for (verb, args) in [("reset", json!({})), ("when", json!({"cancel": true}))] {
        for text in texts {
            client.ok("a", "when", pause(text)).await;
        }
        assert_eq!(waiting(client, "a").await, json!(texts));
        client.ok("a", verb, args).await;
        assert_eq!(waiting(client, "a").await, Value::Null, "{verb}");
        let reply = client.ok("a", "step", json!({"steps": 5})).await;
        assert_eq!(reply["result"]["steps"], 5, "{verb}");
    }
    // Nothing is left to remove.
    client.ok("a", "when", json!({"cancel": true})).await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_conditions_are_rejected_and_change_nothing() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", spec()).await;
    client.ok("a", "when", pause("order > 0.99")).await;
    let long = format!("order > 0{}", " ".repeat(1000));
    for (condition, part) in [
        ("", "column 1"),
        ("ordr > 0.9", "order"),
        ("order > nan", "column 9"),
        ("order > 1e999", "finite"),
        ("order > 0.9 for 0", "above 0"),
        ("order > $share", "$share"),
        ("msd > 2", "lag"),
        ("drift > 0 and order > 1.5", "0 to 1"),
        // 12,501 steps of 12 individuals, and 8 for each step.
        ("order > 0 or msd(250.02) > 1", "250020 poses"),
        ("msd(1e300) > 1", "250000"),
        (&*long, "1000"),
    ] {
        let (code, message) = client.err("a", "when", pause(condition)).await;
        assert_eq!(code, ErrorCode::InvalidArgument, "{condition}: {message}");
        assert!(message.contains(part), "{condition}: {message}");
    }
    let set = json!([{"verb": "set", "args": {"pi3": 2}}]);
    for args in [
        json!({}),
        json!({"pause": true}),
        json!({"condition": "order > 0"}),
        json!({"condition": "order > 0", "pause": false}),
        json!({"condition": "order > 0", "commands": []}),
        json!({"condition": "order > 0", "commands": [{"verb": "pause", "args": {}}]}),
        json!({"condition": "order > 0", "pause": true, "commands": set}),
        json!({"condition": "order > 0", "cancel": true}),
        json!({"condition": "order > 0", "pause": true, "cancel": true}),
        json!({"cancel": true, "pause": true}),
        json!({"cancel": false}),
        json!({"condition": 3, "pause": true}),
        json!({"condition": "order > 0", "commands": [
            {"verb": "set", "args": {"pi1": 99}}]}),
    ] {
        let (code, message) = client.err("a", "when", args.clone()).await;
        assert_eq!(code, ErrorCode::InvalidArgument, "{args}: {message}");
    }
    assert_eq!(waiting(client, "a").await, json!(["order > 0.99"]));
    // One with the same text and action replaces the one that waits.
    client.ok("a", "when", pause("order>0.99")).await;
    for k in 1..16 {
        client
            .ok("a", "when", pause(&format!("order > 0.{k:02}9")))
            .await;
    }
    let (code, message) = client.err("a", "when", pause("order > 0.5")).await;
    assert_eq!(code, ErrorCode::ResourceExhausted, "{message}");
    assert!(message.contains("16"), "{message}");
    client.ok("a", "when", pause("order > 0.99")).await;
    assert_eq!(waiting(client, "a").await.as_array().unwrap().len(), 16);
    fault(client, "b").await;
    for args in [pause("order > 0"), json!({"cancel": true})] {
        let (code, _) = client.err("b", "when", args).await;
        assert_eq!(code, ErrorCode::IncorrectState);
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_condition_ends_the_advance_of_controllers_in_lockstep() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let advance = |controller: &str, steps: u64| json!({"timeout_secs": 60, "args": {"controller": controller, "steps": steps}});
    // At the last step of both advances, of one, and of none.
    for (name, one, other) in [("last", 1, 1), ("one", 1, 5), ("none", 5, 5)] {
        client.create(name, spec()).await;
        for controller in ["one", "other"] {
            let join = json!({"controller": controller, "mode": "lockstep", "deadline_secs": 60});
            client.ok(name, "join", join).await;
        }
        client.ok(name, "when", pause("order >= 0")).await;
        let (first, second) = tokio::join!(
            client.ok(name, "advance", advance("one", one)),
            client.ok(name, "advance", advance("other", other)),
        );
        for reply in [first, second] {
            assert_eq!(reply["result"]["steps"], 1, "{name}: {reply}");
        }
        let status = client.get(name, "status").await;
        assert_eq!(status["result"]["reason"], "condition", "{name}");
        assert_eq!(fired(client, name).await.len(), 1, "{name}");
        // They may advance again.
        let (first, second) = tokio::join!(
            client.ok(name, "advance", advance("one", 3)),
            client.ok(name, "advance", advance("other", 3)),
        );
        assert_eq!((&first["step"], &second["step"]), (&json!(4), &json!(4)));
        verifies(client, name).await;
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_panic_in_a_condition_faults_the_swarm_alone() {
    let (_process, endpoint) = Process::serve_failing("condition=2*off->panic");
    let client = Client::open(&endpoint).await;
    for name in ["a", "b"] {
        client.create(name, spec()).await;
    }
    client.ok("a", "when", pause("order > 0.99999")).await;
    client.ok("a", "run", json!({"rate": null})).await;
    let status = client.get("a", "wait?phase=faulted").await;
    assert_eq!(status["step"], 3, "{status}");
    let reason = status["result"]["reason"].as_str().unwrap();
    assert!(reason.contains("condition"), "{reason}");
    client.ok("b", "step", json!({"steps": 5})).await;
    client.ok("a", "reset", json!({})).await;
    client.ok("a", "step", json!({"steps": 5})).await;
}
