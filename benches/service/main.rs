//! What the daemon's streams and commands come to, beside what bare zenoh does: a publisher of the
//! same payload at the same pace, and a queryable that answers at once. In one run, for 1, 8 and 64
//! subscribers, the daemon and the bare process each followed by as many sessions.
//!
//! ```sh
//! cargo bench --bench service            # a table
//! cargo bench --bench service -- --json  # an object a line
//! ```
//!
//! The daemon keeps its data in memory (`/dev/shm`), so that no command waits for a disk.

#![expect(clippy::unwrap_used, reason = "what fails is to end the measurement")]

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use jostle_proto::keys;
use jostled::rights::Rights;
use serde_json::{Value, json};
use zenoh::pubsub::Subscriber;
use zenoh::qos::CongestionControl;
use zenoh::{Session, Wait};

const SWARM: &str = "bench";
const N: u64 = 50;

/// How many follow.
const FOLLOWERS: [usize; 3] = [1, 8, 64];

/// States a second, of both: as many as a daemon may be told to publish.
const HZ: u32 = 10_000;

/// How long is counted, and how often in turn: the machine is shared, and what is compared is to
/// meet the same noise.
const COUNTED: Duration = Duration::from_secs(1);
const ROUNDS: usize = 5;

/// Queries of a round.
const QUERIES: usize = 500;

/// Tells a copy of this program that it is to be the bare process.
const BARE: &str = "JOSTLE_BENCH_BARE";

/// As long as the answer to `set`.
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
    let folder = format!("/dev/shm/jostle-service-{}", std::process::id());
    let mut daemon = Command::new(env!("CARGO_BIN_EXE_jostled"));
    daemon.args(["--listen", "tcp/127.0.0.1:0", "--http", "", "--max-hz"]);
    daemon.args([&HZ.to_string(), "--data-dir", &folder]);
    let (mut daemon, daemon_at) = started(daemon);
    let client = open(&daemon_at).await;
    let state = create(&client).await;
    let mut bare = Command::new(std::env::current_exe().unwrap());
    bare.env(BARE, state.to_string());
    let (mut bare, bare_at) = started(bare);
    let asker = open(&bare_at).await;
    if !as_json {
        println!("n = {N}, states of {state} bytes, {HZ} a second asked for");
        println!(
            "followers   states/s each: bare   jostled   ratio   a query: bare   a command   ratio"
        );
    }
    for followers in FOLLOWERS {
        let bare_followers = Followers::new(&bare_at, followers).await;
        let daemon_followers = Followers::new(&daemon_at, followers).await;
        let mut rates: [Vec<f64>; 2] = Default::default();
        let mut took: [Vec<Duration>; 2] = Default::default();
        for _ in 0..ROUNDS {
            // One of them publishes at a time.
            ask(&asker, "run", &json!({})).await;
            rates[0].push(bare_followers.rate().await);
            ask(&asker, "pause", &json!({})).await;
            ask(&client, "run", &json!({"rate": f64::from(HZ) / 50.0})).await;
            rates[1].push(daemon_followers.rate().await);
            ask(&client, "pause", &json!({})).await;
            took[0].extend(queries(&asker).await);
            took[1].extend(queries(&client).await);
        }
        let [bare_rate, rate] = rates.map(median);
        let [query, command] = took.map(|took| median(took).as_secs_f64() * 1e6);
        let (of_rate, of_query) = (rate / bare_rate, command / query);
        if as_json {
            let told = json!({"followers": followers, "n": N, "state_bytes": state,
                "bare_states_per_s": bare_rate, "states_per_s": rate, "of_bare_rate": of_rate,
                "bare_query_us": query, "command_us": command, "of_bare_query": of_query});
            println!("{told}");
        } else {
            println!(
                "{followers:9} {bare_rate:22.0} {rate:9.0} {of_rate:7.2} {query:12.0} µs {command:8.0} \
                 µs {of_query:7.2}"
            );
        }
    }
    for process in [&mut daemon, &mut bare] {
        process.kill().unwrap();
        process.wait().unwrap();
    }
    std::fs::remove_dir_all(folder).unwrap();
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

    /// States a second that come to each.
    async fn rate(&self) -> f64 {
        tokio::time::sleep(COUNTED / 5).await;
        let (before, began) = (self.seen.load(Ordering::Relaxed), Instant::now());
        tokio::time::sleep(COUNTED).await;
        let seen = self.seen.load(Ordering::Relaxed) - before;
        seen as f64 / began.elapsed().as_secs_f64() / self.count as f64
    }
}

