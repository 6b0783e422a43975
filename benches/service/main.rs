//! The daemon's streams and commands, compared with bare zenoh: a publisher of the
//! same payload at the same rate, a queryable that replies at once, and one that puts a state for
//! all subscribers before it replies, as a command does. In one run, for 1, 8 and 64 subscribers, the
//! daemon and the bare process each followed by as many sessions.
//!
//! ```sh
//! cargo bench --bench service               # a table
//! cargo bench --bench service -- --hz 2000  # another rate
//! cargo bench --bench service -- --followers 64
//! cargo bench --bench service -- --json     # an object a line
//! ```
//!
//! The daemon keeps its data in memory (`/dev/shm`), so that no command waits for a disk. The time until
//! a line of the journal of `set` is written and synced there is measured separately, by a
//! store of the bench's own, and subtracted.

#![expect(clippy::unwrap_used, reason = "what fails is to end the measurement")]

#[path = "../apart/mod.rs"]
mod apart;

use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use jostle_proto::keys;
use jostled::auth::Rights;
use jostled::store::{Checkpoint, Row, Settings, Store, Write};
use serde_json::{Value, json};
use zenoh::pubsub::Subscriber;
use zenoh::qos::CongestionControl;
use zenoh::{Session, Wait};

use apart::{Process, ask, create_and_step, open};

const SWARM: &str = "bench";
const NODE: &str = "bench";
const N: u64 = 50;

/// The default time step.
const DT: f64 = 0.02;

/// The numbers of subscribers.
const FOLLOWERS: [usize; 3] = [1, 8, 64];

/// The default of the states a second, of both: the maximum of the daemon's `max_hz`.
const HZ: u32 = 10_000;

/// The seconds of a count, and the rounds in turn: the machine is shared, and both are to have the
/// same noise.
const COUNTED: Duration = Duration::from_secs(1);
const ROUNDS: usize = 9;

/// Queries of a round.
const QUERIES: usize = 500;

/// The length of the line of a `set`.
const LINE_BYTES: usize = 100;

/// The variable that makes a copy of this program the bare process: the length of states, and how many
/// a second.
const BARE: &str = "JOSTLE_BENCH_BARE";

/// The length of a reply to `set`.
const ANSWER: &str = r#"{"swarm":"bench","epoch":1,"step":0,"time":0.0,"phase":"paused","seq":1,"result":{"before":{"pi1":4.0,"pi2":0.5,"pi3":1.0,"pi4":10.0,"contacts":"endpoints","stepping":"position","relinearise":0,"attraction":{"kind":"all"},"noise":0.0,"publish_every":1},"now":{"pi1":4.0,"pi2":0.5,"pi3":1.0,"pi4":10.0,"contacts":"endpoints","stepping":"position","relinearise":0,"attraction":{"kind":"all"},"noise":0.0,"publish_every":1},"scaled_by":1.0}}"#;

