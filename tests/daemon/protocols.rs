//! Runs of experiments and swarms with the same commands have the same states, in both directions:
//! the commands of a run are sent to a swarm, and those of a swarm become the file of a run.

use jostle_experiment::{LiveCommand, LiveRun, Plan, execute_run};
use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};

mod set_points;

use crate::support::daemon_process::{killed, start};
use crate::support::{Client, Daemon, PREFIX};

/// The file of a swarm's commands.
async fn file_of(client: &Client, swarm: &str) -> String {
    let reply = client.get(swarm, "experiment").await;
    reply["result"]["file"].as_str().unwrap().to_owned()
}

/// The last hash of the only run of a file.
fn last_hash(file: &str) -> String {
    let plan = Plan::parse(file).unwrap_or_else(|error| panic!("{error}\n{file}"));
    let [run] = plan.runs() else {
        panic!("{file}");
    };
    let finished = execute_run(&plan, run, |_| true).unwrap();
    assert_eq!(finished.fault, None, "{file}");
    finished.row.unwrap().state_hash
}

/// What a user does by hand, which the file of the swarm repeats.
const BY_HAND: [(&str, &str); 9] = [
    (
        "inform",
        r#"{"select": {"fraction": 0.3}, "direction": 0.5}"#,
    ),
    ("annotate", r#"{"text": "camera on"}"#),
    ("inject", r#"{"count": 3, "direction": 2}"#),
    ("run", r#"{"rate": null}"#),
    ("pause", "{}"),
    ("remove", r#"{"select": {"count": 5}}"#),
    (
        "batch",
        r#"{"commands": [
            {"verb": "set", "args": {"noise": 0.1, "pi1": 3, "make_room": true}},
            {"verb": "inform", "args": {"select": {"count": 4}, "direction": -1, "for_time": 0.5}},
            {"verb": "uninform", "args": {"select": {"fraction": 0.5}}}
        ]}"#,
    ),
    (
        "batch",
        r#"{"draw": 1000, "commands": [
            {"verb": "inform", "args": {"select": {"count": 2}, "direction": 3}},
            {"verb": "inject", "args": {"count": 2}}
        ]}"#,
    ),
    (
        "set",
        r#"{"pi3": 1.5, "attraction": {"kind": "metric", "radius": 5}}"#,
    ),
];

/// Steps after each of them.
const STEPS: u64 = 23;

#[tokio::test(flavor = "multi_thread")]
async fn the_file_of_a_swarm_has_a_run_with_its_hash_also_after_kills_and_a_reset() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    let spec = json!({"n": 20, "seed": 11, "dt": 0.04, "rate": null});
    daemon.1.create("school", spec).await;
    for epoch in 0..2 {
        for (k, (verb, args)) in BY_HAND.iter().enumerate() {
            let client = &daemon.1;
            let args: Value = serde_json::from_str(args).unwrap();
            client.ok("school", verb, args).await;
            if *verb != "run" {
                client.ok("school", "step", json!({"steps": STEPS})).await;
                let hash = client.hash("school").await;
                assert_eq!(
                    last_hash(&file_of(client, "school").await),
                    hash,
                    "{epoch} {verb}"
                );
            }
            if k % 3 == 2 {
                daemon = killed(folder.path(), daemon).await;
                // Not every step is durable before a command: it may take some of them again.
                daemon.1.get("school", "wait?phase=paused").await;
                daemon.1.ok("school", "step", json!({})).await;
            }
        }
        daemon
            .1
            .ok("school", "reset", json!({"seed": 12 + epoch}))
            .await;
    }
    // A command is scheduled, and one is rejected: only the first changes the state.
    let client = &daemon.1;
    let later = json!({"at_step": 5, "args": {"select": {"count": 6}, "direction": 1}});
    client.ok("school", "inform", later).await;
    client
        .err("school", "remove", json!({"select": {"ids": [999]}}))
        .await;
    client.ok("school", "step", json!({"steps": 9})).await;
    let file = file_of(client, "school").await;
    assert_eq!(file.matches("[[at]]").count(), 1, "{file}");
    assert_eq!(last_hash(&file), client.hash("school").await);
    // One more command, at the present step: the run takes one step more.
    client
        .ok("school", "remove", json!({"select": {"count": 2}}))
        .await;
    let file = file_of(client, "school").await;
    client.ok("school", "step", json!({})).await;
    assert_eq!(last_hash(&file), client.hash("school").await);
    daemon.0.kill();
}