/// A session like the daemon's that publishes so many bytes at the pace while it is told to, and
/// answers at once.
async fn bare() {
    let bytes: usize = std::env::var(BARE).unwrap().parse().unwrap();
    let listen = ["tcp/127.0.0.1:0".to_owned()];
    let session = jostled::server::session::open(&listen, "jostle", &Rights::Everybody, 100)
        .await
        .unwrap();
    let runs = Arc::new(std::sync::atomic::AtomicBool::new(false));
    let told = runs.clone();
    let queryable = session
        .declare_queryable("jostle/*/cmd/**")
        .callback(move |query| {
            match query.key_expr().as_str() {
                key if key.ends_with("/run") => told.store(true, Ordering::Relaxed),
                key if key.ends_with("/pause") => told.store(false, Ordering::Relaxed),
                _ => {}
            }
            let reply = query.reply(query.key_expr().clone(), ANSWER);
            reply.encoding("application/json").wait().unwrap();
        });
    let _queryable = queryable.await.unwrap();
    let publisher = session
        .declare_publisher(keys::state("jostle", SWARM))
        .congestion_control(CongestionControl::Drop)
        .encoding("application/cbor");
    let publisher = publisher.await.unwrap();
    println!("listening on {}", session.info().locators().await[0]);
    let period = Duration::from_secs(1) / HZ;
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
            // What is behind by more than the daemon makes good is given up here too.
            None => next = next.max(now.checked_sub(Duration::from_millis(50)).unwrap()),
        }
    }
}

/// Starts a process and reads where it listens.
fn started(mut command: Command) -> (Child, String) {
    let mut process = command
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(process.stdout.take().unwrap()).lines();
    let endpoint = loop {
        let line = lines.next().unwrap().unwrap();
        if let Some((_, rest)) = line.split_once("listening on ") {
            break rest.split([' ', ',']).next().unwrap().to_owned();
        }
    };
    std::thread::spawn(move || lines.for_each(drop));
    (process, endpoint)
}

async fn open(endpoint: &str) -> Session {
    let mut config = zenoh::Config::default();
    for (setting, value) in [
        ("mode", json!("client")),
        ("connect/endpoints", json!([endpoint])),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
    ] {
        config.insert_json5(setting, &value.to_string()).unwrap();
    }
    zenoh::open(config).await.unwrap()
}

async fn ask(session: &Session, verb: &str, request: &Value) -> Value {
    ask_at(session, keys::cmd("jostle", SWARM, verb), request).await
}

async fn ask_at(session: &Session, key: String, request: &Value) -> Value {
    let query = session
        .get(key)
        .payload(serde_json::to_vec(request).unwrap());
    let answers = query
        .encoding("application/json")
        .timeout(Duration::from_secs(60));
    let answer = answers.await.unwrap().recv_async().await.unwrap();
    match answer.into_result() {
        Ok(sample) => serde_json::from_slice(&sample.payload().to_bytes()).unwrap(),
        Err(error) => panic!("{}", String::from_utf8_lossy(&error.payload().to_bytes())),
    }
}

/// Makes the swarm and lets it come together. Returns how long its states are.
async fn create(session: &Session) -> usize {
    let nodes = session.liveliness().get("jostle/@node/*/alive");
    let token = nodes.await.unwrap().recv_async().await.unwrap();
    let token = token.into_result().unwrap();
    let node = token.key_expr().as_str().split('/').nth(2).unwrap();
    let spec = json!({"n": N, "seed": 1, "publish_every": 1});
    let key = keys::node_cmd("jostle", node, "create");
    ask_at(session, key, &json!({"name": SWARM, "spec": spec})).await;
    let settle = json!({"timeout_secs": 60, "args": {"steps": 5000}});
    ask(session, "step", &settle).await;
    let states = session.get(keys::state("jostle", SWARM)).await.unwrap();
    let state = states.recv_async().await.unwrap().into_result().unwrap();
    state.payload().len()
}

/// What commands take, one after the other.
async fn queries(session: &Session) -> Vec<Duration> {
    let mut took = Vec::new();
    for k in 0..QUERIES {
        let request = json!({"pi2": 0.5 + (k % 2) as f64});
        let began = Instant::now();
        ask(session, "set", &request).await;
        took.push(began.elapsed());
    }
    took
}

fn median<T: PartialOrd + Copy>(mut values: Vec<T>) -> T {
    values.sort_by(|a, b| a.partial_cmp(b).unwrap());
    values[values.len() / 2]
}
