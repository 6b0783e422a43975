//! An exchange and a short step are executed on the thread that reads the request.

use serde_json::json;

use crate::support::Daemon;

/// How often the thread of a swarm has slept and was woken.
fn wakings(swarm: &str) -> u64 {
    let is_of = |task: &std::path::Path| {
        let name = std::fs::read_to_string(task.join("comm")).unwrap_or_default();
        name.trim() == format!("swarm-{swarm}")
    };
    let tasks = std::fs::read_dir("/proc/self/task").unwrap();
    let task = tasks
        .map(|task| task.unwrap().path())
        .find(|task| is_of(task));
    let status = std::fs::read_to_string(task.unwrap().join("status")).unwrap();
    let switches = status
        .lines()
        .find_map(|line| line.strip_prefix("voluntary_ctxt_switches:"));
    switches.unwrap().trim().parse().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn an_exchange_wakes_no_thread_of_the_swarm() {
    let daemon = Daemon::start().await;
    let (client, swarm) = (&daemon.client, "exchanged");
    client.create(swarm, json!({"n": 12})).await;
    for controller in ["ada", "bob"] {
        let alone = json!({"controller": controller, "deadline_secs": 60});
        client.ok(swarm, "join", alone).await;
    }
    let exchanges = async |from: u64, count: u64| {
        for step in from..from + count {
            let request = |controller: &str| {
                json!({"expect_step": step, "timeout_secs": 20,
                    "args": {"controller": controller}})
            };
            let (ada, bob) = tokio::join!(
                client.cmd(swarm, "advance", request("ada")),
                client.cmd(swarm, "advance", request("bob")),
            );
            assert_eq!(ada.unwrap()["step"], step + 1);
            assert_eq!(bob.unwrap()["step"], step + 1);
        }
    };
    // How long a step takes is not known before the first.
    exchanges(0, 10).await;
    let mut woken = Vec::new();
    // A step that others interrupt is long, and the next one is left to the thread.
    for round in 0..10 {
        let before = wakings(swarm);
        exchanges(10 + 100 * round, 100).await;
        woken.push(wakings(swarm) - before);
    }
    let least = woken.iter().min().unwrap();
    assert!(*least < 25, "woken {woken:?} times in 100 exchanges each");
    // What waits for the thread came first, and nothing is lost between the two.
    client.ok(swarm, "set", json!({"pi3": 2.0})).await;
    exchanges(1010, 1).await;
    let status = client
        .ok(swarm, "leave", json!({"controller": "ada"}))
        .await;
    assert_eq!(status["step"], 1011);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_short_step_of_a_paused_swarm_wakes_no_thread_of_it_either() {
    let daemon = Daemon::start().await;
    let (client, swarm) = (&daemon.client, "stepped");
    client.create(swarm, json!({"n": 12})).await;
    let steps = async |count: u64| {
        for _ in 0..count {
            client.ok(swarm, "step", json!({"steps": 1})).await;
        }
    };
    steps(10).await;
    let mut woken = Vec::new();
    for _ in 0..10 {
        let before = wakings(swarm);
        steps(100).await;
        woken.push(wakings(swarm) - before);
    }
    let least = woken.iter().min().unwrap();
    assert!(*least < 25, "woken {woken:?} times in 100 steps each");
    // Many at once are left to the thread, whatever one of them takes.
    let many = client.ok(swarm, "step", json!({"steps": 20_000})).await;
    assert_eq!(many["step"], 21_010);
    daemon.stop().await;
}
