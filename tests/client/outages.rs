//! Short outages: what each call sees of each fault is in `tests/outages.toml`. The calls `wait` and
//! `run` are those of the program `jostle`, the others those of the Rust client.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use jostle_client::{Client, ConnectOptions};
use jostle_proto::verbs::{
    AnnotateArgs, CreateArgs, DeleteArgs, Return, RunArgs, SetArgs, StepArgs,
};
use jostle_proto::{Journal, Reply, Spec};
use serde_json::json;
use tempfile::TempDir;

use crate::follow::{Process, signal};
use crate::outage_client::{CLIENT, LAST_NOTE, SHORT_TIMEOUT, STEERED, SWARM, Seen, now};
use crate::programs::{ROOT, program};

/// Makes a copy of this program a router: the daemon's endpoint, and its own.
const ROUTER: &str = "JOSTLE_CLIENT_TEST_ROUTER";
/// The swarm that `jostle run` runs.
const RUN: &str = "rust-run";
/// The swarms reach it long after the outage, or at once without a rate.
const LAST_STEP: u64 = 20_000;
/// The timeout of what takes a second on an idle machine.
const TIMEOUT: Duration = Duration::from_secs(60);
/// It holds long before that step, and long after the outage.
const CONDITION: &str = "order >= 0 for 100";
/// How much longer than its timeout a request may take, as documented, and on a busy machine.
const GRACE_SECS: f64 = 2.0 + 20.0;

/// A process that ends with the test.
struct Ending(Child);

impl Drop for Ending {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Not a test: a router as zenohd is one, in a copy of this program.
#[tokio::test(flavor = "multi_thread")]
async fn router_process() {
    let Ok(arguments) = std::env::var(ROUTER) else {
        return;
    };
    let (daemon, listen) = arguments.split_once(' ').unwrap();
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", json!("router")),
        ("connect/endpoints", json!([daemon])),
        ("connect/exit_on_failure", json!(false)),
        (
            "connect/retry",
            json!({"period_init_ms": 100, "period_max_ms": 200, "period_increase_factor": 2}),
        ),
        ("listen/endpoints", json!([listen])),
        ("scouting/multicast/enabled", json!(false)),
    ] {
        config.insert_json5(key, &value.to_string()).unwrap();
    }
    let _session = zenoh::open(config).await.unwrap();
    println!("there");
    std::future::pending::<()>().await;
}

fn router(daemon: &str, listen: &str) -> Ending {
    let mut router = Ending(
        Command::new(std::env::current_exe().unwrap())
            .args(["outages::router_process", "--exact", "--nocapture"])
            .env(ROUTER, format!("{daemon} {listen}"))
            .stdout(Stdio::piped())
            .spawn()
            .unwrap(),
    );
    let output = BufReader::new(router.0.stdout.take().unwrap());
    assert!(output.lines().any(|line| line.unwrap().ends_with("there")));
    router
}

fn free_endpoint() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    format!("tcp/{}", listener.local_addr().unwrap())
}

/// A line of the table.
struct Fault {
    name: String,
    secs: f64,
    seen: toml::Table,
}

fn fault(name: &str) -> Fault {
    let text = std::fs::read_to_string(Path::new(ROOT).join("tests/outages.toml")).unwrap();
    let table: toml::Table = text.parse().unwrap();
    let mut faults = table["faults"].as_array().unwrap().iter();
    let fault = faults.find(|it| it["name"].as_str() == Some(name)).unwrap();
    Fault {
        name: name.to_owned(),
        secs: fault["secs"].as_integer().unwrap() as f64,
        seen: fault["seen"].as_table().unwrap().clone(),
    }
}

