//! What a command line leaves on the daemon, however it ends.

use std::fs;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::support::{Daemon, Ended, TIMEOUT, open_peer, until};

/// How a command line ends.
#[derive(Clone, Copy, Debug)]
enum Way {
    /// By itself, with this exit code.
    Alone(i32),
    /// At Ctrl-C, with this exit code.
    Interrupted(i32),
    /// By SIGKILL.
    Killed,
}
use Way::{Alone, Interrupted, Killed};

/// What it leaves.
#[derive(Clone, Copy, Debug)]
enum Left {
    Nothing,
    /// The swarm runs until a step.
    Run(u64),
    /// A condition that waits.
    Condition,
    /// One that waits in a swarm that runs.
    RunUntil,
    /// An experiment that is not over.
    Experiment,
    /// A recording that runs.
    Recording,
    /// Another swarm.
    Swarm,
}

/// A run for a million time units.
const LAST: u64 = 50_000_000;

/// Command lines on a paused swarm `demo`; `{}` is a folder.
const LINES: [(&str, Way, Left); 36] = [
    ("wait demo order>1", Interrupted(130), Left::Nothing),
    ("wait demo order>1 --timeout 0.5", Alone(6), Left::Nothing),
    ("wait demo order>1", Killed, Left::Nothing),
    ("wait demo order>>1", Alone(2), Left::Nothing),
    ("wait nobody order>1", Alone(3), Left::Nothing),
    ("run demo --until 1e6", Alone(0), Left::Run(LAST)),
    (
        "run demo --until 1e6 --wait",
        Interrupted(130),
        Left::Run(LAST),
    ),
    (
        "run demo --until 1e6 --wait --timeout 5",
        Alone(6),
        Left::Run(LAST),
    ),
    ("run demo --until 1e6 --wait", Killed, Left::Run(LAST)),
    ("run demo --until=-1", Alone(2), Left::Nothing),
    (
        "run demo --until 1e6 --expect-step 7",
        Alone(4),
        Left::Nothing,
    ),
    ("run nobody --until 1e6 --wait", Alone(3), Left::Nothing),
    ("run demo --until order>1", Alone(0), Left::RunUntil),
    (
        "run demo --until order>1 --wait",
        Interrupted(130),
        Left::RunUntil,
    ),
    (
        "run demo --until order>1 --wait --timeout 5",
        Alone(6),
        Left::RunUntil,
    ),
    (
        "run demo --until order>1 --expect-step 7",
        Alone(4),
        Left::Nothing,
    ),
    ("when demo order>1 pause", Alone(0), Left::Condition),
    ("when demo order>>1 pause", Alone(2), Left::Nothing),
    (
        "when demo order>1 pause --expect-step 7",
        Alone(4),
        Left::Nothing,
    ),
    ("when nobody order>1 pause", Alone(3), Left::Nothing),
    ("create other --n 2", Alone(0), Left::Swarm),
    ("create other --n 0", Alone(2), Left::Nothing),
    ("create other --n 100000", Alone(2), Left::Nothing),
    ("create demo --n 2", Alone(4), Left::Nothing),
    ("fork demo demo", Alone(4), Left::Nothing),
    ("fork nobody other", Alone(3), Left::Nothing),
    (
        "experiment run {}/endless.toml",
        Interrupted(130),
        Left::Experiment,
    ),
    ("experiment run {}/endless.toml", Killed, Left::Experiment),
    ("experiment run {}/bad.toml", Alone(2), Left::Nothing),
    ("record demo -o {}/a.mcap", Interrupted(0), Left::Nothing),
    (
        "record demo -o {}/a.mcap --for 0.3",
        Alone(0),
        Left::Nothing,
    ),
    (
        "record demo -o {}/a.mcap --every 0",
        Alone(2),
        Left::Nothing,
    ),
    ("record nobody -o {}/a.mcap", Alone(3), Left::Nothing),
    ("record demo --at-daemon", Alone(0), Left::Recording),
    (
        "record demo -o {}/a.mcap --published",
        Killed,
        Left::Nothing,
    ),
    ("replay {}/bad.mcap", Alone(2), Left::Nothing),
];

const ENDLESS: &str = "name = \"endless\"\nreplicates = 2\nduration = 1e6\nspec = { n = 5 }\n";

/// What the daemon has of all kinds: swarms, what waits in them, experiments and recordings.
async fn seen(daemon: &Daemon) -> Value {
    let mut seen = json!({});
    let swarms = daemon.reply("list").await["result"]["swarms"].take();
    let named = |it: &Value| it["swarm"].clone();
    let names: Vec<Value> = swarms.as_array().unwrap().iter().map(named).collect();
    let status = daemon.reply("status demo").await["result"].take();
    for field in [
        "until_step",
        "when",
        "conditions",
        "waits",
        "scheduled",
        "controllers",
        "informed",
        "n",
    ] {
        seen[field] = status[field].clone();
    }
    seen["phase"] = daemon.reply("status demo").await["phase"].take();
    seen["swarms"] = json!(names);
    for (line, field) in [
        ("experiment list", "experiments"),
        ("record --list", "recordings"),
    ] {
        let mut all = daemon.reply(line).await["result"][field].take();
        for it in all.as_array_mut().unwrap() {
            *it = json!({"name": it["name"], "swarm": it["swarm"], "phase": it["phase"]});
        }
        seen[field] = all;
    }
    seen
}

/// Whether a command line has reached the daemon.
async fn has_begun(daemon: &Daemon, line: &str, before: &Value) -> bool {
    match line.split(' ').next().unwrap() {
        "record" if line.ends_with("--published") => {
            fs::metadata(format!("{}.partial", line.split(' ').nth(3).unwrap())).is_ok()
        }
        _ => seen(daemon).await != *before,
    }
}

