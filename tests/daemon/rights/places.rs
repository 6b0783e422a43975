//! What a user who is no operator may take of a swarm: scheduled commands, controllers, history, events.

use jostle_proto::{ErrorCode, Role, keys};
use serde_json::{Value, json};

use super::UserSession;
use super::live::process::AuthProcess;
use super::owners::created;
use crate::support::{PREFIX, hold_token, until};

const PEOPLE: [(&str, Role); 2] = [("cleo", Role::Controller), ("carl", Role::Controller)];

/// A step that no swarm reaches.
const LATER: u64 = 9_000_000_000_000;

/// Sends a command to a swarm; the error is the reply.
fn send(
    daemon: &AuthProcess,
    user: &str,
    swarm: &str,
    verb: &str,
    request: &Value,
) -> Result<Value, Value> {
    let key = format!("POST /api/cmd/{swarm}/{verb}");
    match daemon.http(&key, user, &request.to_string()) {
        (200, reply) => Ok(reply),
        (_, error) => Err(error),
    }
}

/// The request of a controller that joins a swarm which goes on, now or at a later step.
fn join(controller: &str, at_step: Option<u64>) -> Value {
    let args = json!({"controller": controller, "mode": "free_running", "again": true,
        "deadline_secs": 60});
    json!({"args": args, "at_step": at_step})
}

/// A session of an operator that holds the tokens of these controllers, which join over HTTP.
async fn hold(daemon: &AuthProcess, controllers: impl Iterator<Item = String>) -> UserSession {
    let olga = daemon.open_session("olga").await;
    for controller in controllers {
        let key = keys::cmd(PREFIX, "s", "join");
        let request = join(&controller, None).to_string();
        hold_token(&olga.session, &key, request.as_bytes()).await;
    }
    olga
}

