//! Idle and slow HTTP connections: they are closed, and do not keep other clients out.

use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use futures_util::{SinkExt, StreamExt};
use jostle_proto::Role;
use jostled::rights::folder::Folder;
use jostled::rights::issue;
use rustix::process::{Pid, Resource, Rlimit, prlimit};
use tempfile::TempDir;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::Message;

use crate::apart::Process;
use crate::health::{get, of_daemon};
use crate::page::tab;
use crate::rights::secrets::https;
use crate::support::{Client, Daemon, NODE, PATIENCE, beside_others, until};

/// The descriptor limit of the daemon: it keeps a quarter of them as HTTP connections.
const DESCRIPTORS: usize = 512;

/// The first connections of the flood: more than the daemon has descriptors.
const FLOOD: usize = 600;

/// The maximum response time of `/healthz` during the flood.
const HEALTHZ_TIMEOUT: Duration = Duration::from_secs(5);

/// The maximum time to open a zenoh session and get a reply during the flood.
const STATUS_TIMEOUT: Duration = Duration::from_secs(1);

/// A daemon process with few descriptors.
struct Few {
    process: Process,
    /// Where it listens for zenoh.
    endpoint: String,
    /// Where it serves HTTP.
    address: String,
    /// Who may do what, if it serves HTTP over TLS.
    auth: TempDir,
}

impl Few {
    fn serve(scheme: &str, failpoints: &str) -> Self {
        let (data, auth) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let mut command = Command::new("sh");
        command
            .args([
                "-c",
                &format!("ulimit -n {DESCRIPTORS} && exec \"$0\" \"$@\""),
            ])
            .arg(env!("CARGO_BIN_EXE_jostled"))
            .args(["--listen", "tcp/127.0.0.1:0", "--node", NODE, "--data-dir"])
            .arg(data.path())
            .args(["--http", &format!("{scheme}://127.0.0.1:0")]);
        if scheme == "https" {
            let people = [("vera".to_owned(), Role::Viewer)];
            issue::init(&Folder::at(auth.path().join("auth")), &[], &people).unwrap();
            command.arg("--auth-dir").arg(auth.path().join("auth"));
        }
        command
            .env("FAILPOINTS", failpoints)
            .stdin(Stdio::null())
            .stderr(Stdio::null())
            .stdout(Stdio::piped());
        let mut process = Process(command.spawn().unwrap(), data);
        let mut lines = BufReader::new(process.0.stdout.take().unwrap()).lines();
        let mut after = |start: &str| {
            let mut found = lines.by_ref().map(Result::unwrap);
            found.find_map(|line| Some(line.strip_prefix(start)?.to_owned()))
        };
        Few {
            endpoint: after("listening on ").unwrap(),
            address: after(&format!("http on {scheme}://")).unwrap(),
            process,
            auth,
        }
    }

    fn plain() -> Self {
        Few::serve("http", "")
    }
}

/// A connection that sends half a header.
fn half_header(address: &str) -> TcpStream {
    let mut stream = TcpStream::connect(address).unwrap();
    // An error if it is evicted already.
    let _ = stream.write_all(b"GET /healthz HTTP/1.1\r\nHost: ");
    stream
}