#[tokio::test(flavor = "multi_thread")]
async fn swarms_that_no_file_can_repeat_are_rejected_with_the_reason() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let reason = async |swarm: &str| {
        let key = keys::get(PREFIX, swarm, "experiment");
        let error = client.query(&key, None).await.unwrap_err();
        assert_eq!(error.code, ErrorCode::Conflict, "{error:?}");
        error.message
    };
    client.create("new", json!({"n": 8})).await;
    assert!(reason("new").await.contains("has taken no step"));
    client.ok("new", "step", json!({"steps": 40})).await;
    client
        .ok(
            "new",
            "inform",
            json!({"select": {"count": 2}, "direction": 1}),
        )
        .await;
    client.ok("new", "fork", json!({"name": "later"})).await;
    client.ok("later", "step", json!({})).await;
    assert!(reason("later").await.contains("from step 40 on"));
    // From its own start on a file can repeat the copy.
    client.ok("later", "reset", json!({})).await;
    client.ok("later", "step", json!({"steps": 3})).await;
    let hash = client.hash("later").await;
    assert_eq!(last_hash(&file_of(client, "later").await), hash);

    // More changes than a file has blocks.
    client.create("busy", json!({"n": 8})).await;
    client.ok("busy", "step", json!({})).await;
    let changes = |count: u32| {
        let change = |k| json!({"verb": "set", "args": {"pi2": 0.5 + 1e-6 * f64::from(k)}});
        json!({"commands": (0..count).map(change).collect::<Vec<_>>()})
    };
    for count in [256, 256, 256, 232] {
        client.ok("busy", "batch", changes(count)).await;
    }
    let file = file_of(client, "busy").await;
    assert_eq!(file.matches("[[at]]").count(), 1000);
    client.ok("busy", "batch", changes(234)).await;
    let busy = reason("busy").await;
    for part in ["1234 changes", "at most 1000 [[at]]", "`jostle snapshot`"] {
        assert!(busy.contains(part), "{busy}");
    }
    assert!(!busy.contains("line "), "{busy}");

    client.create("steered", json!({"n": 8})).await;
    let join = json!({"controller": "ada", "select": {"ids": [0, 1]}});
    client.ok("steered", "join", join).await;
    client
        .ok(
            "steered",
            "advance",
            json!({"controller": "ada", "steps": 2}),
        )
        .await;
    let hash = client.hash("steered").await;
    assert_eq!(
        last_hash(&file_of(client, "steered").await),
        hash,
        "without set-points"
    );
    // Which of its individuals are its own is drawn from the state, and then it leaves.
    let free = json!({"controller": "ada", "again": true, "on_timeout": "free"});
    client.ok("steered", "join", free).await;
    let set = json!({"ids": [0], "direction": [1.0]});
    let advance = json!({"controller": "ada", "steps": 2, "set": set});
    client.ok("steered", "advance", advance).await;
    let drawn =
        json!({"controller": "ada", "again": true, "on_timeout": "free", "select": {"count": 1}});
    client.ok("steered", "join", drawn).await;
    let hash = client.hash("steered").await;
    assert_eq!(last_hash(&file_of(client, "steered").await), hash);
    client
        .ok("steered", "leave", json!({"controller": "ada"}))
        .await;
    let reason = reason("steered").await;
    assert!(
        reason.contains("the controller ada joined again"),
        "{reason}"
    );
    daemon.stop().await;
}

/// A number of a sequence that a seed determines.
struct Numbers(u64);

impl Numbers {
    fn below(&mut self, end: u64) -> u64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (self.0 >> 33) % end
    }
}

