//! The options that verbs have in common: a verb offers those that have an effect on it.

use std::net::TcpListener;
use std::path::Path;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use serde_json::Value;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;

use crate::requests::row::Row;
use crate::requests::{bases, files, rows, surface, verb};
use crate::support::{Daemon, Ended, Running};

/// Command lines of verbs whose first row needs another state of the daemon or of the folder, does not end
/// by itself, or deletes or protects what others need. `{}` is a folder, which all have in common.
const LINES: [&str; 8] = [
    "auth link",
    "delete nothing",
    "plot snapshot demo -o {}/demo.svg",
    "protect demo --off",
    "replay --recording nothing",
    "run demo --until-step 1000000 --rate 1",
    "snapshot demo -o {}/again.snapshot --force",
    "wait demo order>=0",
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

/// A command line for each verb and nested verb: that of [`LINES`], or else of its first row.
fn lines(folder: &Path) -> Vec<(String, String)> {
    let rows: Vec<(String, Row)> = rows().into_iter().map(|row| (verb(&row), row)).collect();
    let of_rows = bases().into_iter().chain(rows);
    let of_rows: Vec<_> = of_rows
        .map(|(verb, row)| (verb, row.typed(folder)))
        .collect();
    let line_of = |verb: &String| {
        let is_of = |line: &&str| line.starts_with(&format!("{verb} "));
        let own = LINES.into_iter().find(|line| is_of(line) || line == verb);
        let first = of_rows.iter().find(|(it, _)| it == verb);
        own.map(|line| line.replace("{}", folder.to_str().unwrap()))
            .or_else(|| first.map(|(_, line)| line.clone()))
    };
    let verbs = surface().into_keys().filter(|verb| verb != "jostle");
    verbs
        .map(|verb| {
            let line = line_of(&verb).unwrap_or_else(|| panic!("no row of {verb}"));
            (verb, line)
        })
        .collect()
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
    let daemon = Daemon::start().await;
    let folder = files();
    for line in ["create demo --n 6", "create twin --n 6"] {
        daemon.said(line).await;
    }
    let mute = mute();
    let permits = Arc::new(Semaphore::new(AT_ONCE));
    let mut checks = JoinSet::new();
    for (verb, line) in lines(folder.path()) {
        let help = daemon.said(&format!("{verb} --help")).await;
        for option in [
            "endpoint",
            "credentials",
            "node",
            "prefix",
            "timeout",
            "json",
        ] {
            if !help.contains(&format!("--{option}"))
                || NOT_REACHED.contains(&(verb.as_str(), option))
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