#[tokio::main(flavor = "multi_thread", worker_threads = 2)]
async fn main() {
    if std::env::var(BARE).is_ok() {
        return bare().await;
    }
    if std::env::args().any(|argument| argument == "--test") {
        return;
    }
    let as_json = std::env::args().any(|argument| argument == "--json");
    let number_after = |name: &str| {
        let mut found = std::env::args().skip_while(|argument| argument != name);
        found.nth(1).map(|number| number.parse::<u32>().unwrap())
    };
    let hz = number_after("--hz").unwrap_or(HZ);
    let followers = match number_after("--followers") {
        Some(followers) => vec![followers as usize],
        None => FOLLOWERS.to_vec(),
    };
    let folder = format!("/dev/shm/jostle-service-{}", std::process::id());
    let mut daemon = Command::new(env!("CARGO_BIN_EXE_jostled"));
    daemon.args(["--listen", "tcp/127.0.0.1:0", "--http", "", "--node", NODE]);
    daemon.args(["--max-hz", &hz.to_string(), "--data-dir", &folder]);
    let mut daemon = Process::start(daemon);
    let daemon_at = daemon.find("listening on ");
    let client = open(&daemon_at).await;
    let spec = json!({"n": N, "seed": 1, "publish_every": 1});
    create_and_step(&client, (NODE, SWARM), spec, 5000).await;
    let state = length_of_a_state(&client).await;
    let mut bare = Command::new(std::env::current_exe().unwrap());
    bare.env(BARE, format!("{state} {hz}"));
    let mut bare = Process::start(bare);
    let bare_at = bare.find("listening on ");
    let asker = open(&bare_at).await;
    if !as_json {
        println!("n = {N}, states of {state} bytes, {hz} a second asked for; queries in µs");
        println!(
            "followers   states/s: bare  jostled  ratio   query: bare   shown   step  of bare  of \
             shown    set   sync  the rest: of bare  of shown"
        );
    }
    let mut journal = Journal::new();
    for followers in followers {
        let bare_followers = Followers::new(&bare_at, followers).await;
        let daemon_followers = Followers::new(&daemon_at, followers).await;
        let mut rates: [Vec<f64>; 2] = Default::default();
        let mut took: [Vec<f64>; 5] = Default::default();
        let mut ratios: [Vec<f64>; 5] = Default::default();
        for round in 0..ROUNDS {
            // One of them publishes at a time.
            command(&asker, "run", &json!({})).await;
            rates[0].push(bare_followers.rate().await);
            command(&asker, "pause", &json!({})).await;
            command(&client, "run", &json!({"rate": f64::from(hz) * DT})).await;
            rates[1].push(daemon_followers.rate().await);
            command(&client, "pause", &json!({})).await;
            let query = queries(&asker, "set", setting).await;
            let shown = queries(&asker, "step", setting).await;
            let step = queries(&client, "step", |_| json!({"steps": 1})).await;
            let set = queries(&client, "set", setting).await;
            let sync = journal.sync(&asker).await;
            for (all, micros) in took.iter_mut().zip([query, shown, step, set, sync]) {
                all.push(micros);
            }
            let rest = set - sync;
            let of_rate = rates[1][round] / rates[0][round];
            let of_both = [
                of_rate,
                step / query,
                step / shown,
                rest / query,
                rest / shown,
            ];
            for (all, ratio) in ratios.iter_mut().zip(of_both) {
                all.push(ratio);
            }
        }
        let [bare_rate, rate] = rates.map(median);
        let [query, shown, step, set, sync] = took.map(median);
        let [
            of_rate,
            step_of_bare,
            step_of_shown,
            rest_of_bare,
            rest_of_shown,
        ] = ratios.map(median);
        if as_json {
            let output = json!({"followers": followers, "n": N, "state_bytes": state, "hz": hz,
                "bare_states_per_s": bare_rate, "states_per_s": rate, "of_bare_rate": of_rate,
                "bare_query_us": query, "shown_query_us": shown,
                "step_us": step, "step_of_bare": step_of_bare, "step_of_shown": step_of_shown,
                "set_us": set, "sync_us": sync, "set_but_sync_of_bare": rest_of_bare,
                "set_but_sync_of_shown": rest_of_shown});
            println!("{output}");
        } else {
            println!(
                "{followers:9} {bare_rate:16.0} {rate:8.0} {of_rate:6.2} {query:13.0} {shown:7.0} \
                 {step:6.0} {step_of_bare:8.2} {step_of_shown:9.2} {set:6.0} {sync:6.0} \
                 {rest_of_bare:18.2} {rest_of_shown:9.2}"
            );
        }
    }
    drop((daemon, bare, journal));
    std::fs::remove_dir_all(folder).unwrap();
}

/// A journal of the bench's own, in memory like the daemon's.
struct Journal {
    store: Store,
    lines: u64,
    _folder: tempfile::TempDir,
}

impl Journal {
    fn new() -> Self {
        let folder = tempfile::tempdir_in("/dev/shm").unwrap();
        let settings = Settings::default();
        let store = Store::open(folder.path(), settings, Box::new(|fault| panic!("{fault}")));
        let store = store.unwrap();
        let first = Checkpoint {
            number: 0,
            epoch: 1,
            step: 0,
            body: Vec::new(),
        };
        let (swarm, about) = (SWARM.to_owned(), Vec::new());
        let create = Write::Create {
            swarm,
            about,
            first,
        };
        store.commit(vec![create]).unwrap();
        Journal {
            store,
            lines: 0,
            _folder: folder,
        }
    }

    /// How long a line takes until it is synced, when as much time lies between two of them as
    /// between two commands: the median, in microseconds.
    async fn sync(&mut self, asker: &Session) -> f64 {
        let mut took = Vec::new();
        for k in 0..QUERIES {
            command(asker, "set", &setting(k)).await;
            self.lines += 1;
            let row = Row {
                number: self.lines,
                epoch: 1,
                step: 0,
                kind: 0,
                body: vec![0; LINE_BYTES],
            };
            let swarm = SWARM.to_owned();
            let began = Instant::now();
            self.store
                .commit(vec![Write::Append { swarm, row }])
                .unwrap();
            took.push(began.elapsed().as_secs_f64() * 1e6);
        }
        median(took)
    }
}

