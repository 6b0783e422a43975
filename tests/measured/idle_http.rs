//! Floods of unfinished HTTP connections: other clients are served.

use std::io::ErrorKind;
use std::time::{Duration, Instant};

use futures_util::{SinkExt, StreamExt};
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;
use tokio::time::{sleep, timeout};
use tokio_tungstenite::tungstenite::Message;

use crate::support::TIMEOUT;
use crate::support::limited_daemon::{Connection, DESCRIPTORS, LimitedDaemon};
use crate::support::websocket::tab;

/// The first connections of the flood: more than the daemon has descriptors.
const FLOOD: usize = 600;

/// The maximum response time of `/healthz` during the flood.
const HEALTHZ_TIMEOUT: Duration = Duration::from_secs(5);

/// The maximum time of `jostle status` during the flood, from the start of its process to its end.
const STATUS_TIMEOUT: Duration = Duration::from_secs(1);

/// The time without progress after which a write is taken to be blocked.
const WRITE_TIMEOUT: Duration = Duration::from_millis(500);

/// Sends requests until a write fails, or `None` once one blocks, and reads no response.
async fn write_until_error(daemon: &LimitedDaemon, stream: &mut Connection) -> Option<ErrorKind> {
    let address = daemon.address;
    let request = format!("GET / HTTP/1.1\r\nHost: {address}\r\n\r\n").repeat(100);
    loop {
        match timeout(WRITE_TIMEOUT, stream.write_all(request.as_bytes())).await {
            Ok(Ok(())) => {}
            Ok(Err(error)) => return Some(error.kind()),
            Err(_) => return None,
        }
    }
}

/// The longest of twenty `/healthz` and of twenty `jostle status`, each after ten more connections
/// of the flood.
async fn longest_requests(
    daemon: &LimitedDaemon,
    more: impl AsyncFn() -> Connection,
) -> (Duration, Duration) {
    let (mut flood, mut worst) = (Vec::new(), (Duration::ZERO, Duration::ZERO));
    for attempt in 0..20 {
        for _ in 0..10 {
            flood.push(more().await);
        }
        let start = Instant::now();
        let answer = timeout(HEALTHZ_TIMEOUT, daemon.get("/healthz")).await;
        assert_eq!(answer.expect("no response in time").0, 200, "{attempt}");
        worst.0 = worst.0.max(start.elapsed());
        let start = Instant::now();
        let status = daemon.jostle(&["status", "a"]);
        worst.1 = worst.1.max(start.elapsed());
        assert!(status.status.success(), "{attempt}: {status:?}");
    }
    worst
}

/// A flood of half headers, beside a connection whose client reads nothing.
async fn flood_of_half_headers(daemon: &LimitedDaemon) {
    let mut unread = daemon.connect().await;
    assert_eq!(write_until_error(daemon, &mut unread).await, None);
    let mut flood = Vec::new();
    for _ in 0..FLOOD {
        flood.push(daemon.half_header().await);
    }
    let (healthz, status) = longest_requests(daemon, async || daemon.half_header().await).await;
    println!("worst of 20: healthz {healthz:?}, jostle status {status:?}");
    assert!(healthz < HEALTHZ_TIMEOUT, "{healthz:?}");
    assert!(status < STATUS_TIMEOUT, "{status:?}");
    // The connection whose client reads nothing was evicted: its next write does not block.
    let error = write_until_error(daemon, &mut unread).await;
    let expected = [ErrorKind::ConnectionReset, ErrorKind::BrokenPipe];
    assert!(error.is_some_and(|it| expected.contains(&it)), "{error:?}");
    let (status, body) = daemon.get("/api/hello").await;
    assert_eq!(status, 200, "{body}");
    let evicted = daemon.closed("evicted").await;
    assert!(evicted > (FLOOD / 2) as f64, "{evicted}");
    let open = daemon.metric("jostle_http_connections").await;
    assert!((1.0..=(DESCRIPTORS / 4) as f64).contains(&open), "{open}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_of_half_headers_keeps_no_client_out() {
    let daemon = LimitedDaemon::serve("http", "");
    let mut socket = tab(&daemon.address.to_string(), "/api/ws").await;
    flood_of_half_headers(&daemon).await;
    socket.send(Message::Ping("flood".into())).await.unwrap();
    let pong =
        async { while !matches!(socket.next().await.unwrap().unwrap(), Message::Pong(_)) {} };
    timeout(TIMEOUT, pong).await.expect("the WebSocket is open");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_of_half_headers_over_tls_keeps_no_client_out() {
    flood_of_half_headers(&LimitedDaemon::serve("https", "")).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_of_unfinished_handshakes_keeps_no_client_out() {
    let daemon = LimitedDaemon::serve("https", "");
    let began = Instant::now();
    let silent = async || Box::new(TcpStream::connect(daemon.address).await.unwrap()) as Connection;
    let mut flood = Vec::new();
    for _ in 0..FLOOD {
        flood.push(silent().await);
    }
    let (healthz, status) = longest_requests(&daemon, &silent).await;
    println!("worst of 20: healthz {healthz:?}, jostle status {status:?}");
    assert!(healthz < HEALTHZ_TIMEOUT, "{healthz:?}");
    assert!(status < STATUS_TIMEOUT, "{status:?}");
    // Two probes of its own listener that fail would turn it unhealthy within this time.
    while began.elapsed() < Duration::from_secs(9) {
        flood.push(silent().await);
        assert_eq!(daemon.get("/healthz").await.0, 200);
        sleep(Duration::from_millis(100)).await;
    }
    assert!(daemon.closed("evicted").await > 0.0);
}
