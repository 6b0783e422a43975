//! The page's HTTP requests and WebSockets.

use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Command, Stdio};

use futures_util::SinkExt;
use serde_json::{Value, json};
use tokio_tungstenite::tungstenite::{self, Message};

use crate::support::http::{get, of_daemon, send, send_bytes};
use crate::support::process::jostled;
use crate::support::websocket::{named, next_matching, open, step_of, tab};
use crate::support::{Daemon, NODE, until};

/// A browser with or without the token.
struct Browser {
    address: String,
    token: Option<String>,
}

impl Browser {
    fn of(daemon: &Daemon) -> Self {
        let link = daemon.server.page().unwrap();
        let (_, token) = link.split_once("/#token=").unwrap();
        Browser {
            address: of_daemon(daemon),
            token: Some(token.to_owned()),
        }
    }

    fn head(&self) -> String {
        let Browser { address, token } = self;
        let token = token.as_ref();
        let token = token.map(|token| format!("Authorization: Bearer {token}\r\n"));
        let token = token.unwrap_or_default();
        format!("Host: {address}\r\nOrigin: http://{address}\r\nConnection: close\r\n{token}")
    }

    fn post(&self, path: &str, body: &str) -> (u16, Value) {
        let head = self.head();
        let length = body.len();
        let request =
            format!("POST {path} HTTP/1.1\r\n{head}Content-Length: {length}\r\n\r\n{body}");
        let (status, _, body) = send(&self.address, &request);
        (status, serde_json::from_str(&body).unwrap_or_default())
    }