fn names(names: &[&str]) -> impl Iterator<Item = String> {
    names.iter().map(ToString::to_string)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_controller_takes_no_place_of_another_users_scheduled_commands() {
    let daemon = AuthProcess::start(&PEOPLE).await;
    let _tokens = hold(&daemon, names(&["cleo", "carl"])).await;
    let cleo = |daemon: &AuthProcess| send(daemon, "cleo", "s", "join", &join("cleo", Some(LATER)));
    let mut accepted = 0;
    let error = loop {
        match cleo(&daemon) {
            Ok(_) => accepted += 1,
            Err(error) => break error,
        }
    };
    assert_eq!(accepted, 64, "{error}");
    assert_eq!(error["code"], "resource_exhausted", "{error}");
    let message = error["message"].as_str().unwrap();
    assert!(
        message.starts_with("64 commands of cleo are scheduled"),
        "{message}"
    );
    assert!(message.contains("`reset` of an operator"), "{message}");
    assert_eq!(error["details"]["person"], "cleo");
    let note = json!({"args": {"text": "a"}, "at_step": LATER});
    assert!(send(&daemon, "cleo", "s", "annotate", &note).is_err());

    let others = |daemon: &AuthProcess| {
        let inform = json!({"select": {"ids": [1]}, "direction": 1});
        let inform = json!({"args": inform, "at_step": LATER});
        send(daemon, "olga", "s", "inform", &inform).unwrap();
        send(daemon, "carl", "s", "join", &join("carl", Some(LATER))).unwrap();
        send(
            daemon,
            "olga",
            "s",
            "leave",
            &json!({"args": {"controller": "x"}, "at_step": LATER}),
        )
        .unwrap();
    };
    others(&daemon);
    // The places are those of the user also after a kill.
    let daemon = daemon.killed().await;
    let _tokens = hold(&daemon, names(&["cleo", "carl"])).await;
    until("cleo's commands are scheduled again", async || {
        daemon.http("GET /api/get/s/get/status", "olga", "").1["result"]["scheduled"] == 67
    })
    .await;
    let error = cleo(&daemon).unwrap_err();
    assert_eq!(error["details"]["limit"], 64, "{error}");
    others(&daemon);
    // The remedy of the error.
    send(&daemon, "olga", "s", "reset", &json!({})).unwrap();
    cleo(&daemon).unwrap();
    daemon.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_waits_of_a_viewer_compare_at_most_four_measures() {
    let daemon = AuthProcess::start(&[("vera", Role::Viewer), ("carl", Role::Controller)]).await;
    let [vera, carl, olga] = [
        daemon.open_session("vera").await,
        daemon.open_session("carl").await,
        daemon.open_session("olga").await,
    ];
    let wait = async |of: &UserSession, id: &str, measures: &[&str], secs: f64| {
        let alive = keys::wait_alive(PREFIX, "s", id);
        let token = of.session.liveliness().declare_token(alive).await.unwrap();
        let parts: Vec<String> = measures.iter().map(|it| format!("{it} > 1e9")).collect();
        let condition = parts.join(" or ");
        let noun = format!("wait?condition={condition};id={id};timeout_secs={secs}");
        let selector = keys::get(PREFIX, "s", &noun);
        let error = of.query_all(&selector, None).await.remove(0).unwrap_err();
        (error, token)
    };
    let waits = async |of: &UserSession, id: &str, measures: &[&str]| {
        let (error, token) = wait(of, id, measures, 0.1).await;
        assert_eq!(error.code, ErrorCode::DeadlineExceeded, "{id}: {error:?}");
        token
    };
    let rejected = async |id: &str, measures: &[&str]| {
        let (error, _token) = wait(&vera, id, measures, 20.0).await;
        assert_eq!(error.code, ErrorCode::ResourceExhausted, "{id}: {error:?}");
        assert!(error.message.contains("the waits of vera"), "{error:?}");
        assert_eq!(error.details["limit"], 4);
        assert_eq!(error.details["person"], "vera");
    };
    let five = ["msd(1)", "msd(2)", "clusters.count", "msd(3)", "msd(4)"];
    rejected("v0", &five).await;
    let _two = waits(&vera, "v1", &five[..2]).await;
    let _equal = waits(&vera, "v2", &[five[1], five[2]]).await;
    rejected("v3", &five[3..]).await;
    let _fourth = waits(&vera, "v4", &five[3..4]).await;
    // Each user has four of their own, and an operator is limited with all others alone.
    let _carl = waits(&carl, "c", &["order", "msd(6)", "msd(7)", "msd(8)"]).await;
    let _olga = waits(&olga, "o", &five).await;
    daemon.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_controller_schedules_takes_at_most_32_kib() {
    let daemon = AuthProcess::start(&PEOPLE).await;
    let _tokens = hold(&daemon, names(&["cleo"])).await;
    let note = |chars: usize| json!({"args": {"text": "\u{20ac}".repeat(chars)}, "at_step": LATER});
    let ids: Vec<u32> = (1..7000).collect();
    let mut long = join("cleo", Some(LATER));
    long["args"]["select"] = json!({"ids": ids});
    let assert_rejected = |verb, request| {
        let error = send(&daemon, "cleo", "s", verb, request).unwrap_err();
        assert_eq!(error["code"], "resource_exhausted", "{error}");
        let message = error["message"].as_str().unwrap();
        assert!(message.contains("of at most 32 KiB"), "{message}");
    };
    assert_rejected("join", &long);
    for _ in 0..10 {
        send(&daemon, "cleo", "s", "annotate", &note(1000)).unwrap();
    }
    assert_rejected("annotate", &note(1000));
    send(&daemon, "cleo", "s", "annotate", &note(500)).unwrap();
    send(&daemon, "olga", "s", "fork", &json!({"name": "copy"})).unwrap();
    daemon.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_user_with_many_controllers_leaves_places_for_those_of_others() {
    let daemon = AuthProcess::start(&PEOPLE).await;
    let many = ["cleo", "olga"].map(|user| (0..102).map(move |k| format!("{user}-{k}")));
    let all = many.into_iter().flatten().chain(names(&["carl", "olga"]));
    let _tokens = hold(&daemon, all).await;
    let cleo = |k: usize, at_step| {
        send(
            &daemon,
            "cleo",
            "s",
            "join",
            &join(&format!("cleo-{k}"), at_step),
        )
    };
    let mut accepted = 0;
    let error = loop {
        match cleo(accepted, None) {
            Ok(_) => accepted += 1,
            Err(error) => break error,
        }
    };
    assert_eq!(accepted, 64, "{error}");
    assert_eq!(error["code"], "resource_exhausted", "{error}");
    let message = error["message"].as_str().unwrap();
    assert!(
        message.starts_with("64 controllers of cleo have joined"),
        "{message}"
    );
    // One that has joined may rejoin.
    cleo(3, None).unwrap();
    for user in ["carl", "olga"] {
        send(&daemon, user, "s", "join", &join(user, None)).unwrap();
    }
    let leave = |k: usize| {
        let args = json!({"controller": format!("cleo-{k}")});
        send(&daemon, "cleo", "s", "leave", &args).unwrap();
    };
    // One that will join takes a place, too.
    leave(0);
    cleo(100, Some(LATER)).unwrap();
    assert!(cleo(101, None).is_err());
    assert!(cleo(101, Some(LATER)).is_err());
    leave(1);
    cleo(101, None).unwrap();
    // An operator may have as many as there are places.
    for k in 0..100 {
        send(
            &daemon,
            "olga",
            "s",
            "join",
            &join(&format!("olga-{k}"), None),
        )
        .unwrap();
    }
    daemon.end();
}

/// The request of a controller that joins now, padded: the journal and the events have arguments as they
/// were sent.
fn long_join(controller: &str) -> String {
    let padded = format!("{}\"again\"", " ".repeat(50_000));
    join(controller, None)
        .to_string()
        .replace("\"again\"", &padded)
}

#[tokio::test(flavor = "multi_thread")]
async fn joins_and_leaves_take_the_history_of_nobody() {
    let daemon = AuthProcess::start(&PEOPLE).await;
    let _tokens = hold(&daemon, names(&["cleo", "carl", "olga"])).await;
    let join_long = |user: &str, controller: &str| {
        daemon.http("POST /api/cmd/s/join", user, &long_join(controller))
    };
    // More bytes than the events of a swarm take.
    for _ in 0..10 {
        assert_eq!(join_long("cleo", "cleo").0, 200);
    }
    let events = created(&daemon, "s");
    assert_eq!(events.len(), 1, "{events:?}");
    assert_eq!(events[0]["event"]["client"], "olga");
    // A mebibyte at once.
    let mut accepted = 10;
    let error = loop {
        match join_long("cleo", "cleo") {
            (200, _) => accepted += 1,
            (_, error) => break error,
        }
        assert!(accepted < 500, "joins without a limit");
    };
    assert!(accepted >= 20, "{accepted}");
    assert_eq!(error["code"], "resource_exhausted", "{error}");
    let message = error["message"].as_str().unwrap();
    assert!(
        message.contains("more than 32 KiB of join a second"),
        "{message}"
    );
    let retry_secs = error["details"]["retry_secs"].as_f64().unwrap();
    assert!(retry_secs > 0.0 && retry_secs < 1.6, "{error}");
    // Others can join, and cleo can leave, and come back later.
    send(
        &daemon,
        "cleo",
        "s",
        "leave",
        &json!({"controller": "cleo"}),
    )
    .unwrap();
    send(&daemon, "carl", "s", "join", &join("carl", None)).unwrap();
    send(
        &daemon,
        "carl",
        "s",
        "leave",
        &json!({"controller": "carl"}),
    )
    .unwrap();
    until("cleo joins again", async || {
        join_long("cleo", "cleo").0 == 200
    })
    .await;
    // An operator is not limited.
    for _ in 0..30 {
        assert_eq!(join_long("olga", "olga").0, 200);
    }
    daemon.end();
}
