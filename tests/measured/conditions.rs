//! What waits cost the swarm for whose conditions they wait: the processor time of its thread for each step,
//! beside that of a twin for which nobody waits.

use std::fs;

use jostle_proto::{ErrorCode, keys};
use serde_json::json;
use zenoh::liveliness::LivelinessToken;

use crate::support::process::{Process, jostled};
use crate::support::{Client, PREFIX};

/// The limit of a swarm.
const WAITS: usize = 16;

/// The share of the steps that waits leave.
const LEFT: f64 = 0.9;

/// For a machine on which other programs run.
const TOLERANCE: f64 = 0.05;

/// The parts whose median share counts.
const PARTS: usize = 24;

/// The processor time of the thread of a swarm, in nanoseconds.
fn used(process: &Process, swarm: &str) -> u64 {
    let tasks = format!("/proc/{}/task", process.0.id());
    let mut threads = fs::read_dir(tasks).unwrap().map(|it| it.unwrap().path());
    let is_swarm = |name: &str| name.trim().ends_with(swarm);
    let thread =
        threads.find(|it| fs::read_to_string(it.join("comm")).is_ok_and(|it| is_swarm(&it)));
    let stat = fs::read_to_string(thread.unwrap().join("schedstat")).unwrap();
    stat.split(' ').next().unwrap().parse().unwrap()
}

/// Begins a wait. Returns its token, unless it costs too much.
async fn begin(client: &Client, swarm: &str, k: usize, condition: &str) -> Option<LivelinessToken> {
    let id = format!("w{k}");
    let key = keys::wait_alive(PREFIX, swarm, &id);
    let token = client
        .session
        .liveliness()
        .declare_token(key)
        .await
        .unwrap();
    let noun = format!("wait?condition={condition};id={id};timeout_secs=0.05");
    match client
        .query(&keys::get(PREFIX, swarm, &noun), None)
        .await
        .unwrap_err()
    {
        error if error.code == ErrorCode::DeadlineExceeded => Some(token),
        error if error.code == ErrorCode::ResourceExhausted => None,
        error => panic!("{error:?}"),
    }
}

/// How many of these waits are accepted, and the share of the steps that they leave.
async fn left(n: usize, steps: u64, conditions: &[String]) -> (usize, f64) {
    // By default a swarm has at most 2000 individuals.
    let mut command = jostled(&["serve", "--listen", "tcp/127.0.0.1:0", "--node", "test"]);
    command.args(["--max-individuals", "10000"]);
    let (process, endpoint) = Process::start(&mut command, tempfile::tempdir().unwrap());
    let client = Client::open(&endpoint).await;
    for name in ["plain", "waited"] {
        client.create(name, json!({"n": n, "seed": 3})).await;
        let warm = json!({"timeout_secs": 600, "args": {"steps": steps}});
        client.ok(name, "step", warm).await;
    }
    let step = async |name: &str| {
        let before = used(&process, name);
        let request = json!({"timeout_secs": 600, "args": {"steps": steps}});
        client.ok(name, "step", request).await;
        (used(&process, name) - before) as f64
    };
    // A wait ends 10 s after its last query: each is repeated now and then.
    let (mut shares, mut accepted) = (Vec::new(), 0);
    let mut tokens = Vec::new();
    for part in 0..PARTS {
        if part % 4 == 0 {
            tokens.clear();
            for (k, condition) in conditions.iter().enumerate() {
                tokens.extend(begin(&client, "waited", k, condition).await);
            }
            accepted = tokens.len();
        }
        // Each is first in turn.
        let (plain, waited) = match part % 2 {
            0 => {
                let plain = step("plain").await;
                (plain, step("waited").await)
            }
            _ => {
                let waited = step("waited").await;
                (step("plain").await, waited)
            }
        };
        shares.push(plain / waited);
    }
    shares.sort_by(f64::total_cmp);
    (accepted, shares[PARTS / 2])
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "long: some minutes"]
async fn sixteen_waits_leave_nine_tenths_of_the_steps() {
    let thresholds = |measure: &str| -> Vec<String> {
        let text = |k: usize| format!("{measure} > 0.{k:02} for 1000000");
        (0..WAITS).map(text).collect()
    };
    let gaps: Vec<String> = (0..WAITS)
        .map(|k| format!("clusters.count(0.{k:02}) > 0 for 1000000"))
        .collect();
    for (n, steps) in [(50, 5000), (2000, 20), (10_000, 4)] {
        let (accepted, share) = left(n, steps, &thresholds("order")).await;
        println!("n = {n}: {accepted} waits on order leave {share:.3}");
        assert_eq!(accepted, WAITS, "n = {n}");
        assert!(share >= LEFT - TOLERANCE, "n = {n}: {share}");
        let one = [gaps[1].clone()];
        let (_, alone) = left(n, steps, &one).await;
        println!("n = {n}: one wait on clusters.count leaves {alone:.3}");
        for (what, conditions) in [
            ("16 thresholds", &thresholds("clusters.count(0.01)")),
            ("16 gaps", &gaps),
        ] {
            let (accepted, share) = left(n, steps, conditions).await;
            println!("n = {n}: {accepted} waits on clusters.count with {what} leave {share:.3}");
            assert!(accepted >= 1, "n = {n}: {what}");
            let least = LEFT.min(alone) - TOLERANCE;
            assert!(share >= least, "n = {n}: {what}: {share}");
        }
    }
}
