//! Idle and slow HTTP connections: they are closed, and do not keep other clients out.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use futures_util::{SinkExt, StreamExt};
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::Message;

use crate::apart::Process;
use crate::health::{get, of_daemon};
use crate::page::tab;
use crate::support::{Daemon, NODE, PATIENCE, beside_others};

/// The descriptor limit of the daemon: it keeps a quarter of them as HTTP connections.
const DESCRIPTORS: usize = 512;

/// The first connections of the flood: more than the daemon has descriptors.
const FLOOD: usize = 600;

/// The longest that `/healthz` may take in the flood.
const HEALTHZ_TIMEOUT: Duration = Duration::from_secs(5);

/// A daemon process with few descriptors, and where it serves HTTP.
fn serve() -> (Process, String) {
    let folder = tempfile::tempdir().unwrap();
    let mut command = Command::new("sh");
    command
        .args([
            "-c",
            &format!("ulimit -n {DESCRIPTORS} && exec \"$0\" \"$@\""),
        ])
        .arg(env!("CARGO_BIN_EXE_jostled"))
        .args(["--listen", "tcp/127.0.0.1:0", "--node", NODE])
        .args(["--http", "127.0.0.1:0", "--data-dir"])
        .arg(folder.path())
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .stdout(Stdio::piped());
    let mut process = Process(command.spawn().unwrap(), folder);
    let mut lines = BufReader::new(process.0.stdout.take().unwrap()).lines();
    let address =
        lines.find_map(|line| Some(line.unwrap().strip_prefix("http on http://")?.to_owned()));
    (process, address.unwrap())
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

/// Reads until the daemon closes the connection.
fn read_to_close(mut stream: TcpStream) -> String {
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut answer = Vec::new();
    let mut piece = [0; 1024];
    loop {
        match stream.read(&mut piece) {
            Ok(0) => break,
            Ok(length) => answer.extend_from_slice(&piece[..length]),
            Err(error) if error.kind() == std::io::ErrorKind::ConnectionReset => break,
            Err(error) => panic!("it is still open: {error}"),
        }
    }
    String::from_utf8(answer).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_of_half_headers_keeps_no_client_out() {
    let _machine = beside_others().await;
    let (_process, address) = serve();
    let mut socket = tab(&address, "/api/ws").await;
    let mut flood: Vec<_> = (0..FLOOD).map(|_| half_header(&address)).collect();
    let mut worst = Duration::ZERO;
    for attempt in 0..20 {
        flood.extend((0..10).map(|_| half_header(&address)));
        let start = Instant::now();
        assert_eq!(healthz(&address), Some(200), "attempt {attempt}");
        worst = worst.max(start.elapsed());
    }
    println!("worst of 20 healthz: {worst:?}");
    assert!(worst < HEALTHZ_TIMEOUT, "{worst:?}");
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
