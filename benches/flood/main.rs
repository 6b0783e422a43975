//! Latency of commands while 32 clients flood one swarm, of the daemon and of a zenoh
//! queryable that only writes and syncs what it accepts.
//!
//! ```sh
//! cargo bench --bench flood                  # a table and the limits
//! cargo bench --bench flood -- --json        # an object for each number of unanswered commands
//! cargo bench --bench flood -- --rounds 9
//! ```
//!
//! Daemon, queryable and flooding clients are processes of their own; the clients run at the lowest
//! priority, since clients on other machines take no time of the daemon's cores. Each value is the
//! median of the rounds. The exit code is 1 if a limit is missed; all cores must be idle otherwise.

#![expect(clippy::unwrap_used, reason = "what fails is to end the measurement")]

#[path = "../apart/mod.rs"]
mod apart;
mod bare;
mod clients;

use std::process::{Command, ExitCode};
use std::time::{Duration, Instant};

use jostle_proto::keys;
use serde_json::{Value, json};
use zenoh::Session;

use apart::{Process, ask, create_and_step, open};
use clients::Flooded;

const NODE: &str = "bench";

/// The variable that makes a copy of this program the clients: the endpoint, and how many replies each
/// may have outstanding.
const FLOOD: &str = "JOSTLE_BENCH_FLOOD";

/// The variable that makes a copy of this program the queryable.
const BARE: &str = "JOSTLE_BENCH_BARE";

/// How long the other clients are measured during the flood.
const MEASURED: Duration = Duration::from_secs(2);

/// Milliseconds at the median, of a command to the flooded swarm and to another one.
const MEDIAN_MS: f64 = 10.0;
/// Milliseconds until `busy`, at the 99th percentile.
const BUSY_MS: f64 = 10.0;
/// Commands a second that are synced and get a reply.
const DURABLE: f64 = 8000.0;
/// The daemon's median and 99th percentile, of the queryable's.
const TIMES: [f64; 2] = [3.0, 4.0];
/// The rate of the slowest of the other swarms, of 1.
const RATE: f64 = 0.95;

/// One round. Times are the median and the 99th percentile, in milliseconds.
struct Round {
    /// Of a client that sends one command after the other to the flooded swarm.
    probe: [f64; 2],
    /// Of those of them that were rejected with `busy`.
    busy: [f64; 2],
    /// Of a client that sends commands to another swarm.
    other: [f64; 2],
    durable: f64,
    rejected: usize,
}

