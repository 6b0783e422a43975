//! The options that verbs have in common: a verb offers those that have an effect on it.

use std::collections::BTreeSet;
use std::fs;
use std::net::TcpListener;
use std::path::Path;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use serde_json::Value;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;

use crate::support::{Daemon, Ended, Running};

/// A command line for each verb and nested verb. `{}` is a folder.
const LINES: [&str; 57] = [
    "annotate demo note",
    "audit",
    "auth can pause",
    "auth link",
    "auth whoami",
    "batch demo {}/batch.json",
    "claims {}/nothing",
    "completions bash",
    "controllers demo",
    "create other --n 3 --exist-ok",
    "delete nothing",
    "diff demo twin",
    "doctor",
    "events demo",
    "experiment attach nothing",
    "experiment cancel nothing",
    "experiment delete nothing",
    "experiment list",
    "experiment pause nothing",
    "experiment plan {}/order.toml",
    "experiment play {}/order.toml",
    "experiment results nothing",
    "experiment resume nothing",
    "experiment run {}/order.toml --detach",
    "experiment status nothing",
    "plot snapshot demo -o {}/demo.svg",
    "fork demo copy",
    "inform demo --count 1 --direction 0",
    "inject demo --count 1",
    "journal demo",
    "leave demo nothing",
    "list",
    "man",
    "measures demo",
    "nodes",
    "parameters demo",
    "pause demo",
    "record --list",
    "remove demo --count 1",
    "replay --recording nothing",
    "reset demo",
    "restore {}/demo.snapshot restored",
    "results merge {}/nothing -o {}/merged",
    "run demo --until-step 1000000 --rate 1",
    "schema step.args",
    "seek demo --step 1",
    "set demo pi3=1",
    "snapshot demo -o {}/again.snapshot --force",
    "spec demo",
    "status demo",
    "step demo",
    "top -n 1 --interval 0.1",
    "uninform demo --count 0",
    "verify twin",
    "wait demo order>=0",
    "watch demo --count 1",
    "when demo --cancel",
];

/// How many command lines run at once.
const AT_ONCE: usize = 8;

/// Options whose effect these lines cannot show: `watch` on a terminal lists the swarms of a node,
/// and `auth link` queries the address of a node that has users.
const NOT_REACHED: [(&str, &str); 3] = [
    ("watch", "node"),
    ("auth link", "node"),
    ("auth link", "prefix"),
];

/// The verbs without nested verbs, from the list of all that a script may use.
fn verbs() -> Vec<&'static str> {
    let surface = include_str!("../../surface.txt").lines();
    let words = surface.filter(|line| !line.contains(['-', '<']) && !line.starts_with("jostle"));
    let words: Vec<&str> = words.collect();
    let has_verbs = |verb: &str| words.iter().any(|it| it.starts_with(&format!("{verb} ")));
    words
        .iter()
        .copied()
        .filter(|verb| !has_verbs(verb))
        .collect()
}

/// The verb that a line begins with.
fn verb(line: &str) -> &'static str {
    let is_it = |verb: &&str| line == *verb || line.starts_with(&format!("{verb} "));
    verbs().into_iter().find(is_it).expect(line)
}

async fn run(endpoint: &str, line: &str) -> Ended {
    Running::begin(endpoint, line, "").end().await
}

/// A server that accepts connections and never sends a byte.
fn mute() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("tcp/{}", listener.local_addr().unwrap());
    thread::spawn(move || {
        let connections: Vec<_> = listener.incoming().collect();
        drop(connections);
    });
    endpoint
}

/// Checks that an offered option has an effect on a line.
async fn check(endpoint: &str, mute: &str, line: &str, option: &str) {
    let said =
        |ended: &Ended, text: &str| format!("{}{}", ended.stdout, ended.stderr).contains(text);
    match option {
        "endpoint" => {
            let ended = run(endpoint, &format!("{line} --endpoint tcp/127.0.0.1:1")).await;
            assert_eq!(ended.code, Some(6), "{line}: {ended:?}");
        }
        "credentials" => {
            let ended = run(endpoint, &format!("{line} --credentials /no/such")).await;
            assert!(said(&ended, "/no/such"), "{line}: {ended:?}");
        }
        "node" => {
            let ended = run(endpoint, &format!("{line} --node elsewhere")).await;
            assert_eq!(ended.code, Some(3), "{line}: {ended:?}");
            assert!(said(&ended, "elsewhere"), "{line}: {ended:?}");
        }
        "prefix" => {
            let ended = run(endpoint, &format!("{line} --prefix elsewhere")).await;
            assert_eq!(ended.code, Some(6), "{line}: {ended:?}");
            assert!(said(&ended, "`elsewhere`"), "{line}: {ended:?}");
        }
        "timeout" => {
            // The default is 5 s.
            let began = Instant::now();
            let ended = run(mute, &format!("{line} --timeout 0.1")).await;
            let took = began.elapsed();
            assert_eq!(ended.code, Some(6), "{line}: {ended:?}");
            assert!(took < Duration::from_secs(5), "{line}: {took:?}");
        }
        _ => {
            let ended = run(endpoint, &format!("{line} --json")).await;
            for line in ended.stdout.lines().chain(ended.stderr.lines()) {
                let read = serde_json::from_str::<Value>(line);
                assert!(read.is_ok(), "{line}: {ended:?}");
            }
        }
    }
}

