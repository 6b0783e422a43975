//! The time of an exchange in lock-step, compared with a bare zenoh query: in one run, with
//! the daemon, the bare queryable and the controllers each in a process of their own.
//!
//! ```sh
//! cargo bench --bench exchange            # a table
//! cargo bench --bench exchange -- --json  # an object a line
//! ```

#![expect(clippy::unwrap_used, reason = "what fails is to end the measurement")]

#[path = "../apart/mod.rs"]
mod apart;

use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

use jostle_proto::keys;
use jostled::auth::Rights;
use serde_json::{Value, json};
use tokio::sync::Barrier;
use tokio::task::JoinHandle;
use zenoh::{Session, Wait};

use apart::{Process, ask, create_and_step, open};

const SWARM: &str = "bench";
const NODE: &str = "bench";
const N: u64 = 50;

/// Exchanges of each controller in one round, and rounds in turn with bare queries: the machine is
/// shared, and both are to have the same noise. Ratios are medians over the rounds.
const EXCHANGES: usize = 500;
const ROUNDS: usize = 15;

/// Steps of the swarm that are timed in one round.
const STEPS: u32 = 1000;

/// The environment variable that makes a copy of this program the bare queryable.
const BARE: &str = "JOSTLE_BENCH_BARE";

/// The length of a reply to `advance`.
const ANSWER: &str = r#"{"swarm":"bench","epoch":1,"step":12345,"time":246.9,"phase":"paused","seq":12347,"result":{"steps":1,"durable_step":12344,"state_hash":"e41b9893ccd59f32b247f125d644f4113973c141bc3abe333824e46b5c4387dc","news":{"missed":[],"left":[],"removed":[]}}}"#;

#[tokio::main(flavor = "multi_thread", worker_threads = 2)]
async fn main() {
    if std::env::var(BARE).is_ok() {
        return bare().await;
    }
    if std::env::args().any(|argument| argument == "--test") {
        return;
    }
    let as_json = std::env::args().any(|argument| argument == "--json");
    let folder = std::env::temp_dir().join(format!("jostle-exchange-{}", std::process::id()));
    let mut daemon = Command::new(env!("CARGO_BIN_EXE_jostled"));
    daemon.args(["--listen", "tcp/127.0.0.1:0", "--http", "", "--node", NODE]);
    daemon.arg("--data-dir").arg(&folder);
    let mut daemon = Process::start(daemon);
    let daemon_at = daemon.find("listening on ");
    let mut bare = Command::new(std::env::current_exe().unwrap());
    bare.env(BARE, "1");
    let mut bare = Process::start(bare);
    let bare_at = bare.find("listening on ");

    let (mut askers, mut controllers) = (Vec::new(), Vec::new());
    for _ in 0..8 {
        askers.push(open(&bare_at).await);
        controllers.push(open(&daemon_at).await);
    }
    let spec = json!({"n": N, "seed": 1});
    create_and_step(&controllers[0], (NODE, SWARM), spec, 5000).await;
    let mut rounds: [Vec<f64>; 8] = Default::default();
    for _ in 0..ROUNDS {
        let step = micros(steps(&controllers[0]).await);
        let alone = median_micros(bare_round(&askers[..1]).await);
        let one = median_micros(round(&controllers[..1]).await);
        let bare_eight = median_micros(bare_round(&askers).await);
        let eight = median_micros(round(&controllers).await);
        let ratios = [one / (alone + step), bare_eight / alone, eight / one];
        let of_round = [step, alone, one, bare_eight, eight].into_iter();
        for (column, value) in rounds.iter_mut().zip(of_round.chain(ratios)) {
            column.push(value);
        }
    }
    let [
        step,
        alone,
        one,
        bare_eight,
        eight,
        of_one,
        bare_of_eight,
        of_eight,
    ] = rounds.map(median);
    if as_json {
        println!(
            "{}",
            json!({"n": N, "step_us": step, "bare_query_us": alone,
                "exchange_us": one, "exchange_of_eight_us": eight,
                "bare_queries_of_eight_us": bare_eight,
                "bare_eight_over_one": bare_of_eight,
                "exchange_over_bare_and_step": of_one, "eight_over_one": of_eight})
        );
    } else {
        println!("n = {N}, medians of {ROUNDS} rounds of {EXCHANGES} exchanges");
        println!("a step                      {step:8.1} µs");
        println!("a bare zenoh query          {alone:8.1} µs");
        println!("an exchange, 1 controller   {one:8.1} µs   {of_one:.2} of query and step");
        println!("8 bare queries at once      {bare_eight:8.1} µs   {bare_of_eight:.2} of one");
        println!("an exchange, 8 controllers  {eight:8.1} µs   {of_eight:.2} of 1 controller");
    }
    for session in controllers.into_iter().chain(askers) {
        session.close().await.unwrap();
    }
    drop((daemon, bare));
    std::fs::remove_dir_all(folder).unwrap();
}

