//! The cost of a thousand clients that follow one swarm, for the daemon and the steps of the swarm.
//!
//! ```sh
//! cargo bench --bench load                                  # a table and the limits
//! cargo bench --bench load -- --json                        # an object
//! cargo bench --bench load -- --sessions 4000 --seconds 60
//! ```
//!
//! The daemon is a process of its own and all the clients another, each with a session of its own.
//! A swarm of 50 steps 100 times a second and is published 20 times, first without subscribers, then
//! with all of them. Then as many follow a bare process, which only puts such states as often. A
//! thread of the bench's own wakes as often as the swarm and does nothing. The exit code is 1 if a limit
//! is missed; all cores must be idle otherwise.

#![expect(clippy::unwrap_used, reason = "what fails is to end the measurement")]

#[path = "../apart/mod.rs"]
mod apart;
mod bare;
mod counted;
mod crowd;
mod sleeper;

use std::io::Write;
use std::process::{Command, ExitCode};
use std::time::{Duration, Instant};

use jostle_proto::keys;
use serde_json::json;

use apart::{Process, ask, create_and_step, open};
use counted::Counted;
use crowd::Report;
use sleeper::Sleeper;

const SWARM: &str = "bench";
const NODE: &str = "bench";

/// Steps of 0.02 at two time units a second, one in five published.
const RATE: f64 = 2.0;
const EVERY: u64 = 5;
const HZ: f64 = RATE / 0.02 / EVERY as f64;

/// The variable that makes a copy of this program the clients: the endpoint, and their number.
const FOLLOW: &str = "JOSTLE_BENCH_FOLLOW";

/// The variable that makes a copy the bare process: the daemon's endpoint, and the number of clients.
const BARE: &str = "JOSTLE_BENCH_BARE";

#[tokio::main(flavor = "multi_thread", worker_threads = 2)]
async fn main() -> ExitCode {
    if let Ok(asked) = std::env::var(FOLLOW) {
        let (endpoint, sessions) = asked.split_once(' ').unwrap();
        crowd::follow(endpoint, SWARM, sessions.parse().unwrap()).await;
        return ExitCode::SUCCESS;
    }
    if let Ok(asked) = std::env::var(BARE) {
        let (daemon, sessions) = asked.split_once(' ').unwrap();
        bare::publish(daemon, SWARM, sessions.parse().unwrap(), (HZ, EVERY)).await;
        return ExitCode::SUCCESS;
    }
    let arguments: Vec<String> = std::env::args().collect();
    if arguments.iter().any(|argument| argument == "--test") {
        return ExitCode::SUCCESS;
    }
    let number = |name: &str, default: usize| {
        let at = arguments.iter().position(|argument| argument == name);
        at.map_or(default, |at| arguments[at + 1].parse().unwrap())
    };
    let (sessions, seconds) = (number("--sessions", 1000), number("--seconds", 20));
    let as_json = arguments.iter().any(|argument| argument == "--json");

    let folder = format!("/dev/shm/jostle-load-{}", std::process::id());
    let mut daemon = Command::new(env!("CARGO_BIN_EXE_jostled"));
    daemon.args(["--listen", "tcp/127.0.0.1:0", "--http", "127.0.0.1:0"]);
    daemon.args(["--node", NODE, "--data-dir", &folder]);
    let mut daemon = Process::start(daemon);
    let endpoint = daemon.find("listening on ");
    let http = daemon.find("http on http://");
    let session = open(&endpoint).await;
    let spec = json!({"n": 50, "seed": 1, "publish_every": EVERY});
    create_and_step(&session, (NODE, SWARM), spec, 5000).await;
    let run = keys::cmd("jostle", SWARM, "run");
    ask(&session, run, &json!({"rate": RATE})).await;

    let sleeper = Sleeper::start(Duration::from_millis(10));
    let began = Counted::by(&http);
    tokio::time::sleep(Duration::from_secs(seconds as u64)).await;
    let alone = Counted::by(&http);
    let sleeper_alone = sleeper.late_ms();

    let (mut clients, connected) = follow(&endpoint, sessions);
    let connecting = Counted::by(&http);
    tokio::time::sleep(Duration::from_secs(1)).await;
    let before = Counted::by(&http);
    sleeper.late_ms();
    send_line(&mut clients, &seconds.to_string());
    let report: Report = serde_json::from_str(&clients.find("report ")).unwrap();
    let after = Counted::by(&http);
    let sleeper = [sleeper_alone, sleeper.late_ms()];
    drop(clients);

    ask(&session, keys::cmd("jostle", SWARM, "pause"), &json!({})).await;
    let mut bare = Command::new(std::env::current_exe().unwrap());
    bare.env(BARE, format!("{endpoint} {sessions}"));
    let bare = follow_bare(Process::start(bare), sessions, seconds).await;

    let late = [
        alone.lateness_since(&began),
        connecting.lateness_since(&alone),
        after.lateness_since(&before),
    ];
    let cores = [alone.cores_since(&began), after.cores_since(&before)];
    if as_json {
        let output = json!({"seconds": seconds, "connected_secs": connected,
            "cores_alone": cores[0], "cores": cores[1], "resident_mb_alone": alone.resident_mb,
            "resident_mb": after.resident_mb, "late_ms_alone": late[0],
            "late_ms_connecting": late[1], "late_ms": late[2],
            "sleeper_late_ms_alone": sleeper[0], "sleeper_late_ms": sleeper[1],
            "clients": report, "bare_cores": bare.0, "bare_clients": bare.1});
        println!("{output}");
    } else {
        print(&report, connected, cores, [&alone, &after], (late, sleeper));
        print_bare(&bare, cores[1]);
    }
    drop(daemon);
    std::fs::remove_dir_all(folder).unwrap();
    let missed = missed(&report, &after, cores[1], [late[0], late[2]]);
    missed.iter().for_each(|limit| eprintln!("missed: {limit}"));
    ExitCode::from(u8::from(!missed.is_empty()))
}

