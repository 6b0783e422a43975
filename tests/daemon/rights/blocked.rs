//! A session with many subscriptions is closed: commands are blocked meanwhile (docs/security.md).

use std::fs::{self, File};
use std::io::{BufRead, BufReader};
use std::process::Stdio;
use std::time::{Duration, Instant};

use jostle_proto::keys;
use jostled::auth::folder::Folder;
use jostled::auth::issue;
use serde_json::{Value, json};
use tokio::time::sleep;

use super::{PEOPLE, SessionCredentials, UserSession};
use crate::support::http::send;
use crate::support::process::{Process, jostled};
use crate::support::{NODE, PREFIX, until};

/// Subscriptions that take zenoh about ten seconds to remove: a time that grows with their cube.
const SUBSCRIPTIONS: u32 = 1100;

/// The maximum time of the block, and until it begins, on a busy machine.
const LONGEST: Duration = Duration::from_secs(120);

/// Distinct keys that all match `jostle/a/state`: `$*` matches nothing, too.
fn key(k: u32) -> String {
    let mut key = String::new();
    for (bit, letter) in "jostlestate".chars().enumerate() {
        if bit == 6 {
            key += "/a/";
        }
        key.push(letter);
        if k >> bit & 1 == 1 {
            key += "$*";
        }
    }
    key
}

fn get(address: &str, path: &str, token: &str) -> (u16, String) {
    let request = format!(
        "GET {path} HTTP/1.1\r\nHost: {address}\r\nAuthorization: Bearer {token}\r\n\
         Connection: close\r\n\r\n"
    );
    let (status, _, body) = send(address, &request);
    (status, body)
}

fn metric(text: &str, name: &str) -> f64 {
    let line = text.lines().find_map(|line| line.strip_prefix(name));
    line.unwrap_or_else(|| panic!("no {name}"))
        .trim()
        .parse()
        .unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn blocked_commands_turn_health_red_and_the_log_names_the_session() {
    let base = tempfile::tempdir().unwrap();
    let folder = Folder::new(base.path().join("auth"));
    let people = PEOPLE.map(|(name, role)| (name.to_owned(), role));
    issue::init(&folder, &[], &people).unwrap();
    let log = base.path().join("log");
    let mut command = jostled(&["--listen", "tcp/127.0.0.1:0", "--node", NODE]);
    command
        .args(["--http", "127.0.0.1:0", "--data-dir"])
        .arg(base.path().join("data"))
        .arg("--auth-dir")
        .arg(folder.path())
        .stderr(File::create(&log).unwrap())
        .stdout(Stdio::piped());
    let mut process = Process(command.spawn().unwrap(), tempfile::tempdir().unwrap());
    let mut lines = BufReader::new(process.0.stdout.take().unwrap()).lines();
    let mut after = |start: &str| {
        let line = lines.next().unwrap().unwrap();
        line.strip_prefix(start).expect(&line).to_owned()
    };
    let endpoint = after("listening on ");
    let http = after("http on http://");
    let open = async |name: &str| UserSession {
        session: SessionCredentials::of(&folder, name)
            .open(&endpoint)
            .await
            .unwrap(),
        token: Some(folder.credentials(name).unwrap().token),
    };
    let olga = open("olga").await;
    olga.create("a").await;
    olga.cmd("a", "run", json!({"rate": 1})).await;
    let token = olga.token.clone().unwrap();
    let (status, body) = get(&http, "/healthz", &token);
    assert_eq!(status, 200, "{body}");
    let (_, metrics) = get(&http, "/metrics", &token);
    assert_eq!(metric(&metrics, "jostle_bus_blocked_seconds"), 0.0);
    let before = metric(&metrics, "jostle_bus_blocks_total");

    let vera = open("vera").await;
    let zid = vera.session.zid().to_string();
    let mut subscribers = Vec::new();
    for k in 0..SUBSCRIPTIONS {
        let subscriber = vera.session.declare_subscriber(key(k)).callback(|_| {});
        subscribers.push(subscriber.await.unwrap());
    }
    // All of them are declared once a later query gets a reply.
    olga.cmd("a", "set", json!({"args": {"pi2": 0.7}})).await;
    sleep(Duration::from_secs(1)).await;
    let closing = tokio::spawn(async move { vera.session.close().await.unwrap() });
    let began = Instant::now();
    let asking = tokio::spawn(async move {
        sleep(Duration::from_millis(300)).await;
        let asked = Instant::now();
        let key = keys::cmd(PREFIX, "a", "set");
        // On a busy machine the block outlasts the lease of the connection, and the query ends
        // without a reply.
        let set = json!({"args": {"pi2": 0.8}});
        while !matches!(olga.query_all(&key, Some(&set)).await[..], [Ok(_)]) {
            assert!(asked.elapsed() < LONGEST, "commands are still blocked");
            sleep(Duration::from_millis(50)).await;
        }
        (olga, asked.elapsed())
    });

    // During the block, over HTTP.
    let mut seen = Value::Null;
    while seen.is_null() {
        assert!(began.elapsed() < LONGEST, "it was never unhealthy");
        let asked = Instant::now();
        let (_, body) = get(&http, "/healthz", &token);
        assert!(
            asked.elapsed() < Duration::from_secs(5),
            "{:?}",
            asked.elapsed()
        );
        let report: Value = serde_json::from_str(&body).unwrap();
        let reasons = report["reasons"].as_array().unwrap().iter();
        let mut found = reasons.filter(|reason| reason["code"] == "bus_blocked");
        seen = found.next().cloned().unwrap_or_default();
        sleep(Duration::from_millis(50)).await;
    }
    let after_secs = began.elapsed();
    assert!(!asking.is_finished(), "commands are blocked");
    let (_, metrics) = get(&http, "/metrics", &token);
    assert!(metric(&metrics, "jostle_bus_blocked_seconds") >= 2.0);
    assert_eq!(metric(&metrics, "jostle_bus_blocks_total"), before + 1.0);
    let message = seen["message"].as_str().unwrap();
    assert!(message.contains(&format!("vera (zid {zid}")), "{message}");

    let (olga, took) = asking.await.unwrap();
    println!("seen after {after_secs:?}: {message}; a command took {took:?}");
    until("it is healthy again", async || {
        let (status, body) = get(&http, "/healthz", &token);
        status == 200 || panic_unless_passing(&body)
    })
    .await;
    let (_, metrics) = get(&http, "/metrics", &token);
    assert_eq!(metric(&metrics, "jostle_bus_blocked_seconds"), 0.0);
    let log = fs::read_to_string(&log).unwrap();
    let line = log
        .lines()
        .find(|line| line.contains("commands were blocked for"));
    let line = line.unwrap_or_else(|| panic!("{log}"));
    println!("{line}");
    assert!(
        line.contains(&format!(
            "while zenoh closed the session of vera (zid {zid}, tcp/127.0.0.1:"
        )),
        "{line}"
    );
    closing.await.unwrap();
    olga.session.close().await.unwrap();
}

/// Returns false; fails unless every reason is one that ends by itself.
fn panic_unless_passing(body: &str) -> bool {
    let report: Value = serde_json::from_str(body).unwrap();
    for reason in report["reasons"].as_array().unwrap() {
        let code = reason["code"].as_str().unwrap();
        // A listener is probed every 20 s, and does not answer during a long block.
        let passing = ["bus_blocked", "thread_stuck", "listener_deaf"];
        assert!(passing.contains(&code), "{body}");
    }
    false
}