#[tokio::main(flavor = "multi_thread", worker_threads = 2)]
async fn main() -> ExitCode {
    if let Ok(asked) = std::env::var(FLOOD) {
        let (endpoint, unanswered) = asked.split_once(' ').unwrap();
        clients::flood(async || open(endpoint).await, unanswered.parse().unwrap()).await;
        return ExitCode::SUCCESS;
    }
    if std::env::var_os(BARE).is_some() {
        bare::serve().await;
    }
    let arguments: Vec<String> = std::env::args().collect();
    if arguments.iter().any(|argument| argument == "--test") {
        return ExitCode::SUCCESS;
    }
    let at = arguments.iter().position(|argument| argument == "--rounds");
    let rounds = at.map_or(5, |at| arguments[at + 1].parse().unwrap());
    let as_json = arguments.iter().any(|argument| argument == "--json");
    let mut is_within = true;
    for unanswered in [64, 8, 1] {
        let (mut daemon, mut bare, mut rates) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..rounds {
            let (round, rate) = flood_daemon(unanswered).await;
            daemon.push(round);
            rates.push(rate);
            bare.push(flood_bare(unanswered).await);
        }
        let of =
            |rounds: &[Round], value: fn(&Round) -> f64| median(rounds.iter().map(value).collect());
        let both = |value: fn(&Round) -> f64| [of(&daemon, value), of(&bare, value)];
        let (half, most) = (both(|it| it.probe[0]), both(|it| it.probe[1]));
        let (other, busy) = (both(|it| it.other[0]), both(|it| it.busy[1]));
        let (durable, rejected) = (both(|it| it.durable), both(|it| it.rejected as f64));
        let rate = median(rates);
        let mut limits = vec![
            (half[0] < MEDIAN_MS, "a command's median"),
            (
                other[0] < MEDIAN_MS,
                "the median of another swarm's command",
            ),
            (
                half[0] < TIMES[0] * half[1],
                "a command's median, of the queryable's",
            ),
            (
                most[0] < TIMES[1] * most[1],
                "a command's p99, of the queryable's",
            ),
            (rate > RATE, "the rate of the other swarms"),
        ];
        // With few unanswered commands there are none to reject, and little to sync together.
        if unanswered == 64 {
            limits.push((busy[0] < BUSY_MS, "busy, p99"));
            limits.push((durable[0] > DURABLE, "durable commands a second"));
        }
        if as_json {
            let values = json!({"unanswered": unanswered, "rounds": rounds, "probe_p50_ms": half,
                "probe_p99_ms": most, "other_p50_ms": other, "busy_p99_ms": busy,
                "durable": durable, "rejected": rejected, "slowest_rate": rate});
            println!("{values}");
        } else {
            println!("{unanswered} unanswered commands of each client       daemon   queryable");
            let row = |what: &str, values: [f64; 2]| {
                println!("  {what:<40} {:>10.1} {:>10.1}", values[0], values[1]);
            };
            row("a command, p50 (ms)", half);
            row("a command, p99 (ms)", most);
            row("a command to another swarm, p50 (ms)", other);
            row("rejected as busy, p99 (ms)", busy);
            row("durable commands a second", durable);
            row("commands rejected", rejected);
            println!(
                "  {:<40} {rate:>10.3}",
                "slowest rate of the other swarms, of 1"
            );
        }
        for (_, limit) in limits.iter().filter(|(is_within, _)| !is_within) {
            eprintln!("missed with {unanswered} unanswered: {limit}");
            is_within = false;
        }
    }
    ExitCode::from(u8::from(!is_within))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Floods a daemon of nine swarms; returns the rate of the slowest of the others, too.
async fn flood_daemon(unanswered: usize) -> (Round, f64) {
    let folder = tempfile::tempdir().unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_jostled"));
    command.args(["--listen", "tcp/127.0.0.1:0", "--node", NODE]);
    command.arg("--data-dir").arg(folder.path());
    let mut daemon = Process::start({
        command.env("JOSTLED_HTTP", "");
        command
    });
    let endpoint = daemon.find("listening on ");
    let session = open(&endpoint).await;
    let others: Vec<String> = (0..8).map(|k| format!("other{k}")).collect();
    for name in others.iter().map(String::as_str).chain(["flooded"]) {
        create_and_step(&session, (NODE, name), json!({"n": 20, "rate": 1}), 1).await;
        ask(&session, keys::cmd("jostle", name, "run"), &json!({})).await;
    }
    let times = async || {
        let mut times = Vec::new();
        for name in &others {
            times.push((time(&session, name).await, Instant::now()));
        }
        times
    };
    let before = times().await;
    let round = flood(&endpoint, unanswered).await;
    let after = times().await;
    let rates = before.iter().zip(&after);
    let rates = rates.map(|(a, b)| (b.0 - a.0) / (b.1 - a.1).as_secs_f64());
    (round, rates.fold(f64::INFINITY, f64::min))
}

async fn flood_bare(unanswered: usize) -> Round {
    let mut bare = Command::new(std::env::current_exe().unwrap());
    bare.env(BARE, "");
    let mut bare = Process::start(bare);
    let endpoint = bare.find("listening on ");
    flood(&endpoint, unanswered).await
}

/// A swarm's time; a get that is rejected as busy is sent again.
async fn time(session: &Session, swarm: &str) -> f64 {
    loop {
        let replies = session.get(keys::get("jostle", swarm, "status")).await;
        if let Ok(sample) = replies.unwrap().recv_async().await.unwrap().into_result() {
            let status: Value = serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
            return status["time"].as_f64().unwrap();
        }
    }
}

/// Floods `endpoint`, and measures the replies that two other clients get.
async fn flood(endpoint: &str, unanswered: usize) -> Round {
    let mut command = Command::new("nice");
    command
        .args(["-n", "19"])
        .arg(std::env::current_exe().unwrap());
    command.env(FLOOD, format!("{endpoint} {unanswered}"));
    let mut flooding = Process::start(command);
    flooding.find("flooding ");
    let (probe, other) = (open(endpoint).await, open(endpoint).await);
    let probing = tokio::spawn(async move { send(&probe, "flooded").await });
    let (other, _) = send(&other, "other0").await;
    let (probe, busy) = probing.await.unwrap();
    let flooded: Flooded = serde_json::from_str(&flooding.find("flooded ")).unwrap();
    assert_eq!(flooded.sent, flooded.executed + flooded.rejected);
    Round {
        probe: percentiles(probe),
        busy: percentiles(busy),
        other: percentiles(other),
        durable: flooded.executed as f64 / flooded.secs,
        rejected: flooded.rejected,
    }
}

/// Sends one command after the other; returns how long each took and, again, those that were rejected.
async fn send(session: &Session, swarm: &str) -> (Vec<f64>, Vec<f64>) {
    let (began, mut all, mut busy) = (Instant::now(), Vec::new(), Vec::new());
    while began.elapsed() < MEASURED {
        let sent = Instant::now();
        let query = session.get(keys::cmd("jostle", swarm, "set"));
        let replies = query.payload("{\"pi3\": 1}").await.unwrap();
        let reply = replies.recv_async().await.unwrap();
        let took = 1e3 * sent.elapsed().as_secs_f64();
        all.push(took);
        if reply.result().is_err() {
            busy.push(took);
        }
    }
    (all, busy)
}

/// The median and the 99th percentile; 0 of none.
fn percentiles(mut all: Vec<f64>) -> [f64; 2] {
    all.sort_by(f64::total_cmp);
    [50, 99].map(|percent| {
        all.get(all.len() * percent / 100)
            .copied()
            .unwrap_or_default()
    })
}