/// The limits that were missed; they are for a thousand clients.
fn missed(report: &Report, daemon: &Counted, cores: f64, late: [[f64; 2]; 2]) -> Vec<&'static str> {
    let limits = [
        (cores <= 0.4, "40 % of a core"),
        (daemon.resident_mb <= 150.0, "150 MB"),
        (
            report.delivery_ms[1] < 100.0,
            "delivery within 100 ms, 99 of 100",
        ),
        (report.most_lost == 0.0, "no state lost"),
        // The daemon counts lateness in buckets: compare their upper bounds.
        (
            late[1][1] <= late[0][1] + 1.0,
            "99.9 % of the steps at most 1 ms later than alone",
        ),
    ];
    let missed = limits.into_iter().filter(|(is_within, _)| !is_within);
    missed.map(|(_, limit)| limit).collect()
}

/// Starts so many clients that follow an endpoint. Returns the seconds until they are connected.
fn follow(endpoint: &str, sessions: usize) -> (Process, f64) {
    let mut clients = Command::new(std::env::current_exe().unwrap());
    clients.env(FOLLOW, format!("{endpoint} {sessions}"));
    let mut clients = Process::start(clients);
    let connected = clients.find("connected ").parse().unwrap();
    (clients, connected)
}

/// The share of a core of the bare process with so many clients, and what they received.
async fn follow_bare(mut bare: Process, sessions: usize, seconds: usize) -> (f64, Report) {
    let (mut clients, _) = follow(&bare.find("listening on "), sessions);
    tokio::time::sleep(Duration::from_secs(1)).await;
    let mut cpu_secs = || {
        send_line(&mut bare, "");
        bare.find("cpu ").parse::<f64>().unwrap()
    };
    let (before, began) = (cpu_secs(), Instant::now());
    send_line(&mut clients, &seconds.to_string());
    let report = serde_json::from_str(&clients.find("report ")).unwrap();
    let spent = cpu_secs() - before;
    (spent / began.elapsed().as_secs_f64(), report)
}

/// Writes a line to the standard input of a process.
fn send_line(process: &mut Process, line: &str) {
    writeln!(process.child.stdin.as_ref().unwrap(), "{line}").unwrap();
}

fn print(
    report: &Report,
    connected: f64,
    cores: [f64; 2],
    counted: [&Counted; 2],
    (late, sleeper): ([[f64; 2]; 3], [f64; 2]),
) {
    let [half, most, nearly_all] = report.delivery_ms;
    let between = |[from, to]: [f64; 2]| format!("{from} to {to} ms");
    println!(
        "                                  alone   followed by {}",
        report.sessions
    );
    println!(
        "the daemon, of a core       {:9.1} % {:9.1} %",
        100.0 * cores[0],
        100.0 * cores[1]
    );
    println!(
        "its memory                  {:8.0} MB {:8.0} MB",
        counted[0].resident_mb, counted[1].resident_mb
    );
    println!(
        "99.9 % of steps late by       {}, {}",
        between(late[0]),
        between(late[2])
    );
    println!("  while they connect          {}", between(late[1]));
    println!(
        "  of a thread that sleeps      {:8.2} ms {:8.2} ms",
        sleeper[0], sleeper[1]
    );
    println!("they connect in             {connected:9.1} s");
    println!("delivery, p50 p99 p99.9     {half:9.1} ms {most:9.1} ms {nearly_all:9.1} ms");
    println!(
        "lost of {} states each    {:9.3} %, of one session at most {:.3} %",
        report.states,
        100.0 * report.lost,
        100.0 * report.most_lost
    );
}

fn print_bare((cores, report): &(f64, Report), daemon: f64) {
    let [half, most, nearly_all] = report.delivery_ms;
    println!(
        "a bare publisher, of a core             {:9.1} %: the daemon takes {:.2} of that",
        100.0 * cores,
        daemon / cores
    );
    println!("its delivery                {half:9.1} ms {most:9.1} ms {nearly_all:9.1} ms");
}
