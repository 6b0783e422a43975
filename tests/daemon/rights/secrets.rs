//! No secret is in any log or reply, and the permissions over HTTP.

use std::fs::{self, File};
use std::process::Command;

use futures_util::StreamExt;
use jostle_proto::{Credentials, keys};
use jostled::auth::folder::Folder;
use jostled::auth::issue;
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_tungstenite::client_async;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;

use super::{AuthDaemon, PEOPLE, SessionCredentials, UserSession};
use crate::harness::free_ports;
use crate::support::http::{health, send};
use crate::support::process::{Process, jostled};
use crate::support::tls::https;
use crate::support::{NODE, PREFIX, until};

/// Sends a request over HTTP with a token, or without.
pub fn http(address: &str, request: &str, token: Option<&str>, body: &str) -> (u16, Value) {
    let token = token.map(|token| format!("Authorization: Bearer {token}\r\n"));
    let (status, _, body) = send(
        address,
        &format!(
            "{request} HTTP/1.1\r\nHost: {address}\r\nOrigin: http://{address}\r\n\
             Connection: close\r\n{}Content-Length: {}\r\n\r\n{body}",
            token.unwrap_or_default(),
            body.len()
        ),
    );
    (status, serde_json::from_str(&body).unwrap_or_default())
}

/// Opens a tab's socket with a token. Returns whether it is accepted.
async fn tab(address: &str, token: Option<&str>) -> bool {
    let mut request = format!("ws://{address}/api/ws")
        .into_client_request()
        .unwrap();
    let headers = request.headers_mut();
    headers.insert("origin", format!("http://{address}").parse().unwrap());
    if let Some(token) = token {
        let protocols = format!("jostle, token.{token}").parse().unwrap();
        headers.insert("sec-websocket-protocol", protocols);
    }
    let stream = TcpStream::connect(address).await.unwrap();
    match client_async(request, stream).await {
        Ok((mut tab, _)) => tab.next().await.unwrap().is_ok(),
        Err(_) => false,
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn over_http_each_person_uses_their_own_token() {
    let daemon = AuthDaemon::start().await;
    let address = daemon.server.http().unwrap().to_string();
    assert_eq!(daemon.server.page(), None);
    let tokens = ["vera", "cleo", "olga"].map(|name| daemon.credentials(name).token);
    let [vera, cleo, olga] = tokens.each_ref().map(|token| Some(token.as_str()));
    let unknown = [None, Some("0123456789abcdef0123456789abcdef"), Some("")];
    let spec = r#"{"name": "s", "spec": {"n": 3}}"#;
    let steps = r#"{"steps": 2}"#;

    for (token, status) in [(vera, 403), (cleo, 403), (olga, 200)] {
        let (actual, answer) = http(&address, "POST /api/node/create", token, spec);
        assert_eq!(actual, status, "{answer}");
    }
    for (token, status) in [(vera, 403), (cleo, 403), (olga, 200)] {
        let (actual, answer) = http(&address, "POST /api/cmd/s/step", token, steps);
        assert_eq!(actual, status, "{answer}");
    }
    for token in unknown {
        for request in [
            "POST /api/node/create",
            "POST /api/cmd/s/delete",
            "GET /api/get/s/get/status",
            "GET /api/get/s/state",
            "GET /metrics",
        ] {
            let body = if request.starts_with("POST") {
                "{}"
            } else {
                ""
            };
            let (status, answer) = http(&address, request, token, body);
            assert_eq!(
                (status, &answer["code"]),
                (401, &json!("permission_denied")),
                "{request}"
            );
        }
        assert!(!tab(&address, token).await);
        let (_, hello) = http(&address, "GET /api/hello", token, "");
        assert_eq!(
            (&hello["may_watch"], &hello["role"]),
            (&json!(false), &json!(null))
        );
        assert_eq!(hello["token_file"], json!(null));
        assert_eq!(http(&address, "GET /healthz", token, "").0, 200);
    }
    for (token, name, may) in [
        (vera, "vera", false),
        (cleo, "cleo", false),
        (olga, "olga", true),
    ] {
        assert_eq!(
            http(&address, "GET /api/get/s/get/status", token, "").0,
            200
        );
        assert_eq!(http(&address, "GET /metrics", token, "").0, 200);
        assert!(tab(&address, token).await);
        let (_, hello) = http(&address, "GET /api/hello", token, "");
        let actual = (&hello["person"], &hello["may_watch"], &hello["may_command"]);
        assert_eq!(actual, (&json!(name), &json!(true), &json!(may)));
    }
    // The journal has the person of the token as the client.
    let (_, journal) = http(&address, "GET /api/get/s/get/journal", olga, "");
    let entries = journal["result"]["entries"].as_array().unwrap();
    assert!(
        entries.iter().all(|entry| entry["client"] == "olga"),
        "{journal}"
    );
    daemon.close(Vec::new()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn over_tls_http_is_for_other_machines_too() {
    let daemon = AuthDaemon::start_with_http("https://127.0.0.1:0").await;
    assert!(
        daemon
            .server
            .url()
            .unwrap()
            .starts_with("https://127.0.0.1:")
    );
    let address = daemon.server.http().unwrap();
    let token = daemon.credentials("vera").token;
    let head = |path: &str, origin: &str, token: &str| {
        format!(
            "GET {path} HTTP/1.1\r\nHost: lab.example:8443\r\nOrigin: {origin}\r\n\
             Authorization: Bearer {token}\r\nConnection: close\r\n\r\n"
        )
    };
    let own = "https://lab.example:8443";
    let swarms = "/api/get/@node/get/swarms";
    for (request, status) in [
        (head(swarms, own, &token), "200"),
        (head("/", own, "nobody's"), "200"),
        (head(swarms, own, "nobody's"), "401"),
        (head(swarms, "https://evil.example", &token), "403"),
    ] {
        let answer = https(address, &daemon.folder, &request).await.unwrap();
        assert!(
            answer.starts_with(&format!("HTTP/1.1 {status} ")),
            "{answer}"
        );
    }
    // Silent connections delay no other client.
    let mut silent = Vec::new();
    for _ in 0..50 {
        silent.push(TcpStream::connect(address).await.unwrap());
    }
    let answer = https(address, &daemon.folder, &head("/healthz", own, "")).await;
    assert!(answer.unwrap().starts_with("HTTP/1.1 200 "));
    // A client rejects another daemon's certificate, and an unencrypted connection fails.
    let stranger = Folder::new(daemon.base.path().join("stranger"));
    issue::init(&stranger, &[], &[]).unwrap();
    assert_eq!(
        https(address, &stranger, &head("/", own, &token)).await,
        None
    );
    let mut clear = TcpStream::connect(address).await.unwrap();
    clear
        .write_all(head("/", own, &token).as_bytes())
        .await
        .unwrap();
    let mut answer = Vec::new();
    let _ = clear.read_to_end(&mut answer).await;
    assert!(!answer.starts_with(b"HTTP"));
    drop(silent);
    daemon.close(Vec::new()).await;
}

/// The secrets of each person.
fn secrets(folder: &Folder) -> Vec<String> {
    let mut secrets = Vec::new();
    for (name, _) in PEOPLE {
        let Credentials {
            token, password, ..
        } = folder.credentials(name).unwrap();
        secrets.extend([token, password]);
        let key = folder
            .person_folder(name)
            .join(Credentials::CERTIFICATES[2]);
        secrets.push(second_line(&fs::read_to_string(key).unwrap()));
    }
    for [_, key] in [folder.authority(), folder.daemon()] {
        secrets.push(second_line(&fs::read_to_string(key).unwrap()));
    }
    secrets
}

fn second_line(text: &str) -> String {
    text.lines().nth(1).unwrap().to_owned()
}

#[tokio::test(flavor = "multi_thread")]
async fn no_secret_is_in_any_log_nor_among_what_is_kept() {
    let base = tempfile::tempdir().unwrap();
    let folder = Folder::new(base.path().join("auth"));
    let people = PEOPLE.map(|(name, role)| (name.to_owned(), role));
    issue::init(&folder, &[], &people).unwrap();
    let [zenoh, address] = free_ports("127.0.0.1").map(|port| format!("127.0.0.1:{port}"));
    let [out, log] = ["out", "log"].map(|name| base.path().join(name));
    let data = tempfile::tempdir().unwrap();
    let mut command = jostled(&["serve", "--node", NODE, "--log", "trace"]);
    command
        .args(["--listen", &format!("tls/{zenoh}"), "--http", &address])
        .arg("--auth-dir")
        .arg(folder.path())
        .arg("--data-dir")
        .arg(data.path())
        .env("RUST_BACKTRACE", "1")
        .stdout(File::create(&out).unwrap())
        .stderr(File::create(&log).unwrap());
    let mut process = Process::of(&mut command);
    let endpoint = format!("tls/{zenoh}");
    until("it serves", async || {
        fs::read_to_string(&out).unwrap().contains("http on")
    })
    .await;
    for (name, _) in PEOPLE {
        let user = UserSession {
            session: SessionCredentials::of(&folder, name)
                .open(&endpoint)
                .await
                .unwrap(),
            token: Some(folder.credentials(name).unwrap().token),
        };
        let create = json!({"name": "s", "spec": {"n": 3}, "exist_ok": true});
        user.query_all(&keys::node_cmd(PREFIX, NODE, "create"), Some(&create))
            .await;
        user.query_all(&keys::cmd(PREFIX, "s", "set"), Some(&json!({"pi3": 1.1})))
            .await;
        user.ok(&keys::node_get(PREFIX, NODE, "whoami"), None).await;
        let token = user.token.as_deref();
        http(&address, "POST /api/cmd/s/pause", token, "{}");
        http(&address, "GET /api/get/s/get/status", token, "");
        assert!(tab(&address, token).await);
        user.session.close().await.unwrap();
    }
    // A rejected client sends a secret too.
    let mut wrong = SessionCredentials::of(&folder, "vera");
    let password = folder.credentials("olga").unwrap().password;
    wrong.user = Some(("vera".into(), password));
    assert!(wrong.open(&endpoint).await.is_err());
    process.signal("-TERM");
    assert_eq!(process.end().0, Some(0));

    let logged = fs::read(&log).unwrap();
    assert!(
        logged.len() > 10_000,
        "so little was logged that nothing is shown"
    );
    let mut read = vec![(log, logged), (out.clone(), fs::read(&out).unwrap())];
    let mut folders = vec![data.path().to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            match path.is_dir() {
                true => folders.push(path),
                false => read.push((path.clone(), fs::read(&path).unwrap())),
            }
        }
    }
    for secret in secrets(&folder) {
        for (path, bytes) in &read {
            let is_in = bytes
                .windows(secret.len())
                .any(|it| it == secret.as_bytes());
            assert!(!is_in, "a secret is in {}", path.display());
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_end_of_the_certificate_is_a_metric_and_a_warning_before() {
    const METRIC: &str = "\njostle_certificate_end_timestamp_seconds ";
    let mut daemon = AuthDaemon::start().await;
    let arguments = ["-u", "-d", "+50 days", "+%F"];
    let soon = Command::new("date").args(arguments).output().unwrap();
    let soon = String::from_utf8(soon.stdout).unwrap();
    for until in [Some(soon.trim()), Some("2999-03-01"), None] {
        let mut known = daemon.folder.people().unwrap();
        known.until = until.map(str::to_owned);
        daemon.folder.write_people(&known).unwrap();
        daemon.server.stop().await;
        daemon = AuthDaemon::start_in(daemon.base, daemon.folder, "127.0.0.1:0").await;
        let address = daemon.server.http().unwrap().to_string();
        let (status, report) = health(&address);
        assert_eq!(status, 200, "{report}");
        let warning = &report["warnings"][0];
        if until == Some(soon.trim()) {
            assert_eq!(warning["code"], "certificate_ends", "{report}");
            let message = warning["message"].as_str().unwrap();
            let expected = format!("certificate expires on {}: run `jostled", soon.trim());
            assert!(message.contains(&expected), "{message}");
        } else {
            assert_eq!(warning, &Value::Null);
        }
        let token = daemon.credentials("vera").token;
        let request = format!(
            "GET /metrics HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\
             Authorization: Bearer {token}\r\n\r\n"
        );
        let metrics = send(&address, &request).2;
        assert_eq!(metrics.contains(METRIC), until.is_some(), "{until:?}");
        let is_then = metrics.contains(&format!("{METRIC}32477241600\n"));
        assert_eq!(is_then, until == Some("2999-03-01"));
    }
    daemon.server.stop().await;
}
