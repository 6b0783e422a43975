//! `jostled auth add` and `remove` beside a running daemon: they apply within 5 s, in the same
//! epoch.

pub(super) mod process;

use std::fs;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use futures_util::StreamExt;
use jostle_proto::{ErrorCode, Role, keys};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::protocol::frame::coding::CloseCode;
use zenoh::bytes::Encoding;

use super::secrets::http;
use super::{SessionCredentials, UserSession};
use crate::support::{NODE, PREFIX};

use process::{AuthProcess, SHORT_TIMEOUT, until_short};

/// Reads until the socket is closed. Returns the code, if there is one.
async fn end_of(tab: &mut WebSocketStream<TcpStream>) -> Option<CloseCode> {
    loop {
        match tab.next().await {
            Some(Ok(Message::Close(frame))) => return frame.map(|frame| frame.code),
            Some(Ok(_)) => {}
            Some(Err(_)) | None => return None,
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_token_of_an_added_person_is_accepted_without_a_restart() {
    let daemon = AuthProcess::start(&[("vera", Role::Viewer)]).await;
    let epoch = daemon.epoch();
    let output = daemon.auth(&["add", "nora=operator"]);
    assert!(output.contains("within 5 s"), "{output}");
    assert!(
        output.contains("zenoh sessions") && output.contains("restart"),
        "{output}"
    );
    let token = daemon.token("nora");
    until_short("a command by nora", async || daemon.command(&token) == 200).await;
    let (_, hello) = daemon.http("GET /api/hello", "nora", "");
    assert_eq!(
        (&hello["person"], &hello["may_command"]),
        (&json!("nora"), &json!(true))
    );
    // The daemon also accepts the token over the session of a person from the start.
    let lent = daemon.open_session_with("olga", &token).await;
    lent.cmd("s", "step", json!({"steps": 1})).await;
    let whoami = lent.ok(&keys::node_get(PREFIX, NODE, "whoami"), None).await;
    assert_eq!(whoami["result"]["person"], "nora");
    // zenoh reads the passwords only at the start.
    assert!(
        SessionCredentials::of(&daemon.folder, "nora")
            .open(&daemon.tls)
            .await
            .is_err()
    );
    let journal = lent.ok(&keys::get(PREFIX, "s", "journal"), None).await;
    let entries = journal["result"]["entries"].as_array().unwrap();
    assert_eq!(entries.last().unwrap()["client"], "nora");
    assert_eq!(daemon.epoch(), epoch);
    lent.session.close().await.unwrap();
    daemon.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_removed_person_is_rejected_whatever_connection_they_use() {
    let daemon = AuthProcess::start(&[("otto", Role::Operator), ("vera", Role::Viewer)]).await;
    let epoch = daemon.epoch();
    let (otto, vera) = (daemon.token("otto"), daemon.token("vera"));
    let credentials = daemon.copied_credentials("otto");
    let user = daemon.open_session("otto").await;
    user.cmd("s", "step", json!({"steps": 1})).await;
    let (mut tab, mut others) = (daemon.tab(&otto).await, daemon.tab(&vera).await);
    // A client that never reads: the daemon must not wait for it when it closes the socket.
    let _unread = daemon.tab(&otto).await;
    assert!(tab.next().await.unwrap().is_ok() && others.next().await.unwrap().is_ok());

    let output = daemon.auth(&["remove", "otto"]);
    assert!(
        output.contains("within 5 s") && output.contains("still reads"),
        "{output}"
    );
    let removed = Instant::now();
    let ended = tokio::time::timeout(SHORT_TIMEOUT, end_of(&mut tab)).await;
    assert_eq!(
        ended.expect("the socket is closed"),
        Some(CloseCode::Policy)
    );
    until_short("a command by otto", async || daemon.command(&otto) == 401).await;
    for request in [
        "GET /api/get/s/get/status",
        "GET /metrics",
        "POST /api/cmd/s/delete",
    ] {
        assert_eq!(
            http(&daemon.http, request, Some(&otto), "").0,
            401,
            "{request}"
        );
    }
    // The session is still open, and one can be opened with the old folder.
    let again = UserSession {
        session: credentials.open(&daemon.tls).await.unwrap(),
        token: Some(otto.clone()),
    };
    for user in [&user, &again] {
        for key in [
            keys::cmd(PREFIX, "s", "step"),
            keys::node_cmd(PREFIX, NODE, "create"),
        ] {
            let answers = user.query_all(&key, Some(&json!({}))).await;
            let [Err(error)] = &answers[..] else {
                panic!("{key}: {answers:?}");
            };
            assert_eq!(error.code, ErrorCode::PermissionDenied, "{error:?}");
        }
        // It can still read, as docs/security.md describes.
        user.ok(&keys::get(PREFIX, "s", "status"), None).await;
    }
    assert!(removed.elapsed() < 2 * SHORT_TIMEOUT);
    // Other people are not affected.
    let (_, before) = daemon.http("GET /api/get/s/get/status", "olga", "");
    assert_eq!(daemon.http("POST /api/cmd/s/step", "olga", "{}").0, 200);
    let (_, after) = daemon.http("GET /api/get/s/get/status", "olga", "");
    assert_eq!(
        before["step"].as_u64().unwrap() + 1,
        after["step"].as_u64().unwrap()
    );
    assert_eq!((&after["epoch"], daemon.epoch()), (&epoch, epoch.clone()));
    let quiet = tokio::time::timeout(Duration::from_millis(200), end_of(&mut others)).await;
    assert!(quiet.is_err(), "vera's socket was closed");
    assert!(!daemon.is_reported());
    for user in [user, again] {
        user.session.close().await.unwrap();
    }
    daemon.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn set_points_that_a_removed_person_could_have_sent_take_a_token() {
    let people = [
        ("cleo", Role::Controller),
        ("carl", Role::Controller),
        ("otto", Role::Operator),
    ];
    let daemon = AuthProcess::start(&people).await;
    let (cleo, carl) = (
        daemon.open_session("cleo").await,
        daemon.open_session("carl").await,
    );
    let (otto, olga) = (
        daemon.open_session("otto").await,
        daemon.open_session("olga").await,
    );
    for (name, who, id) in [("cleo", &cleo, 0), ("carl", &carl, 1)] {
        let join = json!({"controller": name, "select": {"ids": [id]}, "mode": "free_running",
            "deadline_secs": 60.0});
        who.cmd("s", "join", join).await;
    }
    olga.cmd("s", "run", json!({"rate": 1.0})).await;
    // How many set-points were accepted, and how many rejected.
    let counts = async |name: &str| {
        let reply = olga.ok(&keys::get(PREFIX, "s", "controllers"), None).await;
        let controllers = reply["result"]["controllers"].as_array().unwrap().clone();
        let found = controllers.into_iter().find(|it| it["controller"] == name);
        let puts = found.unwrap()["puts"].clone();
        let count = |field: &str| puts[field].as_u64().unwrap();
        [
            count("applied") + count("overtaken") + count("stale"),
            count("refused"),
        ]
    };
    let mut sequence = 0;
    let mut put = async |from: &UserSession, name: &str, id: u32, token: Option<&str>| {
        sequence += 1;
        let set = json!({"ids": [id], "direction": [0.5], "weight": [1.0]});
        let payload = json!({"sequence": sequence, "set": set}).to_string();
        let mut put = from.session.put(keys::ctl(PREFIX, "s", name), payload);
        if let Some(token) = token {
            put = put.attachment(token);
        }
        put.encoding(Encoding::APPLICATION_JSON).await.unwrap();
    };
    let expect = async |name: &str, expected: [u64; 2]| {
        let mut last = [0, 0];
        let began = Instant::now();
        while last != expected {
            assert!(
                began.elapsed() < SHORT_TIMEOUT,
                "{name}: {last:?} and not {expected:?}"
            );
            tokio::time::sleep(Duration::from_millis(20)).await;
            last = counts(name).await;
        }
    };
    put(&cleo, "cleo", 0, None).await;
    expect("cleo", [1, 0]).await;
    put(&cleo, "cleo", 0, Some("nobody's")).await;
    expect("cleo", [1, 1]).await;

    // A controller is removed: only the set-points of this person are rejected.
    let gone = daemon.token("carl");
    daemon.auth(&["remove", "carl"]);
    until_short("carl's token", async || daemon.command(&gone) == 401).await;
    put(&carl, "carl", 1, None).await;
    expect("carl", [0, 1]).await;
    put(&carl, "carl", 1, Some(&gone)).await;
    expect("carl", [0, 2]).await;
    put(&cleo, "cleo", 0, None).await;
    expect("cleo", [2, 1]).await;

    // Adding a person does not restore the rights of one who was removed.
    daemon.auth(&["add", "dora=viewer"]);
    let added = daemon.token("dora");
    until_short("dora's token", async || daemon.command(&added) == 403).await;
    put(&carl, "carl", 1, None).await;
    expect("carl", [0, 3]).await;

    // An operator is removed, who may put for every controller: now a token is required.
    let gone = daemon.token("otto");
    daemon.auth(&["remove", "otto"]);
    until_short("otto's token", async || daemon.command(&gone) == 401).await;
    put(&otto, "cleo", 0, None).await;
    expect("cleo", [2, 2]).await;
    put(&otto, "cleo", 0, Some(&gone)).await;
    expect("cleo", [2, 3]).await;
    put(&cleo, "cleo", 0, None).await;
    expect("cleo", [2, 4]).await;
    put(&cleo, "cleo", 0, Some(&daemon.token("cleo"))).await;
    expect("cleo", [3, 4]).await;
    put(&olga, "cleo", 0, Some(&daemon.token("olga"))).await;
    expect("cleo", [4, 4]).await;
    for user in [cleo, carl, otto, olga] {
        user.session.close().await.unwrap();
    }
    daemon.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_people_file_keeps_the_rights_and_is_reported() {
    let daemon = AuthProcess::start(&[("vera", Role::Viewer)]).await;
    let (path, epoch) = (daemon.folder.people_file(), daemon.epoch());
    let whole = fs::read_to_string(&path).unwrap();
    let (vera, olga) = (daemon.token("vera"), daemon.token("olga"));
    let doubled = {
        let mut people: Value = serde_json::from_str(&whole).unwrap();
        let first = people["people"][0].clone();
        people["people"].as_array_mut().unwrap().push(first);
        people.to_string()
    };
    let replace = |text: &str| {
        let aside = daemon.base.path().join("aside");
        fs::write(&aside, text).unwrap();
        fs::rename(aside, &path).unwrap();
    };
    type Damage<'a> = (&'a str, Box<dyn Fn() + 'a>);
    let damages: [Damage<'_>; 6] = [
        ("empty", Box::new(|| fs::write(&path, "").unwrap())),
        (
            "cut off",
            Box::new(|| fs::write(&path, &whole[..whole.len() / 2]).unwrap()),
        ),
        ("two of one token", Box::new(|| replace(&doubled))),
        (
            "no text",
            Box::new(|| fs::write(&path, [0xff; 64]).unwrap()),
        ),
        ("gone", Box::new(|| fs::remove_file(&path).unwrap())),
        (
            "others may write",
            Box::new(|| {
                replace(&whole);
                set_mode(&path, 0o666);
            }),
        ),
    ];
    for (what, damage) in damages {
        damage();
        until_short(what, async || daemon.is_reported()).await;
        assert_eq!(daemon.command(&olga), 200, "{what}");
        assert_eq!(
            http(&daemon.http, "GET /api/get/s/get/status", Some(&vera), "").0,
            200
        );
        replace(&whole);
        set_mode(&path, 0o600);
        until_short("whole again", async || !daemon.is_reported()).await;
    }
    // A partial new file, left by a process that was killed before the rename.
    fs::write(path.with_extension("json.new"), &whole[..9]).unwrap();
    daemon.auth(&["remove", "vera"]);
    let status = async || http(&daemon.http, "GET /api/get/s/get/status", Some(&vera), "").0;
    until_short("vera", async || status().await == 401).await;
    // The last person may be removed too: an empty list is valid.
    daemon.auth(&["remove", "olga"]);
    until_short("olga", async || daemon.command(&olga) == 401).await;
    assert!(!daemon.is_reported());
    let log = fs::read_to_string(daemon.base.path().join("log")).unwrap();
    let reports = log.matches("failed to reload the users").count();
    assert!((6..=12).contains(&reports), "{reports}: {log}");
    for secret in [&vera, &olga] {
        assert!(!log.contains(secret.as_str()));
    }
    daemon.auth(&["add", "olga=operator"]);
    until_short("olga again", async || {
        daemon.command(&daemon.token("olga")) == 200
    })
    .await;
    assert_eq!(daemon.epoch(), epoch);
    daemon.end();
}

fn set_mode(path: &PathBuf, mode: u32) {
    use std::os::unix::fs::PermissionsExt;
    fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_person_added_again_has_only_the_new_secret_and_role() {
    let daemon = AuthProcess::start(&[("otto", Role::Operator)]).await;
    let epoch = daemon.epoch();
    let (old, session) = (daemon.token("otto"), daemon.open_session("otto").await);
    let mut tab = daemon.tab(&old).await;
    // Both at once, so that the daemon may read them as one change.
    daemon.auth(&["remove", "otto"]);
    daemon.auth(&["add", "otto=operator"]);
    let new = daemon.token("otto");
    assert_ne!(old, new);
    until_short("the old secret", async || daemon.command(&old) == 401).await;
    until_short("the new secret", async || daemon.command(&new) == 200).await;
    let ended = tokio::time::timeout(SHORT_TIMEOUT, end_of(&mut tab)).await;
    assert_eq!(
        ended.expect("the socket is closed"),
        Some(CloseCode::Policy)
    );
    let answers = session
        .query_all(&keys::cmd(PREFIX, "s", "pause"), Some(&json!({})))
        .await;
    assert_eq!(
        answers[0].as_ref().unwrap_err().code,
        ErrorCode::PermissionDenied
    );
    // With another role, too.
    daemon.auth(&["remove", "otto"]);
    daemon.auth(&["add", "otto=viewer"]);
    let viewer = daemon.token("otto");
    until_short("the operator's secret", async || {
        daemon.command(&new) == 401
    })
    .await;
    until_short("the viewer's secret", async || {
        daemon.command(&viewer) == 403
    })
    .await;
    assert_eq!(
        http(&daemon.http, "GET /api/get/s/get/status", Some(&viewer), "").0,
        200
    );
    assert_eq!(daemon.epoch(), epoch);
    session.session.close().await.unwrap();
    daemon.end();
}

/// Twenty people are added and removed while others send requests.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn people_who_stay_are_never_rejected_while_others_come_and_go() {
    let daemon = AuthProcess::start(&[("vera", Role::Viewer)]).await;
    let epoch = daemon.epoch();
    let olga = daemon.open_session("olga").await;
    let (stop, requests) = (AtomicBool::new(false), AtomicUsize::new(0));
    let mut tab = daemon.tab(&daemon.token("vera")).await;
    std::thread::scope(|scope| {
        for name in ["olga", "vera"] {
            let (daemon, stop, requests) = (&daemon, &stop, &requests);
            scope.spawn(move || {
                let token = daemon.token(name);
                while !stop.load(Ordering::Relaxed) {
                    let get = "GET /api/get/s/get/status";
                    let (status, answer) = http(&daemon.http, get, Some(&token), "");
                    assert_eq!(status, 200, "{name}: {answer}");
                    if name == "olga" {
                        assert_eq!(daemon.command(&token), 200);
                    }
                    requests.fetch_add(1, Ordering::Relaxed);
                }
            });
        }
        let ending = Ending(&stop);
        let mut tokens = Vec::new();
        for number in 0..20 {
            let name = format!("guest_{number}");
            daemon.auth(&["add", &format!("{name}=operator")]);
            let token = daemon.token(&name);
            // Every other one is removed before the daemon may have read the list.
            if number % 2 == 0 {
                wait_for(&name, || daemon.command(&token) == 200);
            }
            daemon.auth(&["remove", &name]);
            tokens.push(token);
            if number % 4 == 0 {
                wait_for(&name, || daemon.command(tokens.last().unwrap()) == 401);
            }
        }
        for token in &tokens {
            wait_for("all are gone", || daemon.command(token) == 401);
        }
        drop(ending);
    });
    println!("{} requests", requests.load(Ordering::Relaxed));
    assert!(requests.load(Ordering::Relaxed) > 20);
    assert_eq!(daemon.epoch(), epoch);
    olga.cmd("s", "step", json!({"steps": 1})).await;
    let quiet = tokio::time::timeout(Duration::from_millis(200), end_of(&mut tab)).await;
    assert!(quiet.is_err(), "vera's socket was closed");
    let journal = olga.ok(&keys::get(PREFIX, "s", "journal"), None).await;
    for entry in journal["result"]["entries"].as_array().unwrap() {
        let client = entry["client"].as_str().unwrap();
        assert!(client == "olga" || client.starts_with("guest_"), "{entry}");
    }
    assert!(!daemon.is_reported());
    olga.session.close().await.unwrap();
    daemon.end();
}

/// Stops the other threads, also when an assertion fails.
struct Ending<'a>(&'a AtomicBool);

impl Drop for Ending<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

fn wait_for(what: &str, mut holds: impl FnMut() -> bool) {
    let began = Instant::now();
    while !holds() {
        assert!(
            began.elapsed() < SHORT_TIMEOUT,
            "{what}: not within {SHORT_TIMEOUT:?}"
        );
        std::thread::sleep(Duration::from_millis(20));
    }
}
