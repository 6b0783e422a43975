//! A daemon that is suspended keeps its controllers.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use jostle_proto::keys;
use serde_json::{Value, json};
use tokio::time::sleep;

use super::{advance, join};
use crate::support::daemon_process::start;
use crate::support::process::send_signal;
use crate::support::{Client, PREFIX, until};

/// The variable with the endpoint for [`a_controller_process`].
const ENDPOINT: &str = "JOSTLE_CONTROLLER_ENDPOINT";

/// Not a test: a controller in a process of its own.
#[tokio::test(flavor = "multi_thread")]
async fn a_controller_process() {
    let Ok(endpoint) = std::env::var(ENDPOINT) else {
        return;
    };
    let client = Client::open(&endpoint).await;
    join(&client, "eve", &[2], json!({"deadline_secs": 60})).await;
    println!("\njoined");
    std::future::pending::<()>().await;
}

pub fn controller_process(endpoint: &str) -> Child {
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args([
            "controllers::suspended::a_controller_process",
            "--exact",
            "--nocapture",
        ])
        .env(ENDPOINT, endpoint)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let output = BufReader::new(child.stdout.take().unwrap());
    let joined = |line: std::io::Result<String>| line.unwrap() == "joined";
    assert!(output.lines().any(joined));
    child
}

/// The internal commands in the journal, with their controllers.
pub async fn removals(client: &Client) -> Vec<(String, String)> {
    let journal = client.get("a", "journal").await;
    let entries = journal["result"]["entries"].as_array().unwrap();
    let own = entries
        .iter()
        .filter(|it| keys::OWN_VERBS.iter().any(|verb| it["verb"] == *verb));
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    own.map(|it| (text(&it["verb"]), text(&it["args"]["controller"])))
        .collect()
}

/// A reply to a query that may get none, since the connection is lost.
pub async fn again(client: &Client, verb: &str, request: &Value) -> Value {
    let (key, mut answers) = (keys::cmd(PREFIX, "a", verb), Vec::new());
    until(verb, async || {
        let request = request.to_string();
        answers = client.query_all(&key, Some(request.as_bytes())).await;
        matches!(&answers[..], [Ok(_)])
    })
    .await;
    answers.remove(0).unwrap()
}

async fn suspended_for(secs: u64) {
    let folder = tempfile::tempdir().unwrap();
    let (process, client) = start(folder.path()).await;
    client.create("a", json!({"n": 6})).await;
    let (ada, bob) = (
        Client::open(&process.endpoint).await,
        Client::open(&process.endpoint).await,
    );
    // A deadline that passes during the suspension, and a limit of silence.
    join(&ada, "ada", &[0], json!({"deadline_secs": 60})).await;
    join(&bob, "bob", &[1], json!({"deadline_secs": 2})).await;
    let mut eve = controller_process(&process.endpoint);
    client.ok("a", "set", json!({"max_idle_secs": 4})).await;
    // One waits for the others when the daemon is suspended.
    let request = |name: &str, step: u64| {
        json!({"request_id": format!("{name}-{step}"), "expect_step": step, "timeout_secs": 60,
            "args": {"controller": name}})
    };
    let waiting = request("ada", 0).to_string();
    let key = keys::cmd(PREFIX, "a", "advance");
    let waiting = ada.query_all(&key, Some(waiting.as_bytes()));
    let suspending = async {
        until("ada waits", async || {
            client.get("a", "status").await["result"]["waiting_for"][0]["controller"] == "bob"
        })
        .await;
        send_signal(process.child.id(), "-STOP");
        sleep(Duration::from_secs(secs) / 2).await;
        // A client that ends meanwhile.
        eve.kill().unwrap();
        eve.wait().unwrap();
        sleep(Duration::from_secs(secs) / 2).await;
        send_signal(process.child.id(), "-CONT");
        Instant::now()
    };
    let (unheard, resumed) = tokio::join!(waiting, suspending);
    assert!(unheard.is_empty(), "{unheard:?}");
    let held = async |name: &str| {
        let tokens = client.session.liveliness();
        let tokens = tokens
            .get(keys::ctl_alive(PREFIX, "a", name))
            .await
            .unwrap();
        tokens.recv_async().await.is_ok()
    };
    // Each goes on where it was once it is connected, and what was sent before the suspension is executed once.
    let goes_on = async |controller: &Client, name: &str| {
        until("the token is there", async || held(name).await).await;
        again(controller, "advance", &request(name, 0)).await
    };
    let (first, second) = tokio::join!(goes_on(&ada, "ada"), goes_on(&bob, "bob"));
    // The controller of the client that ended holds the swarm until the grace is over.
    assert_eq!((&first["step"], &second["step"]), (&json!(1), &json!(1)));
    let took = resumed.elapsed();
    assert!(took >= Duration::from_secs(9), "{took:?}");
    assert!(took < Duration::from_secs(13), "{took:?}");
    assert_eq!(
        removals(&client).await,
        [("lost".to_owned(), "eve".to_owned())]
    );
    for step in 1..4 {
        let (first, second) = tokio::join!(
            advance(&ada, "ada", step, json!({})),
            advance(&bob, "bob", step, json!({}))
        );
        assert_eq!(first.unwrap()["step"], step + 1);
        assert_eq!(second.unwrap()["step"], step + 1);
    }
    // A token that is lost later counts at once.
    let began = Instant::now();
    bob.session.close().await.unwrap();
    until("bob is lost", async || {
        client.get("a", "status").await["result"]["controllers"] == 1
    })
    .await;
    assert!(
        began.elapsed() < Duration::from_secs(5),
        "{:?}",
        began.elapsed()
    );
    let verified = client.get("a", "verify").await;
    assert_eq!(verified["result"]["differs_at"], Value::Null);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_was_suspended_for_5_s_keeps_its_controllers() {
    suspended_for(5).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_was_suspended_for_15_s_keeps_its_controllers() {
    suspended_for(15).await;
}