fn prepare(folder: &Path) {
    let batch = r#"[{"verb": "set", "args": {"pi3": 1}}]"#;
    fs::write(folder.join("batch.json"), batch).unwrap();
    let order = "name = \"order\"\nduration = 1\nspec = { n = 3 }\n";
    fs::write(folder.join("order.toml"), order).unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn an_unknown_host_a_silent_listener_and_no_listener_have_their_own_messages() {
    let ended = run("tcp/no-such-host.invalid:7447", "list").await;
    ended.assert_stderr(6, "no address is known of the host no-such-host.invalid");
    let ended = run(&mute(), "list --timeout 0.3").await;
    ended.assert_stderr(6, "it may hang");
    let ended = run("tcp/127.0.0.1:1", "list --timeout 0.3").await;
    let said =
        "no daemon answers at tcp/127.0.0.1:1, tried for 0.3 s: start one with `jostled serve`";
    ended.assert_stderr(6, said);
    let ended = run("tcp/127.0.0.1:1", "list --timeout 3").await;
    let said = "waiting up to 3 s for a daemon at tcp/127.0.0.1:1; Ctrl-C ends";
    ended.assert_stderr(6, said);
}

#[tokio::test(flavor = "multi_thread")]
async fn every_option_that_a_verb_offers_has_an_effect_on_it() {
    let listed: BTreeSet<&str> = LINES.into_iter().map(verb).collect();
    assert_eq!(
        listed,
        verbs().into_iter().collect(),
        "each verb has a line"
    );
    let daemon = Daemon::start().await;
    let folder = tempfile::tempdir().unwrap();
    prepare(folder.path());
    for line in ["create demo --n 6", "create twin --n 6"] {
        daemon.said(line).await;
    }
    let snapshot = folder.path().join("demo.snapshot");
    daemon
        .said(&format!("snapshot demo -o {}", snapshot.display()))
        .await;
    let mute = mute();
    let permits = Arc::new(Semaphore::new(AT_ONCE));
    let mut checks = JoinSet::new();
    for line in LINES {
        let help = daemon.said(&format!("{} --help", verb(line))).await;
        let line = line.replace("{}", folder.path().to_str().unwrap());
        for option in [
            "endpoint",
            "credentials",
            "node",
            "prefix",
            "timeout",
            "json",
        ] {
            if !help.contains(&format!("--{option}"))
                || NOT_REACHED.contains(&(verb(&line), option))
            {
                continue;
            }
            let (endpoint, mute, line) = (daemon.endpoint.clone(), mute.clone(), line.clone());
            let permits = permits.clone();
            checks.spawn(async move {
                let _permit = permits.acquire().await.unwrap();
                check(&endpoint, &mute, &line, option).await;
            });
        }
    }
    assert!(checks.len() > 200, "{}", checks.len());
    while let Some(checked) = checks.join_next().await {
        checked.unwrap();
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_option_without_effect_is_refused_with_a_reason() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 3").await;
    for line in ["--node elsewhere status demo", "-e tcp/127.0.0.1:1 man"] {
        let ended = daemon.jostle(line).await;
        ended.assert_stderr(2, "has no effect on `jostle ");
    }
    let ended = daemon.jostle("status demo --node elsewhere").await;
    assert_eq!(ended.code, Some(2), "{ended:?}");
    for verb in ["man", "completions bash", "claims results"] {
        let help = daemon.said(&format!("{verb} --help")).await;
        assert!(
            !help.contains("--endpoint") && help.contains("--json"),
            "{help}"
        );
    }
    daemon.stop().await;
}
