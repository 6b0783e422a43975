//! Many swarms on one daemon, compared with the required limits.
//!
//! ```sh
//! cargo bench --bench swarms              # a table; the exit code is 1 if a limit is missed
//! cargo bench --bench swarms -- --json    # an object
//! ```
//!
//! The daemon is a process of its own. First there are more swarms than the cores can step, then as
//! many as take 80 % of the cores, then swarms that are created, stepped and deleted one by one, then
//! a daemon that is killed and starts again, then one swarm that steps while a client reads the
//! metrics, then, in this process, what recording the metrics of a step costs. All cores must be idle
//! otherwise: other processes take a share.

#![expect(clippy::unwrap_used, reason = "what fails is to end the measurement")]

#[path = "../apart/mod.rs"]
mod apart;
mod counting;
mod fitting;
mod metrics;
mod overload;
mod restart;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::{Command, ExitCode};
use std::time::{Duration, Instant};

use jostle_proto::keys;
use serde_json::{Map, Value, json};
use zenoh::Session;

use apart::{Process, ask, create_and_step, open};

const NODE: &str = "bench";

/// A value that was measured and its limit.
struct Row {
    /// The name of the value in JSON.
    key: &'static str,
    what: String,
    value: f64,
    limit: Limit,
    unit: &'static str,
}

enum Limit {
    AtMost(f64),
    AtLeast(f64),
}

impl Row {
    fn is_within(&self) -> bool {
        match self.limit {
            Limit::AtMost(limit) => self.value <= limit,
            Limit::AtLeast(limit) => self.value >= limit,
        }
    }

    fn print(&self) {
        let (word, limit) = match self.limit {
            Limit::AtMost(limit) => ("at most", limit),
            Limit::AtLeast(limit) => ("at least", limit),
        };
        let Row {
            what, value, unit, ..
        } = self;
        let verdict = if self.is_within() { "" } else { "  MISSED" };
        println!("{what:<66} {value:>7.2} {unit:<8} {word} {limit}{verdict}");
    }
}

/// A daemon and a session that is connected to it.
struct Daemon {
    process: Process,
    session: Session,
    folder: PathBuf,
}

impl Daemon {
    async fn start() -> Self {
        let folder = format!("/dev/shm/jostle-swarms-{}", std::process::id());
        Self::on(PathBuf::from(folder)).await
    }

    /// Starts a daemon on `folder`, which may hold the data of an earlier one.
    async fn on(folder: PathBuf) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_jostled"));
        command.args(["--listen", "tcp/127.0.0.1:0", "--node", NODE]);
        command
            .arg("--data-dir")
            .arg(&folder)
            .env("JOSTLED_HTTP", "");
        let mut process = Process::start(command);
        let session = open(&process.find("listening on ")).await;
        Daemon {
            process,
            session,
            folder,
        }
    }

    /// Creates a swarm, steps it and runs it.
    async fn host(&self, k: usize, spec: Value, steps: u32) {
        create_and_step(&self.session, (NODE, &name(k)), spec, steps).await;
        let run = keys::cmd("jostle", &name(k), "run");
        ask(&self.session, run, &json!({})).await;
    }

    async fn status(&self, k: usize) -> Value {
        let replies = self.session.get(keys::get("jostle", &name(k), "status"));
        let reply = replies.await.unwrap().recv_async().await.unwrap();
        let sample = reply.into_result().unwrap();
        serde_json::from_slice(&sample.payload().to_bytes()).unwrap()
    }

    /// The seconds that each thread has computed whose name begins so.
    fn computed(&self, name: &str) -> BTreeMap<PathBuf, f64> {
        let threads = std::fs::read_dir(format!("/proc/{}/task", self.process.child.id())).unwrap();
        let threads = threads.map(|thread| thread.unwrap().path());
        let times = threads.filter_map(|thread| {
            let found = std::fs::read_to_string(thread.join("comm")).ok()?;
            let times = std::fs::read_to_string(thread.join("schedstat")).ok()?;
            let nanoseconds: f64 = times.split(' ').next()?.parse().ok()?;
            found
                .starts_with(name)
                .then_some((thread, nanoseconds * 1e-9))
        });
        times.collect()
    }

    /// Kills the daemon and returns its data folder.
    fn kill(self) -> PathBuf {
        drop(self.process);
        self.folder
    }

    /// Stops the daemon with SIGTERM; how long it took to end.
    fn end(mut self) -> Duration {
        let id = self.process.child.id().to_string();
        let began = Instant::now();
        let kill = Command::new("kill").args(["-TERM", &id]).status();
        assert!(kill.unwrap().success());
        assert!(self.process.child.wait().unwrap().success());
        let took = began.elapsed();
        self.stop();
        took
    }

    fn stop(self) {
        std::fs::remove_dir_all(self.kill()).unwrap();
    }
}

fn name(k: usize) -> String {
    format!("s{k}")
}

#[tokio::main(flavor = "multi_thread", worker_threads = 2)]
async fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().collect();
    if arguments.iter().any(|argument| argument == "--test") {
        return ExitCode::SUCCESS;
    }
    let mut rows = overload::measure().await;
    rows.extend(fitting::measure().await);
    rows.push(created_and_deleted().await);
    rows.extend(restart::measure().await);
    rows.push(metrics::measure().await);
    rows.push(counting::measure());
    if arguments.iter().any(|argument| argument == "--json") {
        let values = rows
            .iter()
            .map(|row| (row.key.to_owned(), json!(row.value)));
        println!("{}", Value::Object(values.collect::<Map<_, _>>()));
    } else {
        rows.iter().for_each(Row::print);
    }
    ExitCode::from(u8::from(!rows.iter().all(Row::is_within)))
}

/// How many swarms a second are created, stepped and deleted by one client.
async fn created_and_deleted() -> Row {
    const SWARMS: usize = 60;
    let daemon = Daemon::start().await;
    let began = Instant::now();
    for k in 0..SWARMS {
        let spec = json!({"n": 20, "seed": k});
        create_and_step(&daemon.session, (NODE, &name(k)), spec, 5).await;
        let delete = keys::cmd("jostle", &name(k), "delete");
        ask(&daemon.session, delete, &json!({})).await;
    }
    let rate = SWARMS as f64 / began.elapsed().as_secs_f64();
    daemon.stop();
    Row {
        key: "created_per_second",
        what: "swarms created, stepped and deleted one by one".into(),
        value: rate,
        limit: Limit::AtLeast(20.0),
        unit: "/s",
    }
}