/// Runs a command line until it ends in its way.
async fn end(daemon: &Daemon, line: &str, way: Way, before: &Value) -> Ended {
    let mut running = daemon.begin(line);
    if !matches!(way, Alone(_)) {
        until(line, async || has_begun(daemon, line, before).await).await;
        assert!(running.is_running(), "{line}: {:?}", running.end().await);
        // It handles signals before it sends anything.
        match way {
            Interrupted(_) => running.interrupt(),
            _ => running.signal("-KILL"),
        }
    }
    running.end().await
}

/// What is seen if that is left.
fn expected(before: &Value, left: Left) -> Value {
    let mut seen = before.clone();
    match left {
        Left::Nothing => {}
        Left::Run(step) => {
            seen["phase"] = json!("running");
            seen["until_step"] = json!(step);
        }
        Left::RunUntil => {
            seen["phase"] = json!("running");
            seen["conditions"] = json!([{"condition": "order > 1"}]);
        }
        Left::Condition => seen["conditions"] = json!([{"condition": "order > 1"}]),
        Left::Experiment => {
            let endless = json!({"name": "endless", "swarm": null, "phase": "running"});
            seen["experiments"] = json!([endless]);
        }
        Left::Recording => {
            let recording = json!({"name": null, "swarm": "demo", "phase": "recording"});
            seen["recordings"] = json!([recording]);
        }
        Left::Swarm => seen["swarms"] = json!(["demo", "other"]),
    }
    seen
}

/// What differs from run to run is left out.
fn plain(mut seen: Value) -> Value {
    if let Some(conditions) = seen["conditions"].as_array_mut() {
        for it in conditions {
            *it = it["condition"].take();
        }
    }
    seen["when"] = Value::Null;
    seen
}

#[tokio::test(flavor = "multi_thread")]
async fn each_end_of_each_verb_leaves_what_the_table_says() {
    for (line, way, left) in LINES {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        fs::write(at.join("endless.toml"), ENDLESS).unwrap();
        fs::write(at.join("bad.toml"), ENDLESS.replace("n = 5", "n = -5")).unwrap();
        fs::write(at.join("bad.mcap"), "no recording").unwrap();
        let line = line.replace("{}", at.to_str().unwrap());
        let daemon = Daemon::start().await;
        daemon.said("create demo --n 5 --rate 1").await;
        let before = seen(&daemon).await;
        let ended = end(&daemon, &line, way, &before).await;
        let code = match way {
            Alone(code) | Interrupted(code) => Some(code),
            Killed => None,
        };
        assert_eq!(ended.code, code, "{line}, {way:?}: {ended:?}");
        let expected = expected(&before, left);
        let (began, mut after) = (Instant::now(), Value::Null);
        // That a process has ended is noticed a moment later.
        while began.elapsed() < TIMEOUT {
            after = plain(seen(&daemon).await);
            if after == plain(expected.clone()) {
                break;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        assert_eq!(after, plain(expected), "{line}, {way:?}: {ended:?}");
        daemon.stop().await;
    }
}

/// Has a controller hold `demo` in lock-step, as long as the session lives.
async fn hold(daemon: &Daemon) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    let endpoints = json!([daemon.endpoint]).to_string();
    config
        .insert_json5("connect/endpoints", &endpoints)
        .unwrap();
    let session = open_peer(config).await;
    let token = session
        .liveliness()
        .declare_token("jostle/demo/ctl/ada/alive");
    // It lives as long as the session.
    std::mem::forget(token.await.unwrap());
    let args = json!({"args": {"controller": "ada"}}).to_string();
    let joined = session.get("jostle/demo/cmd/join").payload(args);
    let replies = joined.await.unwrap();
    replies.recv_async().await.unwrap().into_result().unwrap();
    session
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_that_a_controller_prevents_leaves_no_condition() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 5").await;
    let session = hold(&daemon).await;
    let before = seen(&daemon).await;
    assert_eq!(before["controllers"], 1);
    for line in [
        "run demo --until order>1",
        "run demo --until order>1 --wait",
    ] {
        let ended = daemon.jostle(line).await;
        assert_eq!(ended.code, Some(4), "{ended:?}");
        assert_eq!(seen(&daemon).await, before, "{ended:?}");
    }
    // One that waited before is still there.
    daemon.said("when demo order>0.999 pause").await;
    daemon.jostle("run demo --until order>1").await;
    assert_eq!(seen(&daemon).await["when"], json!(["order > 0.999"]));
    session.close().await.unwrap();
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_that_is_paused_before_its_condition_holds_is_no_success() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 5 --rate 1").await;
    for (line, by) in [
        ("pause demo", "requested"),
        ("when demo order>=0 pause", "condition"),
    ] {
        let running = daemon.begin("run demo --until order>1 --wait");
        daemon.until_running("demo").await;
        daemon.said(line).await;
        let ended = running.end().await;
        assert_eq!(ended.code, Some(4), "{ended:?}");
        let text = format!(
            ", before order>1 ({by}): `jostle run demo` continues, and `jostle when demo --cancel "
        );
        assert!(ended.stderr.contains(&text), "{ended:?}");
        // The command that it names removes the condition.
        let (_, id) = ended.stderr.split_once("--cancel ").unwrap();
        let id = id.split('`').next().unwrap();
        daemon.said(&format!("when demo --cancel {id}")).await;
        assert_eq!(seen(&daemon).await["when"], Value::Null);
    }
    // It pauses the swarm itself.
    let ended = daemon.jostle("run demo --until order>=0 --wait").await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    daemon.stop().await;
}