/// The status of `/healthz`, or `None` if it is not answered in time.
fn healthz(address: &str) -> Option<u16> {
    let mut stream = TcpStream::connect(address).ok()?;
    stream.set_read_timeout(Some(HEALTHZ_TIMEOUT)).unwrap();
    let request = format!("GET /healthz HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).ok()?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer).ok()?;
    answer.split(' ').nth(1)?.parse().ok()
}

/// Sends requests until a write fails or blocks, and reads no response.
fn write_until_error(stream: &mut TcpStream, address: &str) -> ErrorKind {
    let request = format!("GET / HTTP/1.1\r\nHost: {address}\r\n\r\n").repeat(100);
    loop {
        if let Err(error) = stream.write_all(request.as_bytes()) {
            return error.kind();
        }
    }
}

/// A connection whose client has sent all that the daemon takes, and reads no response.
fn never_reading(address: &str) -> TcpStream {
    let mut stream = TcpStream::connect(address).unwrap();
    let timeout = Some(Duration::from_millis(500));
    stream.set_write_timeout(timeout).unwrap();
    let error = write_until_error(&mut stream, address);
    assert_eq!(error, ErrorKind::WouldBlock);
    stream
}

/// Reads until the daemon closes the connection.
fn read_to_close(mut stream: TcpStream) -> String {
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut answer = Vec::new();
    let mut piece = [0; 1024];
    loop {
        match stream.read(&mut piece) {
            Ok(0) => break,
            Ok(length) => answer.extend_from_slice(&piece[..length]),
            Err(error) if error.kind() == ErrorKind::ConnectionReset => break,
            Err(error) => panic!("it is still open: {error}"),
        }
    }
    String::from_utf8(answer).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_of_half_headers_keeps_no_client_out() {
    let _machine = beside_others().await;
    let daemon = Few::plain();
    let address = daemon.address.clone();
    let mut socket = tab(&address, "/api/ws").await;
    let mut unread = never_reading(&address);
    let mut flood: Vec<_> = (0..FLOOD).map(|_| half_header(&address)).collect();
    let (mut worst, mut worst_status) = (Duration::ZERO, Duration::ZERO);
    for attempt in 0..20 {
        flood.extend((0..10).map(|_| half_header(&address)));
        let start = Instant::now();
        assert_eq!(healthz(&address), Some(200), "attempt {attempt}");
        worst = worst.max(start.elapsed());
        let start = Instant::now();
        let client = Client::open(&daemon.endpoint).await;
        client.node("status").await;
        worst_status = worst_status.max(start.elapsed());
        client.session.close().await.unwrap();
    }
    println!("worst of 20: healthz {worst:?}, session and status {worst_status:?}");
    assert!(worst < HEALTHZ_TIMEOUT, "{worst:?}");
    assert!(worst_status < STATUS_TIMEOUT, "{worst_status:?}");
    // The connection whose client reads nothing was evicted: its next write does not block.
    let error = write_until_error(&mut unread, &address);
    assert!(
        matches!(error, ErrorKind::ConnectionReset | ErrorKind::BrokenPipe),
        "{error:?}"
    );
    let (status, _, body) = get(&address, "/api/hello");
    assert_eq!(status, 200, "{body}");

    socket.send(Message::Ping("flood".into())).await.unwrap();
    let pong =
        async { while !matches!(socket.next().await.unwrap().unwrap(), Message::Pong(_)) {} };
    timeout(PATIENCE, pong)
        .await
        .expect("the WebSocket is open");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_of_unfinished_handshakes_keeps_no_client_out() {
    let _machine = beside_others().await;
    let daemon = Few::serve("https", "");
    let folder = Folder::at(daemon.auth.path().join("auth"));
    let address: SocketAddr = daemon.address.parse().unwrap();
    let began = Instant::now();
    let silent = || TcpStream::connect(address).unwrap();
    let mut flood: Vec<_> = (0..FLOOD).map(|_| silent()).collect();
    let request = "GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
    let mut worst = Duration::ZERO;
    let mut attempts = 0;
    // Two probes of its own listener that fail would turn it unhealthy within this time.
    while attempts < 20 || began.elapsed() < Duration::from_secs(9) {
        flood.extend((0..10).map(|_| silent()));
        let start = Instant::now();
        let answer = timeout(HEALTHZ_TIMEOUT, https(address, &folder, request)).await;
        let answer = answer.expect("no response in time").unwrap();
        assert!(answer.starts_with("HTTP/1.1 200 "), "{answer}");
        worst = worst.max(start.elapsed());
        attempts += 1;
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    println!("worst of {attempts}: {worst:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_free_descriptor_a_connection_waits_and_is_served() {
    let _machine = beside_others().await;
    let daemon = Few::plain();
    let pid = i32::try_from(daemon.process.0.id()).unwrap();
    let limit = |descriptors| {
        let limit = Rlimit {
            current: Some(descriptors),
            maximum: Some(DESCRIPTORS as u64),
        };
        prlimit(Pid::from_raw(pid), Resource::Nofile, limit).unwrap();
    };
    // All that are free now are above the limit.
    limit(3);
    let address = daemon.address.clone();
    let waiting = std::thread::spawn(move || healthz(&address));
    sleep(Duration::from_millis(500));
    assert!(!waiting.is_finished());
    limit(DESCRIPTORS as u64);
    assert_eq!(waiting.join().unwrap(), Some(200));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_whose_http_listener_is_closed_is_unhealthy() {
    let _machine = beside_others().await;
    let daemon = Few::serve("http", "http-accept=return");
    let client = Client::open(&daemon.endpoint).await;
    let expected = format!("http/{} does not answer", daemon.address);
    until("the probe of HTTP fails twice", async || {
        let unwell = client.node("metrics").await["unwell"].to_string();
        unwell.contains(&expected)
    })
    .await;
    client.session.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_header_that_is_not_completed_times_out() {
    let daemon = Daemon::start().await;
    let stream = half_header(&of_daemon(&daemon));
    let start = Instant::now();
    read_to_close(stream);
    assert!(start.elapsed() > Duration::from_secs(4));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slow_body_times_out() {
    let daemon = Daemon::start().await;
    let address = of_daemon(&daemon);
    let mut stream = TcpStream::connect(&address).unwrap();
    let link = daemon.server.page().unwrap();
    let (_, token) = link.split_once("/#token=").unwrap();
    let head = format!("POST /api/cmd/a/step HTTP/1.1\r\nHost: {address}\r\n");
    let head = format!("{head}Authorization: Bearer {token}\r\n");
    // It would take more than a minute.
    let head = format!("{head}Content-Length: 200\r\n\r\n");
    stream.write_all(head.as_bytes()).unwrap();
    let reader = stream.try_clone().unwrap();
    let writer = std::thread::spawn(move || {
        for _ in 0..200 {
            if stream.write_all(b" ").is_err() {
                break;
            }
            sleep(Duration::from_millis(500));
        }
    });
    let answer = read_to_close(reader);
    assert!(answer.starts_with("HTTP/1.1 408 "), "{answer}");
    writer.join().unwrap();
    daemon.stop().await;
}