/// A daemon, perhaps a router, and the processes that make the calls.
struct Scene {
    folder: TempDir,
    endpoint: String,
    daemon: Option<Process>,
    router: Option<(Ending, String)>,
    client: Ending,
    lines: std::io::Lines<BufReader<ChildStdout>>,
    /// `jostle wait` and `jostle run`.
    programs: [(&'static str, Ending); 2],
}

impl Scene {
    async fn start(is_routed: bool) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let (daemon, endpoint) = Process::start(folder.path(), "tcp/127.0.0.1:0");
        let near = connect(&endpoint).await;
        for name in [SWARM, RUN, STEERED] {
            let args = CreateArgs {
                name: name.to_owned(),
                spec: Spec {
                    rate: Some(1.0),
                    ..Spec::new(3)
                },
                exist_ok: false,
            };
            near.create(&args).await.unwrap();
        }
        near.execute(SWARM, &RunArgs::default()).await.unwrap();
        let router = is_routed.then(|| {
            let listen = free_endpoint();
            (router(&endpoint, &listen), listen)
        });
        let reached = router.as_ref().map_or(&endpoint, |it| &it.1);
        if is_routed {
            let far = connect(reached).await;
            let began = Instant::now();
            while far.status(SWARM).await.is_err() {
                assert!(
                    began.elapsed() < TIMEOUT,
                    "the router does not reach the daemon"
                );
            }
            far.close().await;
        }
        let mut client = Ending(
            Command::new(std::env::current_exe().unwrap())
                .args(["outage_client::client_process", "--exact", "--nocapture"])
                .env(CLIENT, format!("{reached} {LAST_STEP}"))
                .stdin(Stdio::piped())
                .stdout(Stdio::piped())
                .spawn()
                .unwrap(),
        );
        let mut lines = BufReader::new(client.0.stdout.take().unwrap()).lines();
        let step = LAST_STEP.to_string();
        let programs = [
            ("wait", vec!["wait", SWARM, CONDITION]),
            ("run", vec!["run", RUN, "--until-step", &step, "--wait"]),
        ];
        let programs = programs.map(|(call, arguments)| {
            let program = Command::new(program("jostle"))
                // Longer than each outage: an attempt of zenoh to connect that reaches its timeout just
                // when the daemon accepts it leaves a connection that zenoh 1.10 does not read.
                .args(["--timeout", "600"])
                .args(arguments)
                .env("JOSTLE_ENDPOINT", reached)
                .stdin(Stdio::null())
                .stdout(Stdio::null())
                .stderr(Stdio::piped())
                .spawn();
            (call, Ending(program.unwrap()))
        });
        assert!(lines.any(|line| line.unwrap().ends_with("ready")));
        let began = Instant::now();
        while near.status(RUN).await.unwrap().result.until_step != Some(LAST_STEP) {
            assert!(began.elapsed() < TIMEOUT, "`jostle run` has not begun");
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        // Both programs have begun to wait a moment after that.
        tokio::time::sleep(Duration::from_millis(300)).await;
        near.close().await;
        Scene {
            folder,
            endpoint,
            daemon: Some(daemon),
            router,
            client,
            lines,
            programs,
        }
    }

    /// Lets the fault happen; returns when it begins and ends.
    async fn inflict(&mut self, fault: &Fault) -> (f64, f64) {
        let began = now();
        let lasts = tokio::time::sleep(Duration::from_secs_f64(fault.secs));
        match fault.name.split('_').next().unwrap() {
            "stopped" => {
                let daemon = self.daemon.as_ref().unwrap();
                daemon.suspend();
                lasts.await;
                daemon.resume();
            }
            "router" => {
                let (running, listen) = self.router.take().unwrap();
                drop(running);
                lasts.await;
                self.router = Some((router(&self.endpoint, &listen), listen));
            }
            "restarted" => {
                self.daemon.take().unwrap().kill();
                lasts.await;
                self.daemon = Some(Process::start(self.folder.path(), &self.endpoint).0);
            }
            "suspended" => {
                for name in ["STOP", "CONT"] {
                    signal(&self.client.0, name);
                    for (_, program) in &self.programs {
                        signal(&program.0, name);
                    }
                    if name == "STOP" {
                        tokio::time::sleep(Duration::from_secs_f64(fault.secs)).await;
                    }
                }
            }
            name => panic!("unknown fault {name}"),
        }
        (began, now())
    }

    /// Lets the calls succeed after the outage; returns what the client saw, what `jostle` said, and the
    /// notes in the journal.
    async fn finish(mut self) -> (Seen, Vec<(&'static str, String)>, Vec<String>) {
        let near = connect(&self.endpoint).await;
        let run = RunArgs {
            until_step: Some(LAST_STEP),
            rate: Some(None),
            ..RunArgs::default()
        };
        for swarm in [SWARM, RUN] {
            near.execute(swarm, &run).await.unwrap();
            let began = Instant::now();
            while near.status(swarm).await.unwrap().step < LAST_STEP {
                assert!(
                    began.elapsed() < 3 * TIMEOUT,
                    "{swarm} does not reach its last step"
                );
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
        writeln!(self.client.0.stdin.take().unwrap(), "over").unwrap();
        let text = LAST_NOTE.to_owned();
        near.execute(SWARM, &AnnotateArgs { text }).await.unwrap();
        let (mut lines, client) = (self.lines, self.client);
        let seen = tokio::task::spawn_blocking(move || {
            let seen = lines.find_map(|line| serde_json::from_str(&line.unwrap()).ok());
            drop(client);
            seen.expect("what the client saw")
        });
        let seen: Seen = seen.await.unwrap();
        // A wait that the outage ended has started again, perhaps after the last step.
        let on = RunArgs {
            rate: Some(Some(1000.0)),
            ..RunArgs::default()
        };
        near.execute(SWARM, &on).await.unwrap();
        let programs = self.programs;
        let said = tokio::task::spawn_blocking(|| {
            let said = programs.map(|(call, mut program)| {
                let mut said = String::new();
                let errors = program.0.stderr.take().unwrap();
                BufReader::new(errors).read_to_string(&mut said).unwrap();
                let status = program.0.wait().unwrap();
                assert!(status.success(), "jostle {call}: {status}: {said}");
                (call, said)
            });
            said.into()
        });
        let said: Vec<_> = said.await.unwrap();
        let args = journal(&near).await;
        let notes = args.iter().filter_map(|it| it["text"].as_str());
        let notes = notes.map(str::to_owned).collect();
        near.close().await;
        (seen, said, notes)
    }
}

/// The arguments of the commands in the journal of the swarm.
async fn journal(client: &Client) -> Vec<serde_json::Value> {
    let (mut all, mut noun) = (Vec::new(), "journal".to_owned());
    loop {
        let page: Reply<Journal> = client.get(SWARM, &noun).await.unwrap().read().unwrap();
        all.extend(page.result.entries.into_iter().map(|it| it.args));
        match page.result.next {
            Some(line) => noun = format!("journal?line={line}"),
            None => return all,
        }
    }
}

async fn connect(endpoint: &str) -> Client {
    let options = ConnectOptions {
        timeout: TIMEOUT,
        ..ConnectOptions::to(endpoint)
    };
    Client::connect(options).await.unwrap()
}

/// How what a call saw differs from the table; `None` if it does not.
fn differs(
    call: &str,
    expected: &str,
    seen: &Seen,
    said: &[(&str, String)],
    (began, ended): (f64, f64),
    is_suspended: bool,
) -> Option<String> {
    // `jostle wait` waits for conditions.
    let call = if call == "condition" { "wait" } else { call };
    let notes = match said.iter().find(|it| it.0 == call) {
        Some((_, said)) => {
            let note = |line: &str| match line {
                "the daemon is back" => Some(true),
                line if line.contains("; waiting up to") || line.contains("; retrying") => {
                    Some(false)
                }
                _ => None,
            };
            said.lines().filter_map(note).collect()
        }
        None => seen.said.get(call).cloned().unwrap_or_default(),
    };
    let should_say: &[bool] = match expected {
        "reconnects" => &[false, true],
        _ => &[],
    };
    if notes != should_say {
        return Some(format!("it said {notes:?}: {said:?}"));
    }
    if call == "wait" || call == "run" {
        return None;
    }
    let attempts = &seen.attempts[call];
    let codes: Vec<&String> = attempts.iter().filter_map(|it| it.code.as_ref()).collect();
    if !matches!(expected, "goes_on" | "reconnects") {
        if codes.is_empty() || codes.iter().any(|code| *code != expected) {
            return Some(format!("{codes:?}"));
        }
        let short = SHORT_TIMEOUT.as_secs_f64();
        let mut failed = attempts.iter().filter(|it| it.code.is_some());
        // Its last attempt is not later than its timeout, and the delay before is at most as long.
        let is_in_time = |secs: f64| secs >= short / 4.0 && secs <= short + GRACE_SECS;
        let wrong = failed.find(|it| !is_in_time(it.ended - it.began));
        return wrong
            .filter(|_| expected == "unavailable")
            .map(|it| format!("it took {} s", it.ended - it.began));
    }
    if !codes.is_empty() {
        return Some(format!("{codes:?}"));
    }
    if expected == "goes_on" && !is_suspended {
        let during = attempts
            .iter()
            .filter(|it| it.began < ended && it.ended > began);
        let longest = during.map(|it| it.ended - it.began).fold(0.0, f64::max);
        // On a busy machine a request begins late.
        if longest < 0.5 * (ended - began) {
            return Some(format!("the longest took {longest} s"));
        }
    }
    None
}

/// Compares what each call sees of a fault with the table.
async fn check(name: &str) {
    let fault = fault(name);
    let mut scene = Scene::start(name == "router").await;
    let outage = scene.inflict(&fault).await;
    let (seen, said, journal) = scene.finish().await;
    let is_suspended = name == "suspended";
    let problems = fault.seen.iter().filter_map(|(call, expected)| {
        let expected = expected.as_str().unwrap();
        let problem = differs(call, expected, &seen, &said, outage, is_suspended)?;
        Some(format!("{call} should see {expected}: {problem}"))
    });
    assert_eq!(problems.collect::<Vec<_>>(), Vec::<String>::new());
    // The number jumps at a restart; no event is missing.
    assert!(seen.events.windows(2).all(|pair| pair[0].0 < pair[1].0));
    let notes: Vec<&String> = seen.events.iter().filter_map(|it| it.1.as_ref()).collect();
    let last = journal.iter().position(|text| text == LAST_NOTE).unwrap();
    assert_eq!(notes, journal[..=last].iter().collect::<Vec<_>>());
    let mut once = journal.clone();
    once.sort();
    once.dedup();
    assert_eq!(once.len(), journal.len(), "a command was executed twice");
    let is_executed = |note: &String| journal.contains(note);
    assert!(
        seen.noted.iter().all(is_executed),
        "a command was not executed"
    );
    assert!(
        seen.reached.is_sorted_by(|a, b| a < b),
        "{:?}",
        seen.reached
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn calls_go_on_while_a_daemon_is_stopped_for_1_s() {
    check("stopped_1").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn calls_see_what_the_table_says_of_a_daemon_that_is_stopped_for_4_s() {
    check("stopped_4").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn calls_see_what_the_table_says_of_a_daemon_that_is_stopped_for_8_s() {
    check("stopped_8").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn calls_see_what_the_table_says_of_a_daemon_that_is_stopped_for_15_s() {
    check("stopped_15").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn calls_see_what_the_table_says_of_a_restarted_router() {
    check("router").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn calls_see_what_the_table_says_of_a_restarted_daemon() {
    check("restarted").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn calls_see_what_the_table_says_of_a_suspended_client() {
    check("suspended").await;
}

/// Sends commands, one after the other, to the swarm, or with the number 0 to the daemon; returns how
/// many.
async fn change_often(client: Client, number: u32, is_over: Arc<AtomicBool>) -> u32 {
    let mut count = 0;
    while !is_over.load(Ordering::SeqCst) {
        count += 1;
        if number == 0 {
            let name = format!("other-{count}");
            let args = CreateArgs {
                name: name.clone(),
                spec: Spec::new(1),
                exist_ok: false,
            };
            client.create(&args).await.unwrap();
            client.execute(&name, &DeleteArgs {}).await.unwrap();
        } else {
            let args = SetArgs {
                pi3: Some(strength(number, count)),
                ..SetArgs::default()
            };
            client.execute(SWARM, &args).await.unwrap();
        }
    }
    count
}

/// Another one for each command.
fn strength(number: u32, count: u32) -> f64 {
    f64::from(100 * count + number) / 1e6
}

#[tokio::test(flavor = "multi_thread")]
async fn commands_in_flight_at_a_kill_are_executed_once() {
    let folder = tempfile::tempdir().unwrap();
    let (mut daemon, endpoint) = Process::start(folder.path(), "tcp/127.0.0.1:0");
    let client = connect(&endpoint).await;
    let args = CreateArgs {
        name: SWARM.to_owned(),
        spec: Spec::new(3),
        exist_ok: false,
    };
    client.create(&args).await.unwrap();
    let is_over = Arc::<AtomicBool>::default();
    let send = |number| tokio::spawn(change_often(client.clone(), number, is_over.clone()));
    let sent: Vec<_> = (0..6).map(send).collect();
    for _ in 0..3 {
        tokio::time::sleep(Duration::from_millis(500)).await;
        daemon.kill();
        daemon = Process::start(folder.path(), &endpoint).0;
    }
    tokio::time::sleep(Duration::from_millis(500)).await;
    is_over.store(true, Ordering::SeqCst);
    let mut expected = Vec::new();
    for (number, count) in (0..).zip(sent) {
        let count = count.await.unwrap();
        assert!(count > 0, "{number} sent nothing");
        if number > 0 {
            expected.extend((1..=count).map(|it| strength(number, it)));
        }
    }
    let mut done: Vec<f64> = journal(&client)
        .await
        .iter()
        .filter_map(|it| it["pi3"].as_f64())
        .collect();
    done.sort_by(f64::total_cmp);
    expected.sort_by(f64::total_cmp);
    assert_eq!(done, expected);
    assert_eq!(client.swarms().await.unwrap(), [SWARM]);
    client.close().await;
    drop(daemon);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_is_not_sent_again_to_a_daemon_with_other_data() {
    let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let (daemon, endpoint) = Process::start(folders[0].path(), "tcp/127.0.0.1:0");
    let client = connect(&endpoint).await;
    let args = CreateArgs {
        name: SWARM.to_owned(),
        spec: Spec::new(100),
        exist_ok: false,
    };
    client.create(&args).await.unwrap();
    let step = tokio::spawn({
        let client = client.clone();
        async move {
            client
                .execute(
                    SWARM,
                    &StepArgs {
                        steps: 10_000_000,
                        return_: Return::None,
                    },
                )
                .await
        }
    });
    while client.status(SWARM).await.unwrap().step == 0 {}
    daemon.kill();
    let (daemon, _) = Process::start(folders[1].path(), &endpoint);
    let other = connect(&endpoint).await;
    other.create(&args).await.unwrap();
    other.close().await;
    let error = step.await.unwrap().unwrap_err();
    assert!(error.to_string().contains("does not know that"), "{error}");
    assert_eq!(client.status(SWARM).await.unwrap().step, 0);
    client.close().await;
    drop(daemon);
}
