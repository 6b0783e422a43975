//! Protocols that are played as swarms, compared with the runs of their files.

use jostle_experiment::{Files, LiveCommand, LiveRun, Plan, execute_run};
use serde_json::json;

use super::{fired, restore, snapshot_of, verifies};
use crate::support::Daemon;
use crate::support::daemon_process::{killed, start};

/// Blocks with conditions, which draw, among others that draw; two are equal, and need earlier states.
const PROTOCOL: &str = r#"
name = "play"
seed = 5
replicates = 3
duration = 16
[spec]
n = 14
noise = 0.05
[[grid]]
informed = [0, 4]
[[at]]
when = "order > 0.9 for 3"
inject = { count = 2 }
inform = { select = { fraction = 0.3 }, direction = 2 }
[[at]]
every = 1
from = 0
until = 12
inform = { select = { count = 1 }, direction = -1 }
[[at]]
when = "msd(2) > 0.5 and order >= 0"
from = 3
remove = { select = { count = 2 } }
[[at]]
when = "msd(2) > 0.5 and order >= 0"
from = 3
remove = { select = { count = 2 } }
[[at]]
when = "order >= 0"
uninform = { select = { fraction = 0.5 } }
[[at]]
when = "radius_of_gyration > 1 for 5"
draw = 900
inform = { select = { count = 2 }, direction = 0.5 }
"#;

/// Plays the runs of a file, and compares each with its row. Kills the daemon in the middle.
async fn plays_as_its_runs(plan: &Plan, is_stopped: bool) {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    for (k, run) in plan.runs().iter().enumerate() {
        let swarm = format!("run-{k}");
        let live = LiveRun::new(plan, run).unwrap();
        let spec = serde_json::to_value(&live.spec).unwrap();
        match &live.snapshot {
            Some(snapshot) => restore(&daemon.1, snapshot, &swarm).await,
            None => drop(daemon.1.create(&swarm, spec).await),
        }
        for command in &live.commands {
            match command {
                LiveCommand::Batch { step, args } => {
                    let request = json!({"at_step": step, "args": args});
                    daemon.1.ok(&swarm, "batch", request).await;
                }
                LiveCommand::When(args) => {
                    daemon
                        .1
                        .ok(&swarm, "when", serde_json::to_value(args).unwrap())
                        .await;
                }
            }
        }
        let until = json!({"until_step": 120, "rate": null});
        daemon.1.ok(&swarm, "run", until).await;
        daemon.1.wait_for_step(&swarm, 120).await;
        daemon = killed(folder.path(), daemon).await;
        let until = json!({"until_step": live.steps, "rate": null});
        daemon.1.ok(&swarm, "run", until).await;
        let status = daemon.1.get(&swarm, "wait?phase=paused").await;
        let row = execute_run(plan, run, |_| true).unwrap().row.unwrap();
        assert_eq!(status["step"].as_u64(), Some(row.steps), "{status}");
        assert_eq!(
            status["result"]["state_hash"], row.state_hash,
            "{}",
            run.name
        );
        let reason = if is_stopped { "condition" } else { "finished" };
        assert_eq!(status["result"]["reason"], reason);
        assert_eq!(status["result"]["scheduled"], 0, "{status}");
        let count = fired(&daemon.1, &swarm).await.len();
        assert!(count >= 2, "{count} fired");
        verifies(&daemon.1, &swarm).await;
        if live.snapshot.is_some() {
            continue;
        }
        // Its commands as a file give the same state.
        let reply = daemon.1.get(&swarm, "experiment").await;
        let text = reply["result"]["file"].as_str().unwrap();
        let found = Plan::parse(text).unwrap_or_else(|error| panic!("{error}\n{text}"));
        let again = execute_run(&found, &found.runs()[0], |_| true).unwrap();
        assert_eq!(again.row.unwrap().state_hash, row.state_hash, "{text}");
    }
    daemon.0.kill();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_played_protocol_has_the_states_of_its_run() {
    plays_as_its_runs(&Plan::parse(PROTOCOL).unwrap(), false).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_played_stop_pauses_in_the_last_state_of_the_run() {
    // It holds at the step of a repeated block, whose commands are not executed.
    let stop = format!("{PROTOCOL}[stop]\nfrom = 8\nwhen = \"order >= 0 for 1\"\n");
    plays_as_its_runs(&Plan::parse(&stop).unwrap(), true).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_played_run_from_a_snapshot_has_its_states() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let spec = json!({"n": 14, "dt": 0.1, "noise": 0.05, "seed": 8});
    client.create("grown", spec).await;
    // Informed for a time that ends in the run, and with draws of a protocol.
    let inform = json!({"verb": "inform", "args": {"select": {"count": 4}, "direction": 1,
                        "for_time": 6}});
    let batch = json!({"commands": [inform], "protocol": true});
    client.ok("grown", "batch", batch).await;
    client.ok("grown", "step", json!({"steps": 30})).await;
    let snapshot = snapshot_of(client, "grown").await;
    let start = format!("start = \"grown.snapshot\"\n{PROTOCOL}");
    let files = Files {
        toml: start
            .replace("n = 14\n", "")
            .replace("informed = [0, 4]", "pi3 = [1, 1.5]"),
        start: Some(snapshot),
        ..Files::default()
    };
    plays_as_its_runs(&Plan::of(files).unwrap(), false).await;
    daemon.stop().await;
}
