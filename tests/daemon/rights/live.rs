//! `jostled auth add` and `remove` beside a running daemon: they count within 5 s, in the same
//! epoch.

use std::fs::{self, File};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use futures_util::StreamExt;
use jostle_proto::{Credentials, ErrorCode, Role, keys};
use jostled::auth::folder::Folder;
use serde_json::{Value, json};
use tempfile::TempDir;
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::protocol::frame::coding::CloseCode;
use tokio_tungstenite::{WebSocketStream, client_async};
use zenoh::bytes::Encoding;

use super::secrets::http;
use super::{Proof, Visitor};
use crate::apart::{Process, jostled};
use crate::support::{NODE, PREFIX, until};

/// How soon a change counts.
const SOON: Duration = Duration::from_secs(5);

/// A daemon process that knows its people, with a swarm `s`, which olga created.
struct Lab {
    process: Process,
    folder: Folder,
    tls: String,
    http: String,
    base: TempDir,
}

impl Lab {
    async fn start(people: &[(&str, Role)]) -> Self {
        let base = tempfile::tempdir().unwrap();
        let folder = Folder::at(base.path().join("auth"));
        let people = people.iter().chain(&[("olga", Role::Operator)]);
        let people: Vec<_> = people
            .map(|(name, role)| format!("{name}={role}"))
            .collect();
        let mut init = jostled(&["auth", "init", "--auth-dir"]);
        let made = init.arg(folder.path()).args(people).output().unwrap();
        assert!(made.status.success(), "{made:?}");
        let [out, log] = ["out", "log"].map(|name| base.path().join(name));
        let mut command = jostled(&["serve", "--node", NODE]);
        command
            .args([
                "--listen",
                "tls/127.0.0.1:0",
                "--http",
                "127.0.0.1:0",
                "--auth-dir",
            ])
            .arg(folder.path())
            .arg("--data-dir")
            .arg(base.path().join("data"))
            .stdout(File::create(&out).unwrap())
            .stderr(File::create(log).unwrap());
        let process = Process::of(&mut command);
        let said = |what: &str| {
            let text = fs::read_to_string(&out).unwrap();
            let lines = text.lines().map(str::to_owned);
            let found = lines.filter(|line| text.ends_with('\n') && line.starts_with(what));
            found.map(|line| line[what.len()..].to_owned()).next()
        };
        until("it serves", async || said("http on ").is_some()).await;
        let http = said("http on http://").unwrap();
        let tls = said("listening on ").unwrap();
        let lab = Lab {
            process,
            folder,
            tls,
            http,
            base,
        };
        let spec = r#"{"name": "s", "spec": {"n": 3, "seed": 1}}"#;
        assert_eq!(lab.http("POST /api/node/create", "olga", spec).0, 200);
        lab
    }

    /// Runs `jostled auth`, and returns what it prints.
    fn auth(&self, arguments: &[&str]) -> String {
        let mut command = jostled(&["auth"]);
        command
            .args(arguments)
            .arg("--auth-dir")
            .arg(self.folder.path());
        let ended = command.output().unwrap();
        assert!(ended.status.success(), "{arguments:?}: {ended:?}");
        String::from_utf8(ended.stdout).unwrap()
    }

    fn token(&self, name: &str) -> String {
        self.folder.credentials(name).unwrap().token
    }

    fn http(&self, request: &str, name: &str, body: &str) -> (u16, Value) {
        http(&self.http, request, Some(&self.token(name)), body)
    }