    fn get(&self, path: &str) -> (u16, Value) {
        let request = format!("GET {path} HTTP/1.1\r\n{}\r\n", self.head());
        let (status, _, body) = send(&self.address, &request);
        (status, serde_json::from_str(&body).unwrap_or_default())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_is_served_and_may_load_nothing_from_elsewhere() {
    let daemon = Daemon::start().await;
    let address = of_daemon(&daemon);
    let (status, head, body) = get(&address, "/");
    assert_eq!(status, 200);
    assert!(head.contains("content-type: text/html"), "{head}");
    assert!(
        head.contains("content-security-policy: default-src 'self'"),
        "{head}"
    );
    assert!(body.contains("jostle"));
    for nothing in [
        "/nothing",
        "/../Cargo.toml",
        "/%2e%2e/Cargo.toml",
        "/api/nothing",
    ] {
        assert_eq!(get(&address, nothing).0, 404, "{nothing}");
    }
    daemon.stop().await;
}

/// What `gzip`, which is not our library, makes of compressed bytes.
fn unzipped(compressed: &[u8]) -> Vec<u8> {
    let mut gzip = Command::new("gzip");
    let gzip = gzip.arg("-dc").stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut gzip = gzip.spawn().unwrap();
    // The output is longer than a pipe holds.
    let mut stdin = gzip.stdin.take().unwrap();
    let compressed = compressed.to_vec();
    let writing = std::thread::spawn(move || stdin.write_all(&compressed).unwrap());
    let output = gzip.wait_with_output().unwrap();
    writing.join().unwrap();
    assert!(output.status.success());
    output.stdout
}

/// The value of a header, in lower case; empty if there is none.
fn header(head: &str, name: &str) -> String {
    let values = head.lines().filter_map(|line| line.split_once(": "));
    let mut values = values.filter(|(it, _)| *it == name);
    let value = values.next().map(|(_, value)| value.to_owned());
    assert!(values.next().is_none(), "{name} twice: {head}");
    value.unwrap_or_default()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_files_of_the_page_are_compressed_and_sent_again_only_if_they_differ() {
    let daemon = Daemon::start().await;
    let address = of_daemon(&daemon);
    let fetch = |method: &str, path: &str, headers: &str| {
        let about = format!("Host: {address}\r\nConnection: close\r\n{headers}");
        send_bytes(
            &address,
            &format!("{method} {path} HTTP/1.1\r\n{about}\r\n"),
        )
    };
    let dist = Path::new(env!("CARGO_MANIFEST_DIR")).join("../clients/web/dist");
    for (path, file) in [
        ("/", "index.html"),
        ("/page.js", "page.js"),
        ("/style.css", "style.css"),
        ("/icon.svg", "icon.svg"),
    ] {
        let built = std::fs::read(dist.join(file)).unwrap();
        let (status, head, body) = fetch("GET", path, "");
        assert_eq!(status, 200, "{path}");
        assert_eq!(header(&head, "content-encoding"), "", "{path}");
        assert!(body == built, "{path} is what was built");
        let (status, packed_head, packed) =
            fetch("GET", path, "Accept-Encoding: br, GZIP;q=0.8, deflate\r\n");
        assert_eq!(status, 200, "{path}");
        assert_eq!(header(&packed_head, "content-encoding"), "gzip", "{path}");
        assert!(unzipped(&packed) == built, "{path}");
        assert!(packed.len() < built.len(), "{path}: {}", packed.len());
        let length = packed.len().to_string();
        assert_eq!(header(&packed_head, "content-length"), length);
        let etags = [header(&head, "etag"), header(&packed_head, "etag")];
        assert_ne!(etags[0], etags[1], "the bytes differ");
        for (encoding, etag) in ["", "Accept-Encoding: gzip\r\n"].iter().zip(&etags) {
            assert!(etag.starts_with('"') && etag.ends_with('"'), "{etag}");
            for known in [etag.clone(), format!("\"other\", W/{etag}"), "*".to_owned()] {
                let known = format!("{encoding}If-None-Match: {known}\r\n");
                let (status, head, body) = fetch("GET", path, &known);
                assert_eq!((status, body.len()), (304, 0), "{path}: {known}");
                assert_eq!(&header(&head, "etag"), etag);
                for name in ["cache-control", "vary", "content-security-policy"] {
                    assert_eq!(header(&head, name), header(&packed_head, name), "{name}");
                }
            }
            let unknown = format!("{encoding}If-None-Match: \"other\"\r\n");
            assert_eq!(fetch("GET", path, &unknown).0, 200, "{path}");
        }
        assert_eq!(header(&packed_head, "cache-control"), "no-cache", "{path}");
        for head in [&head, &packed_head] {
            assert_eq!(header(head, "vary"), "accept-encoding", "{path}");
            assert!(header(head, "content-security-policy").contains("default-src 'self'"));
        }
        let (status, head, body) = fetch("HEAD", path, "Accept-Encoding: gzip\r\n");
        assert_eq!((status, body.len()), (200, 0), "{path}");
        assert_eq!(header(&head, "content-length"), length);
        assert_eq!(header(&head, "etag"), etags[1]);
    }
    let (_, _, packed) = fetch("GET", "/page.js", "Accept-Encoding: gzip\r\n");
    let whole = std::fs::metadata(dist.join("page.js")).unwrap().len();
    assert!((packed.len() as u64) < 2 * whole / 5, "{}", packed.len());
    for (accepted, encoding) in [
        ("*", "gzip"),
        ("*;q=0.5, identity;q=0.1", "gzip"),
        ("identity\r\nAccept-Encoding: gzip", "gzip"),
        ("gzip;q=0", ""),
        ("gzip; q=0.000, *", ""),
        ("identity, gzip;q=0.5", ""),
        ("br, deflate", ""),
        ("", ""),
    ] {
        let (_, head, _) = fetch(
            "GET",
            "/page.js",
            &format!("Accept-Encoding: {accepted}\r\n"),
        );
        assert_eq!(header(&head, "content-encoding"), encoding, "{accepted:?}");
    }
    let (_, head, _) = fetch("GET", "/api/hello", "");
    assert_eq!(header(&head, "cache-control"), "no-store");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_is_changed_without_the_token() {
    let daemon = Daemon::start().await;
    daemon.client.create("a", json!({"n": 3})).await;
    let steering = Browser::of(&daemon);
    let token = steering.token.clone().unwrap();
    let address = steering.address.clone();
    let before = daemon.client.get("a", "status").await;
    let wrong = [
        None,
        Some(String::new()),
        Some(token[1..].to_owned()),
        Some(token.replace(|c: char| c.is_ascii_digit(), "z")),
    ];
    for token in wrong {
        let watching = Browser {
            address: address.clone(),
            token,
        };
        let (_, hello) = watching.get("/api/hello");
        assert_eq!(hello["may_command"], false);
        let file = hello["token_file"].as_str().unwrap();
        let kept = std::fs::read_to_string(file).unwrap();
        assert_eq!(Some(kept.trim()), steering.token.as_deref(), "{file}");
        for verb in [
            "run", "step", "set", "inform", "inject", "reset", "fork", "delete", "nothing",
        ] {
            let (status, error) = watching.post(&format!("/api/cmd/a/{verb}"), "{}");
            assert_eq!(status, 401, "{verb}: {error}");
            assert_eq!(error["code"], "permission_denied");
            assert!(error["message"].as_str().unwrap().contains(file), "{error}");
        }
        let (status, _) = watching.post("/api/node/create", r#"{"name": "b", "spec": {"n": 3}}"#);
        assert_eq!(status, 401);
    }
    // Nor with the token in a GET, which a link or an image could send.
    assert_eq!(steering.get("/api/cmd/a/delete").0, 405);
    for no_look in [
        "a/cmd/delete",
        "@node/cmd/create",
        "**/get/status",
        "a/get/**",
        "a/event",
    ] {
        let (status, _) = steering.get(&format!("/api/get/{no_look}"));
        assert!([400, 404].contains(&status), "{no_look}: {status}");
    }
    assert_eq!(
        daemon.client.get("a", "status").await["result"],
        before["result"]
    );
    assert_eq!(
        daemon.client.node("swarms").await["swarms"]
            .as_array()
            .unwrap()
            .len(),
        1
    );

    assert_eq!(steering.get("/api/hello").1["may_command"], true);
    let (status, answer) = steering.post("/api/cmd/a/step", r#"{"steps": 3}"#);
    assert_eq!((status, &answer["step"]), (200, &json!(3)), "{answer}");
    let (status, error) = steering.post("/api/cmd/a/step", r#"{"steps": -1}"#);
    assert_eq!((status, &error["code"]), (400, &json!("invalid_argument")));
    let (status, error) = steering.post("/api/cmd/nobody/step", "{}");
    assert_eq!((status, &error["code"]), (404, &json!("not_found")));
    let request = r#"{"client": "page", "request_id": "once", "args": {"steps": 2}}"#;
    for _ in 0..2 {
        assert_eq!(steering.post("/api/cmd/a/step", request).1["step"], 5);
    }
    let (status, _) = steering.post("/api/node/create", r#"{"name": "b", "spec": {"n": 3}}"#);
    assert_eq!(status, 200);
    let (_, journal) = steering.get("/api/get/a/get/journal?after=1&limit=10");
    let entries = journal["result"]["entries"].as_array().unwrap();
    assert!(
        entries.iter().any(|entry| entry["client"] == "page"),
        "{journal}"
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn other_pages_and_long_bodies_are_turned_away() {
    let daemon = Daemon::start().await;
    daemon.client.create("a", json!({"n": 3})).await;
    let Browser { address, token } = Browser::of(&daemon);
    let token = token.unwrap();
    let ask = |line: &str, headers: &str| {
        let request = format!(
            "{line} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\
             Authorization: Bearer {token}\r\n{headers}\r\n"
        );
        send(&address, &request).0
    };
    let foreign = [
        "Origin: http://evil.example\r\n".to_owned(),
        "Origin: null\r\n".into(),
        "Origin:\r\n".into(),
        format!("Origin: http://{address}.evil.example\r\n"),
        format!("Origin: http://{address}\r\nOrigin: http://evil.example\r\n"),
        "Origin: http://127.0.0.1:1\r\n".into(),
    ];
    for origin in &foreign {
        for line in [
            "GET /",
            "GET /api/get/a/get/status",
            "POST /api/cmd/a/delete",
            "GET /api/ws",
        ] {
            assert_eq!(ask(line, origin), 403, "{line} {origin}");
        }
        let origin = origin
            .lines()
            .next()
            .unwrap()
            .trim_start_matches("Origin:")
            .trim();
        if origin != format!("http://{address}") {
            let error = open(&address, "/api/ws?swarm=a", Some(origin))
                .await
                .unwrap_err();
            let tungstenite::Error::Http(answer) = error else {
                panic!("{error}");
            };
            assert_eq!(answer.status(), 403);
        }
    }
    assert_eq!(
        ask(
            "GET /api/get/a/get/status",
            &format!("Origin: http://{address}\r\n")
        ),
        200
    );
    assert_eq!(
        ask("POST /api/cmd/a/step", "Content-Length: 1000000000\r\n"),
        413
    );
    assert_eq!(
        ask("GET /api/get/a/get/status", "Content-Length: 10\r\n"),
        413
    );
    let steering = Browser::of(&daemon);
    let long = format!(r#"{{"steps": 1, "x": "{}"}}"#, "y".repeat(1 << 20));
    assert_eq!(steering.post("/api/cmd/a/step", &long).0, 413);
    assert_eq!(daemon.client.get("a", "status").await["step"], 0);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_tab_receives_the_list_the_newest_state_and_every_event() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client
        .create("a", json!({"n": 3, "publish_every": 1}))
        .await;
    let address = of_daemon(&daemon);
    let mut tab = tab(&address, "/api/ws?swarm=a").await;
    // The state of a paused swarm arrives at once.
    assert_eq!(next_matching(&mut tab, step_of).await, 0);
    let swarms = next_matching(&mut tab, |message| named(message, "swarms")).await;
    assert_eq!(swarms[0]["swarm"], "a");
    client.ok("a", "step", json!({"steps": 40})).await;
    next_matching(&mut tab, |message| {
        step_of(message).filter(|step| *step == 40)
    })
    .await;
    client
        .ok(
            "a",
            "inform",
            json!({"select": {"ids": [1]}, "direction": 0.5}),
        )
        .await;
    let is_inform = |message: &Message| {
        named(message, "event").filter(|event| event["event"]["verb"] == "inform")
    };
    next_matching(&mut tab, is_inform).await;
    let is_informed =
        |message: &Message| named(message, "order").filter(|order| order["informed"] == 1);
    client.ok("a", "step", json!({"steps": 1})).await;
    next_matching(&mut tab, is_informed).await;
    client.create("b", json!({"n": 3})).await;
    let both = |message: &Message| {
        named(message, "swarms").filter(|swarms| swarms.as_array().unwrap().len() == 2)
    };
    next_matching(&mut tab, both).await;
    client.ok("a", "delete", json!({})).await;
    let is_end = |message: &Message| {
        named(message, "event").filter(|event| event["event"]["kind"] == "deleted")
    };
    next_matching(&mut tab, is_end).await;
    next_matching(&mut tab, |message| named(message, "gone")).await;
    let (status, _) = Browser::of(&daemon).get("/api/get/a/get/status");
    assert_eq!(status, 404);

    let mut gone = self::tab(&address, "/api/ws?swarm=a").await;
    next_matching(&mut gone, |message| named(message, "gone")).await;
    let error = open(&address, "/api/ws?swarm=A*", None).await.unwrap_err();
    let tungstenite::Error::Http(answer) = error else {
        panic!("{error}");
    };
    assert_eq!(answer.status(), 400);
    // Messages of a tab are ignored.
    let _ = tab.send(Message::text("delete everything")).await;
    let _ = tab.send(Message::binary(vec![0; 100_000])).await;
    assert_eq!(get(&address, "/healthz").0, 200);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn so_many_tabs_are_open_at_once_and_no_more() {
    let daemon = Daemon::start().await;
    let address = of_daemon(&daemon);
    let mut tabs = Vec::new();
    for _ in 0..256 {
        tabs.push(tab(&address, "/api/ws").await);
    }
    let error = open(&address, "/api/ws", None).await.unwrap_err();
    let tungstenite::Error::Http(answer) = error else {
        panic!("{error}");
    };
    assert_eq!(answer.status(), 429);
    let body = String::from_utf8_lossy(answer.body().as_deref().unwrap_or_default()).into_owned();
    assert!(body.contains("close one"), "{body}");
    tabs.truncate(255);
    until("a place is free", async || {
        open(&address, "/api/ws", None).await.is_ok()
    })
    .await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_token_is_printed_once_and_in_no_log() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = jostled(&["--listen", "tcp/127.0.0.1:0", "--node", NODE]);
    command
        .args(["--http", "127.0.0.1:0", "--data-dir"])
        .arg(folder.path())
        .env(
            "RUST_LOG",
            "jostled=trace,axum=trace,hyper=trace,tungstenite=trace",
        )
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let mut process = command.spawn().unwrap();
    let mut lines = BufReader::new(process.stdout.take().unwrap()).lines();
    let link =
        lines.find_map(|line| Some(line.unwrap().strip_prefix("page on http://")?.to_owned()));
    let (address, token) = {
        let link = link.unwrap();
        // Standard output is not a terminal, so the line names the file with the token.
        let (address, file) = link.split_once("/ with the token in ").unwrap();
        let token = std::fs::read_to_string(file).unwrap();
        (address.to_owned(), token.trim().to_owned())
    };
    let steering = Browser {
        address: address.clone(),
        token: Some(token.clone()),
    };
    assert_eq!(
        steering
            .post("/api/node/create", r#"{"name": "a", "spec": {"n": 3}}"#)
            .0,
        200
    );
    assert_eq!(steering.get("/api/get/a/get/status").0, 200);
    drop(tab(&address, "/api/ws?swarm=a").await);
    process.kill().unwrap();
    let mut log = String::new();
    process
        .stderr
        .take()
        .unwrap()
        .read_to_string(&mut log)
        .unwrap();
    process.wait().unwrap();
    assert!(!log.contains(&token));
    let rest: Vec<String> = lines.map_while(Result::ok).collect();
    assert!(!rest.iter().any(|line| line.contains(&token)), "{rest:?}");
    for file in std::fs::read_dir(folder.path()).unwrap() {
        let path = file.unwrap().path();
        let is_its_own = path.file_name().unwrap() == "page-token";
        let text = std::fs::read(&path).unwrap_or_default();
        let text = String::from_utf8_lossy(&text);
        assert_eq!(text.contains(&token), is_its_own, "{}", path.display());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_is_fetched_with_the_token_only() {
    let daemon = Daemon::start().await;
    daemon.client.create("school", json!({"n": 3})).await;
    let operator = Browser::of(&daemon);
    let begin = json!({"begin": {"swarm": "school", "recording": "take"}});
    let stop = json!({"stop": {"recording": "take"}});
    for request in [begin, stop] {
        let (status, body) = operator.post("/api/node/record", &request.to_string());
        assert_eq!(status, 200, "{body}");
    }
    let watcher = Browser {
        address: operator.address.clone(),
        token: None,
    };
    assert_eq!(watcher.get("/api/get/@node/get/recordings").0, 200);
    let take = "/api/get/@node/get/recording?name=take";
    let (status, body) = watcher.get(take);
    assert!([401, 403].contains(&status), "{status}: {body}");
    let (status, piece) = operator.get(take);
    assert_eq!(status, 200, "{piece}");
    assert!(piece["result"]["length"].as_u64() > Some(1000), "{piece}");
    daemon.stop().await;
}
