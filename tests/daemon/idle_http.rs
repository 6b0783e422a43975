//! Idle and slow HTTP connections: they are closed, and do not keep other clients out.

use std::time::{Duration, Instant};

use rustix::process::{Pid, Resource, Rlimit, prlimit};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::{sleep, timeout};

use crate::support::limited_daemon::{Connection, DESCRIPTORS, LimitedDaemon, read_to_close};
use crate::support::{Client, TIMEOUT, until};

#[tokio::test(flavor = "multi_thread")]
async fn without_a_free_descriptor_a_connection_waits_and_is_served() {
    let daemon = LimitedDaemon::serve("http", "");
    let pid = i32::try_from(daemon.process.0.id()).unwrap();
    let limit = |descriptors| {
        let limit = Rlimit {
            current: Some(descriptors),
            maximum: Some(DESCRIPTORS as u64),
        };
        prlimit(Pid::from_raw(pid), Resource::Nofile, limit).unwrap();
    };
    let failures = "jostle_http_accept_failures_total";
    assert_eq!(daemon.metric(failures).await, 0.0);
    // Every free descriptor is above the limit.
    limit(3);
    let mut waiting = std::pin::pin!(daemon.get("/healthz"));
    let early = timeout(Duration::from_millis(500), waiting.as_mut()).await;
    assert!(early.is_err(), "{early:?}");
    limit(DESCRIPTORS as u64);
    assert_eq!(timeout(TIMEOUT, waiting).await.unwrap().0, 200);
    // One try each 100 ms.
    let failed = daemon.metric(failures).await;
    assert!((2.0..20.0).contains(&failed), "{failed}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_whose_http_listener_is_closed_is_unhealthy() {
    let daemon = LimitedDaemon::serve("http", "http-accept=return");
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
    for scheme in ["http", "https"] {
        let daemon = LimitedDaemon::serve(scheme, "");
        let mut stream = daemon.half_header().await;
        let start = Instant::now();
        read_to_close(&mut stream).await;
        assert!(start.elapsed() > Duration::from_secs(4), "{scheme}");
        assert_eq!(daemon.closed("header_timeout").await, 1.0, "{scheme}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_header_that_comes_byte_by_byte_times_out() {
    for scheme in ["http", "https"] {
        let daemon = LimitedDaemon::serve(scheme, "");
        let (mut reader, mut writer) = tokio::io::split(daemon.half_header().await);
        let start = Instant::now();
        let writing = async {
            while writer.write_all(b"x").await.is_ok() && writer.flush().await.is_ok() {
                sleep(Duration::from_millis(200)).await;
            }
        };
        let mut answer = Vec::new();
        let reading = reader.read_to_end(&mut answer);
        tokio::select! {
            () = writing => {}
            _ = reading => {}
        }
        let took = start.elapsed();
        assert!(
            (Duration::from_secs(4)..TIMEOUT).contains(&took),
            "{scheme}: {took:?}"
        );
        assert_eq!(daemon.closed("header_timeout").await, 1.0, "{scheme}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_handshake_that_is_not_completed_times_out() {
    let daemon = LimitedDaemon::serve("https", "");
    let stream = TcpStream::connect(daemon.address).await.unwrap();
    let start = Instant::now();
    read_to_close(&mut (Box::new(stream) as Connection)).await;
    assert!(start.elapsed() > Duration::from_secs(4));
    assert_eq!(daemon.closed("handshake_timeout").await, 1.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slow_body_times_out() {
    for scheme in ["http", "https"] {
        let daemon = LimitedDaemon::serve(scheme, "");
        let (address, token) = (daemon.address, &daemon.token);
        // It would take more than a minute.
        let head = format!(
            "POST /api/cmd/a/step HTTP/1.1\r\nHost: {address}\r\nAuthorization: Bearer {token}\r\n\
             Content-Length: 200\r\n\r\n"
        );
        let mut stream = daemon.connect().await;
        stream.write_all(head.as_bytes()).await.unwrap();
        let (mut reader, mut writer) = tokio::io::split(stream);
        let writing = tokio::spawn(async move {
            for _ in 0..200 {
                if writer.write_all(b" ").await.is_err() || writer.flush().await.is_err() {
                    break;
                }
                sleep(Duration::from_millis(500)).await;
            }
        });
        let mut answer = vec![0; 12];
        let read = timeout(TIMEOUT, reader.read_exact(&mut answer)).await;
        read.expect("it is still open").unwrap();
        assert_eq!(answer, b"HTTP/1.1 408", "{scheme}");
        assert_eq!(daemon.closed("body_timeout").await, 1.0, "{scheme}");
        writing.abort();
    }
}