/// A protocol of at most `largest` individuals with this many commands at steps before `steps`, and a
/// ramp.
fn protocol(numbers: &mut Numbers, largest: u64, commands: u64, steps: u64) -> String {
    let n = 10 + numbers.below(largest - 9);
    let seed = numbers.below(1 << 31);
    let duration = steps as f64 * 0.05;
    let informed = numbers.below(4);
    let mut file = format!(
        "name = \"played\"\nseed = {seed}\nduration = {duration}\n[spec]\nn = {n}\ndt = 0.05\n\
         [[grid]]\ninformed = {informed}\n[[at]]\nevery = 0.35\nfrom = 0.5\nuntil = 2.5\n\
         set = {{ noise = {{ ramp = [0, 0.5] }} }}\n"
    );
    for _ in 0..commands {
        let step = numbers.below(steps);
        let direction = numbers.below(6);
        let count = 1 + numbers.below(3);
        let command = match numbers.below(6) {
            0 => format!("inject = {{ count = {count}, direction = {direction} }}"),
            1 => format!("remove = {{ select = {{ count = {count} }} }}"),
            2 => format!(
                "set = {{ pi1 = {}, make_room = true }}",
                1 + numbers.below(5)
            ),
            3 => "uninform = { select = { fraction = 0.5 } }".to_owned(),
            4 => format!(
                "inform = {{ select = {{ fraction = 0.2 }}, direction = {direction}, for_time = 1 }}"
            ),
            _ => format!(
                "inform = {{ select = {{ count = {count} }}, direction = {direction} }}\n\
                 set = {{ pi2 = 0.{} }}",
                4 + numbers.below(4)
            ),
        };
        file += &format!("[[at]]\nstep = {step}\n{command}\n");
    }
    file
}

#[tokio::test(flavor = "multi_thread")]
async fn a_swarm_with_the_commands_of_a_run_has_its_hash_although_the_daemon_is_killed() {
    let is_long = std::env::var_os("JOSTLE_LONG").is_some();
    let (protocols, largest, steps) = if is_long {
        (100, 200, 120)
    } else {
        (12, 60, 60)
    };
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    let mut numbers = Numbers(33);
    let (mut expected, mut played) = (Vec::new(), 0);
    for k in 0..4 * protocols {
        if expected.len() == protocols {
            break;
        }
        let file = protocol(&mut numbers, largest, 20, steps);
        let plan = Plan::parse(&file).unwrap_or_else(|error| panic!("{error}\n{file}"));
        let run = &plan.runs()[0];
        let finished = execute_run(&plan, run, |_| true).unwrap();
        // A command may be impossible, such as one that removes everybody.
        if finished.fault.is_some() {
            continue;
        }
        let live = LiveRun::new(&plan, run).unwrap();
        let name = format!("run-{k}");
        let client = &daemon.1;
        let spec = serde_json::to_value(&live.spec).unwrap();
        client.create(&name, spec).await;
        for command in &live.commands {
            let LiveCommand::Batch { step, args } = command else {
                panic!("{command:?}")
            };
            let request = json!({"at_step": step, "args": args});
            client.ok(&name, "batch", request).await;
        }
        let before = numbers.below(live.steps);
        client
            .ok(&name, "run", json!({"until_step": before, "rate": null}))
            .await;
        client.wait_for_step(&name, before).await;
        played += live.commands.len();
        expected.push((name, live.steps, finished.row.unwrap().state_hash));
        if k % 3 == 1 {
            daemon = killed(folder.path(), daemon).await;
        }
    }
    assert_eq!(expected.len(), protocols);
    assert!(played > 20 * protocols, "{played}");
    daemon = killed(folder.path(), daemon).await;
    for (name, steps, hash) in &expected {
        let until = json!({"until_step": steps, "rate": null});
        daemon.1.ok(name, "run", until).await;
        assert_eq!(&daemon.1.hash_at(name, *steps).await, hash, "{name}");
        // And back to a file.
        assert_eq!(&last_hash(&file_of(&daemon.1, name).await), hash, "{name}");
        let inform = json!({"select": {"fraction": 0.3}, "direction": 1});
        for (condition, verb, args) in [
            ("order > 0.01 for 0.2", "inform", inform),
            ("order <= 1", "set", json!({"pi3": 1.2})),
        ] {
            let commands = json!([{"verb": verb, "args": args}]);
            let when = json!({"condition": condition, "commands": commands});
            daemon.1.ok(name, "when", when).await;
        }
    }
    daemon = killed(folder.path(), daemon).await;
    for (name, ..) in &expected {
        daemon.1.get(name, "wait?phase=paused").await;
        daemon.1.ok(name, "step", json!({"steps": 20})).await;
        let file = file_of(&daemon.1, name).await;
        assert!(file.contains("pi3 = 1.2"), "no condition held: {file}");
        assert_eq!(last_hash(&file), daemon.1.hash(name).await, "{file}");
    }
    println!("{protocols} protocols with {played} batches, n up to {largest}");
    daemon.0.kill();
}