/// Sessions that follow the states of one process.
struct Followers {
    seen: Arc<AtomicU64>,
    count: usize,
    _all: Vec<(Session, Subscriber<()>)>,
}

impl Followers {
    async fn new(endpoint: &str, count: usize) -> Self {
        let seen = Arc::new(AtomicU64::new(0));
        let mut all = Vec::new();
        for _ in 0..count {
            let (session, seen) = (open(endpoint).await, seen.clone());
            let subscriber = session
                .declare_subscriber(keys::state("jostle", SWARM))
                .callback(move |_| {
                    seen.fetch_add(1, Ordering::Relaxed);
                });
            let subscriber = subscriber.await.unwrap();
            all.push((session, subscriber));
        }
        Followers {
            seen,
            count,
            _all: all,
        }
    }

    /// States a second that each receives.
    async fn rate(&self) -> f64 {
        tokio::time::sleep(COUNTED / 5).await;
        let (before, began) = (self.seen.load(Ordering::Relaxed), Instant::now());
        tokio::time::sleep(COUNTED).await;
        let seen = self.seen.load(Ordering::Relaxed) - before;
        seen as f64 / began.elapsed().as_secs_f64() / self.count as f64
    }
}

/// A session like the daemon's that publishes so many bytes at the rate between `run` and `pause`, and
/// replies at once, to a `step` after it has put a state.
async fn bare() {
    let variable = std::env::var(BARE).unwrap();
    let (bytes, hz) = variable.split_once(' ').unwrap();
    let (bytes, hz): (usize, u32) = (bytes.parse().unwrap(), hz.parse().unwrap());
    let listen = ["tcp/127.0.0.1:0".to_owned()];
    let opened = jostled::transport::zenoh::session::open(&listen, "jostle", &Rights::Open, 100)
        .await
        .unwrap();
    let session = &opened.session;
    let publisher = session
        .declare_publisher(keys::state("jostle", SWARM))
        .congestion_control(CongestionControl::Drop)
        .encoding("application/cbor");
    let publisher = Arc::new(publisher.await.unwrap());
    let runs = Arc::new(std::sync::atomic::AtomicBool::new(false));
    let (is_running, state_publisher) = (runs.clone(), publisher.clone());
    let queryable = session
        .declare_queryable("jostle/*/cmd/**")
        .callback(move |query| {
            match query.key_expr().as_str() {
                key if key.ends_with("/run") => is_running.store(true, Ordering::Relaxed),
                key if key.ends_with("/pause") => is_running.store(false, Ordering::Relaxed),
                key if key.ends_with("/step") => {
                    state_publisher.put(vec![0; bytes]).wait().unwrap();
                }
                _ => {}
            }
            let reply = query.reply(query.key_expr().clone(), ANSWER);
            reply.encoding("application/json").wait().unwrap();
        });
    let _queryable = queryable.await.unwrap();
    println!("listening on {}", session.info().locators().await[0]);
    let period = Duration::from_secs(1) / hz;
    let mut next = Instant::now();
    loop {
        if !runs.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(1));
            next = Instant::now();
            continue;
        }
        publisher.put(vec![0; bytes]).wait().unwrap();
        next += period;
        let now = Instant::now();
        match next.checked_duration_since(now) {
            Some(wait) => std::thread::sleep(wait),
            // Skips states that are behind by more than the daemon catches up with.
            None => next = next.max(now.checked_sub(Duration::from_millis(50)).unwrap()),
        }
    }
}

async fn command(session: &Session, verb: &str, request: &Value) {
    ask(session, keys::cmd("jostle", SWARM, verb), request).await;
}

/// How many bytes a published state has.
async fn length_of_a_state(session: &Session) -> usize {
    let states = session.get(keys::state("jostle", SWARM)).await.unwrap();
    let state = states.recv_async().await.unwrap().into_result().unwrap();
    state.payload().len()
}

/// A command that is durable before its reply.
fn setting(k: usize) -> Value {
    json!({"pi2": 0.5 + (k % 2) as f64})
}

/// The time of commands, one after the other: the median, in microseconds.
async fn queries(session: &Session, verb: &str, request: impl Fn(usize) -> Value) -> f64 {
    let mut took = Vec::new();
    for k in 0..QUERIES {
        let request = request(k);
        let began = Instant::now();
        command(session, verb, &request).await;
        took.push(began.elapsed().as_secs_f64() * 1e6);
    }
    median(took)
}

fn median<T: PartialOrd + Copy>(mut values: Vec<T>) -> T {
    values.sort_by(|a, b| a.partial_cmp(b).unwrap());
    values[values.len() / 2]
}