    /// The status of a command that bears this token.
    fn command(&self, token: &str) -> u16 {
        let request = "POST /api/cmd/s/set";
        http(&self.http, request, Some(token), r#"{"pi3": 1.1}"#).0
    }

    fn epoch(&self) -> Value {
        let (_, status) = self.http("GET /api/get/s/get/status", "olga", "");
        status["epoch"].clone()
    }

    /// Whether `/healthz` reports that the people cannot be read.
    fn is_reported(&self) -> bool {
        let (_, health) = http(&self.http, "GET /healthz", None, "");
        let mut reasons = health["reasons"].as_array().unwrap().iter();
        reasons.any(|it| it["code"] == "people_unreadable")
    }

    async fn enter(&self, name: &str) -> Visitor {
        self.enter_with(name, &self.token(name)).await
    }

    /// A session of `name`'s, which sends `token`.
    async fn enter_with(&self, name: &str, token: &str) -> Visitor {
        Visitor {
            session: Proof::of(&self.folder, name).open(&self.tls).await.unwrap(),
            token: Some(token.to_owned()),
        }
    }

    /// A page's socket.
    async fn tab(&self, token: &str) -> WebSocketStream<TcpStream> {
        let request = format!("ws://{}/api/ws", self.http);
        let mut request = request.into_client_request().unwrap();
        let headers = request.headers_mut();
        headers.insert("origin", format!("http://{}", self.http).parse().unwrap());
        let protocols = format!("jostle, token.{token}").parse().unwrap();
        headers.insert("sec-websocket-protocol", protocols);
        let stream = TcpStream::connect(&self.http).await.unwrap();
        client_async(request, stream).await.unwrap().0
    }

    /// What a person opens sessions with, from a copy of their folder.
    fn kept(&self, name: &str) -> Proof {
        let copy = self.base.path().join("kept");
        fs::create_dir(&copy).unwrap();
        for entry in fs::read_dir(self.folder.of(name)).unwrap() {
            let entry = entry.unwrap();
            fs::copy(entry.path(), copy.join(entry.file_name())).unwrap();
        }
        let [authority, certificate, key] = Credentials::CERTIFICATES.map(|it| copy.join(it));
        Proof {
            user: Some((
                name.to_owned(),
                self.folder.credentials(name).unwrap().password,
            )),
            authority,
            certificate: Some([certificate, key]),
        }
    }

    fn end(mut self) {
        self.process.signal("-TERM");
        assert_eq!(self.process.end().0, Some(0));
    }
}

/// Waits until it holds, at most as long as a change may take to count.
async fn soon(what: &str, mut holds: impl AsyncFnMut() -> bool) {
    let began = Instant::now();
    while !holds().await {
        assert!(began.elapsed() < SOON, "{what}: not within {SOON:?}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    println!("{what}: {:?}", began.elapsed());
}

/// Reads until the socket ends; the code it was closed with, if it was.
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
    let lab = Lab::start(&[("vera", Role::Viewer)]).await;
    let epoch = lab.epoch();
    let told = lab.auth(&["add", "nora=operator"]);
    assert!(told.contains("within 5 s"), "{told}");
    assert!(
        told.contains("zenoh sessions") && told.contains("restart"),
        "{told}"
    );
    let token = lab.token("nora");
    soon("a command by nora", async || lab.command(&token) == 200).await;
    let (_, hello) = lab.http("GET /api/hello", "nora", "");
    assert_eq!(
        (&hello["person"], &hello["may_command"]),
        (&json!("nora"), &json!(true))
    );
    // Over the session of somebody who was there at the start the daemon accepts it, too.
    let lent = lab.enter_with("olga", &token).await;
    lent.cmd("s", "step", json!({"steps": 1})).await;
    let whoami = lent.ok(&keys::node_get(PREFIX, NODE, "whoami"), None).await;
    assert_eq!(whoami["result"]["person"], "nora");
    // zenoh has read the passwords at the start.
    assert!(Proof::of(&lab.folder, "nora").open(&lab.tls).await.is_err());
    let journal = lent.ok(&keys::get(PREFIX, "s", "journal"), None).await;
    let entries = journal["result"]["entries"].as_array().unwrap();
    assert_eq!(entries.last().unwrap()["client"], "nora");
    assert_eq!(lab.epoch(), epoch);
    lent.session.close().await.unwrap();
    lab.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_removed_person_is_refused_whatever_connection_they_use() {
    let lab = Lab::start(&[("otto", Role::Operator), ("vera", Role::Viewer)]).await;
    let epoch = lab.epoch();
    let (otto, vera) = (lab.token("otto"), lab.token("vera"));
    let proof = lab.kept("otto");
    let visitor = lab.enter("otto").await;
    visitor.cmd("s", "step", json!({"steps": 1})).await;
    let (mut tab, mut others) = (lab.tab(&otto).await, lab.tab(&vera).await);
    // A client that never reads: the daemon must not wait for it when it closes the socket.
    let _unread = lab.tab(&otto).await;
    assert!(tab.next().await.unwrap().is_ok() && others.next().await.unwrap().is_ok());

    let told = lab.auth(&["remove", "otto"]);
    assert!(
        told.contains("within 5 s") && told.contains("still reads"),
        "{told}"
    );
    let removed = Instant::now();
    let ended = tokio::time::timeout(SOON, end_of(&mut tab)).await;
    assert_eq!(
        ended.expect("the socket is closed"),
        Some(CloseCode::Policy)
    );
    soon("a command by otto", async || lab.command(&otto) == 401).await;
    for request in [
        "GET /api/get/s/get/status",
        "GET /metrics",
        "POST /api/cmd/s/delete",
    ] {
        assert_eq!(
            http(&lab.http, request, Some(&otto), "").0,
            401,
            "{request}"
        );
    }
    // The session is open still, and one that is opened with the old folder is, too.
    let again = Visitor {
        session: proof.open(&lab.tls).await.unwrap(),
        token: Some(otto.clone()),
    };
    for visitor in [&visitor, &again] {
        for key in [
            keys::cmd(PREFIX, "s", "step"),
            keys::node_cmd(PREFIX, NODE, "create"),
        ] {
            let answers = visitor.ask(&key, Some(&json!({}))).await;
            let [Err(error)] = &answers[..] else {
                panic!("{key}: {answers:?}");
            };
            assert_eq!(error.code, ErrorCode::PermissionDenied, "{error:?}");
        }
        // As docs/security.md says it still reads.
        visitor.ok(&keys::get(PREFIX, "s", "status"), None).await;
    }
    assert!(removed.elapsed() < 2 * SOON);
    // Other people are not affected.
    let (_, before) = lab.http("GET /api/get/s/get/status", "olga", "");
    assert_eq!(lab.http("POST /api/cmd/s/step", "olga", "{}").0, 200);
    let (_, after) = lab.http("GET /api/get/s/get/status", "olga", "");
    assert_eq!(
        before["step"].as_u64().unwrap() + 1,
        after["step"].as_u64().unwrap()
    );
    assert_eq!((&after["epoch"], lab.epoch()), (&epoch, epoch.clone()));
    let quiet = tokio::time::timeout(Duration::from_millis(200), end_of(&mut others)).await;
    assert!(quiet.is_err(), "vera's socket was closed");
    assert!(!lab.is_reported());
    for visitor in [visitor, again] {
        visitor.session.close().await.unwrap();
    }
    lab.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn set_points_that_a_removed_person_could_have_sent_take_a_token() {
    let people = [
        ("cleo", Role::Controller),
        ("carl", Role::Controller),
        ("otto", Role::Operator),
    ];
    let lab = Lab::start(&people).await;
    let (cleo, carl) = (lab.enter("cleo").await, lab.enter("carl").await);
    let (otto, olga) = (lab.enter("otto").await, lab.enter("olga").await);
    for (name, who, id) in [("cleo", &cleo, 0), ("carl", &carl, 1)] {
        let join = json!({"controller": name, "select": {"ids": [id]}, "mode": "free_running",
            "deadline_secs": 60.0});
        who.cmd("s", "join", join).await;
    }
    olga.cmd("s", "run", json!({"rate": 1.0})).await;
    // How many set-points were accepted, and how many rejected.
    let counts = async |name: &str| {
        let told = olga.ok(&keys::get(PREFIX, "s", "controllers"), None).await;
        let controllers = told["result"]["controllers"].as_array().unwrap().clone();
        let found = controllers.into_iter().find(|it| it["controller"] == name);
        let puts = found.unwrap()["puts"].clone();
        let count = |field: &str| puts[field].as_u64().unwrap();
        [
            count("applied") + count("overtaken") + count("stale"),
            count("refused"),
        ]
    };
    let mut sequence = 0;
    let mut put = async |from: &Visitor, name: &str, id: u32, token: Option<&str>| {
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
                began.elapsed() < SOON,
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

    // A controller is removed: their own set-points are rejected, and nobody else's.
    let gone = lab.token("carl");
    lab.auth(&["remove", "carl"]);
    soon("carl's token", async || lab.command(&gone) == 401).await;
    put(&carl, "carl", 1, None).await;
    expect("carl", [0, 1]).await;
    put(&carl, "carl", 1, Some(&gone)).await;
    expect("carl", [0, 2]).await;
    put(&cleo, "cleo", 0, None).await;
    expect("cleo", [2, 1]).await;

    // Adding a person does not restore the rights of one who was removed.
    lab.auth(&["add", "dora=viewer"]);
    let added = lab.token("dora");
    soon("dora's token", async || lab.command(&added) == 403).await;
    put(&carl, "carl", 1, None).await;
    expect("carl", [0, 3]).await;

    // An operator is removed, whose session may put anybody's: a token tells who it is.
    let gone = lab.token("otto");
    lab.auth(&["remove", "otto"]);
    soon("otto's token", async || lab.command(&gone) == 401).await;
    put(&otto, "cleo", 0, None).await;
    expect("cleo", [2, 2]).await;
    put(&otto, "cleo", 0, Some(&gone)).await;
    expect("cleo", [2, 3]).await;
    put(&cleo, "cleo", 0, None).await;
    expect("cleo", [2, 4]).await;
    put(&cleo, "cleo", 0, Some(&lab.token("cleo"))).await;
    expect("cleo", [3, 4]).await;
    put(&olga, "cleo", 0, Some(&lab.token("olga"))).await;
    expect("cleo", [4, 4]).await;
    for visitor in [cleo, carl, otto, olga] {
        visitor.session.close().await.unwrap();
    }
    lab.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_people_file_keeps_the_rights_and_is_reported() {
    let lab = Lab::start(&[("vera", Role::Viewer)]).await;
    let (path, epoch) = (lab.folder.people_file(), lab.epoch());
    let whole = fs::read_to_string(&path).unwrap();
    let (vera, olga) = (lab.token("vera"), lab.token("olga"));
    let doubled = {
        let mut people: Value = serde_json::from_str(&whole).unwrap();
        let first = people["people"][0].clone();
        people["people"].as_array_mut().unwrap().push(first);
        people.to_string()
    };
    let replace = |text: &str| {
        let aside = lab.base.path().join("aside");
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
        soon(what, async || lab.is_reported()).await;
        assert_eq!(lab.command(&olga), 200, "{what}");
        assert_eq!(
            http(&lab.http, "GET /api/get/s/get/status", Some(&vera), "").0,
            200
        );
        replace(&whole);
        set_mode(&path, 0o600);
        soon("whole again", async || !lab.is_reported()).await;
    }
    // A partial new file, left by a process that was killed before the rename.
    fs::write(path.with_extension("json.new"), &whole[..9]).unwrap();
    lab.auth(&["remove", "vera"]);
    let status = async || http(&lab.http, "GET /api/get/s/get/status", Some(&vera), "").0;
    soon("vera", async || status().await == 401).await;
    // The last person may be removed too: an empty list is valid.
    lab.auth(&["remove", "olga"]);
    soon("olga", async || lab.command(&olga) == 401).await;
    assert!(!lab.is_reported());
    let log = fs::read_to_string(lab.base.path().join("log")).unwrap();
    let reports = log.matches("failed to reload the users").count();
    assert!((6..=12).contains(&reports), "{reports}: {log}");
    for secret in [&vera, &olga] {
        assert!(!log.contains(secret.as_str()));
    }
    lab.auth(&["add", "olga=operator"]);
    soon("olga again", async || {
        lab.command(&lab.token("olga")) == 200
    })
    .await;
    assert_eq!(lab.epoch(), epoch);
    lab.end();
}

fn set_mode(path: &PathBuf, mode: u32) {
    use std::os::unix::fs::PermissionsExt;
    fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn who_is_removed_and_added_again_has_the_new_secret_and_role_alone() {
    let lab = Lab::start(&[("otto", Role::Operator)]).await;
    let epoch = lab.epoch();
    let (old, session) = (lab.token("otto"), lab.enter("otto").await);
    let mut tab = lab.tab(&old).await;
    // At once, so that the daemon may see both changes as one.
    lab.auth(&["remove", "otto"]);
    lab.auth(&["add", "otto=operator"]);
    let new = lab.token("otto");
    assert_ne!(old, new);
    soon("the old secret", async || lab.command(&old) == 401).await;
    soon("the new secret", async || lab.command(&new) == 200).await;
    let ended = tokio::time::timeout(SOON, end_of(&mut tab)).await;
    assert_eq!(
        ended.expect("the socket is closed"),
        Some(CloseCode::Policy)
    );
    let answers = session
        .ask(&keys::cmd(PREFIX, "s", "pause"), Some(&json!({})))
        .await;
    assert_eq!(
        answers[0].as_ref().unwrap_err().code,
        ErrorCode::PermissionDenied
    );
    // Another role, too.
    lab.auth(&["remove", "otto"]);
    lab.auth(&["add", "otto=viewer"]);
    let viewer = lab.token("otto");
    soon("the operator's secret", async || lab.command(&new) == 401).await;
    soon("the viewer's secret", async || lab.command(&viewer) == 403).await;
    assert_eq!(
        http(&lab.http, "GET /api/get/s/get/status", Some(&viewer), "").0,
        200
    );
    assert_eq!(lab.epoch(), epoch);
    session.session.close().await.unwrap();
    lab.end();
}

/// Twenty people come and go while others work.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn people_who_stay_are_never_refused_while_others_come_and_go() {
    let lab = Lab::start(&[("vera", Role::Viewer)]).await;
    let epoch = lab.epoch();
    let olga = lab.enter("olga").await;
    let (stop, requests) = (AtomicBool::new(false), AtomicUsize::new(0));
    let mut tab = lab.tab(&lab.token("vera")).await;
    std::thread::scope(|scope| {
        for name in ["olga", "vera"] {
            let (lab, stop, requests) = (&lab, &stop, &requests);
            scope.spawn(move || {
                let token = lab.token(name);
                while !stop.load(Ordering::Relaxed) {
                    let get = "GET /api/get/s/get/status";
                    let (status, answer) = http(&lab.http, get, Some(&token), "");
                    assert_eq!(status, 200, "{name}: {answer}");
                    if name == "olga" {
                        assert_eq!(lab.command(&token), 200);
                    }
                    requests.fetch_add(1, Ordering::Relaxed);
                }
            });
        }
        let ending = Ending(&stop);
        let mut tokens = Vec::new();
        for number in 0..20 {
            let name = format!("guest_{number}");
            lab.auth(&["add", &format!("{name}=operator")]);
            let token = lab.token(&name);
            // Every other one is removed before the daemon may have seen them.
            if number % 2 == 0 {
                wait_for(&name, || lab.command(&token) == 200);
            }
            lab.auth(&["remove", &name]);
            tokens.push(token);
            if number % 4 == 0 {
                wait_for(&name, || lab.command(tokens.last().unwrap()) == 401);
            }
        }
        for token in &tokens {
            wait_for("all are gone", || lab.command(token) == 401);
        }
        drop(ending);
    });
    println!("{} requests", requests.load(Ordering::Relaxed));
    assert!(requests.load(Ordering::Relaxed) > 20);
    assert_eq!(lab.epoch(), epoch);
    olga.cmd("s", "step", json!({"steps": 1})).await;
    let quiet = tokio::time::timeout(Duration::from_millis(200), end_of(&mut tab)).await;
    assert!(quiet.is_err(), "vera's socket was closed");
    let journal = olga.ok(&keys::get(PREFIX, "s", "journal"), None).await;
    for entry in journal["result"]["entries"].as_array().unwrap() {
        let client = entry["client"].as_str().unwrap();
        assert!(client == "olga" || client.starts_with("guest_"), "{entry}");
    }
    assert!(!lab.is_reported());
    olga.session.close().await.unwrap();
    lab.end();
}

/// Ends the others' work, also when an assertion fails.
struct Ending<'a>(&'a AtomicBool);

impl Drop for Ending<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

fn wait_for(what: &str, mut holds: impl FnMut() -> bool) {
    let began = Instant::now();
    while !holds() {
        assert!(began.elapsed() < SOON, "{what}: not within {SOON:?}");
        std::thread::sleep(Duration::from_millis(20));
    }
}