/// A queryable that replies at once, on a session like the daemon's.
async fn bare() {
    let listen = ["tcp/127.0.0.1:0".to_owned()];
    let opened = jostled::transport::zenoh::session::open(&listen, "jostle", &Rights::Open, 100)
        .await
        .unwrap();
    let session = &opened.session;
    let queryable = session
        .declare_queryable("jostle/*/cmd/**")
        .callback(|query| {
            let reply = query.reply(query.key_expr().clone(), ANSWER);
            reply.encoding("application/json").wait().unwrap();
        });
    let _queryable = queryable.await.unwrap();
    println!("listening on {}", session.info().locators().await[0]);
    std::future::pending::<()>().await;
}

async fn command(session: &Session, verb: &str, request: Value) -> Value {
    ask(session, keys::cmd("jostle", SWARM, verb), &request).await
}

/// The time of a step, of many in one command.
async fn steps(session: &Session) -> Duration {
    let began = Instant::now();
    let request = json!({"timeout_secs": 60, "args": {"steps": STEPS}});
    command(session, "step", request).await;
    began.elapsed() / STEPS
}

/// The time of bare queries; of several at once, until the last reply.
async fn bare_round(sessions: &[Session]) -> Vec<Duration> {
    let together = Arc::new(Barrier::new(sessions.len()));
    let tasks = sessions.iter().cloned().map(|session| {
        let together = together.clone();
        tokio::spawn(async move {
            let request = advance(0, 12345);
            let mut took = Vec::new();
            for _ in 0..EXCHANGES {
                let began = Instant::now();
                command(&session, "advance", request.clone()).await;
                together.wait().await;
                took.push(began.elapsed());
            }
            took
        })
    });
    join_all(tasks.collect()).await
}

/// The time of exchanges with these controllers.
async fn round(sessions: &[Session]) -> Vec<Duration> {
    let mut step = 0;
    for (k, session) in sessions.iter().enumerate() {
        let token = keys::ctl_alive("jostle", SWARM, &format!("c{k}"));
        let token = session.liveliness().declare_token(token).await.unwrap();
        // It is held as long as the session.
        std::mem::forget(token);
        let join = json!({"controller": format!("c{k}"), "select": {"ids": [k]},
            "deadline_secs": 60});
        step = command(session, "join", join).await["step"]
            .as_u64()
            .unwrap();
    }
    let tasks = sessions.iter().cloned().enumerate().map(|(k, session)| {
        tokio::spawn(async move {
            let (mut step, mut took) = (step, Vec::new());
            for _ in 0..EXCHANGES {
                let began = Instant::now();
                let reply = command(&session, "advance", advance(k, step)).await;
                took.push(began.elapsed());
                step = reply["step"].as_u64().unwrap();
            }
            took
        })
    });
    let took = join_all(tasks.collect()).await;
    for (k, session) in sessions.iter().enumerate() {
        command(session, "leave", json!({"controller": format!("c{k}")})).await;
    }
    took
}

async fn join_all(tasks: Vec<JoinHandle<Vec<Duration>>>) -> Vec<Duration> {
    let mut took = Vec::new();
    for task in tasks {
        took.extend(task.await.unwrap());
    }
    took
}

fn advance(controller: usize, step: u64) -> Value {
    json!({"expect_step": step, "timeout_secs": 60, "args": {
        "controller": format!("c{controller}"),
        "set": {"ids": [controller], "direction": [0.001 * step as f64]},
    }})
}

fn micros(time: Duration) -> f64 {
    time.as_secs_f64() * 1e6
}

fn median_micros(took: Vec<Duration>) -> f64 {
    median(took.into_iter().map(micros).collect())
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
