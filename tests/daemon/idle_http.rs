//! Idle and slow HTTP connections: they are closed, and do not keep other clients out.

use std::io::{BufRead, BufReader, ErrorKind};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use futures_util::{SinkExt, StreamExt};
use jostle_proto::Role;
use jostled::auth::folder::Folder;
use jostled::auth::issue;
use rustix::process::{Pid, Resource, Rlimit, prlimit};
use tempfile::TempDir;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::{sleep, timeout};
use tokio_tungstenite::tungstenite::Message;

use crate::apart::Process;
use crate::page::tab;
use crate::rights::secrets::connect_tls;
use crate::support::{Client, NODE, PATIENCE, alone, beside_others, until};

/// The descriptor limit of the daemon: it keeps a quarter of them as HTTP connections.
const DESCRIPTORS: usize = 512;

/// The first connections of the flood: more than the daemon has descriptors.
const FLOOD: usize = 600;

/// The maximum response time of `/healthz` during the flood.
const HEALTHZ_TIMEOUT: Duration = Duration::from_secs(5);

/// The maximum time of `jostle status` during the flood, from the start of its process to its end.
const STATUS_TIMEOUT: Duration = Duration::from_secs(1);

/// The time without progress after which a write is taken to be blocked.
const WRITE_TIMEOUT: Duration = Duration::from_millis(500);

/// A connection over TCP or TLS.
trait Duplex: AsyncRead + AsyncWrite + Send + Unpin {}

impl<T: AsyncRead + AsyncWrite + Send + Unpin> Duplex for T {}

type Connection = Box<dyn Duplex>;

/// A daemon process with few descriptors, which hosts the swarm `a`.
struct Few {
    process: Process,
    /// Where it listens for zenoh: over TLS, if it serves HTTP over TLS.
    endpoint: String,
    /// Where it serves HTTP.
    address: SocketAddr,
    /// The token of an operator, or of the page.
    token: String,
    /// The folder of people, if it serves HTTP over TLS.
    people: Option<Folder>,
    _auth: TempDir,
}

impl Few {
    fn serve(scheme: &str, failpoints: &str) -> Self {
        let (data, auth) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let is_secure = scheme == "https";
        let protocol = if is_secure { "tls" } else { "tcp" };
        let mut command = Command::new("sh");
        command
            .args([
                "-c",
                &format!("ulimit -n {DESCRIPTORS} && exec \"$0\" \"$@\""),
            ])
            .arg(env!("CARGO_BIN_EXE_jostled"))
            .args(["--listen", &format!("{protocol}/127.0.0.1:0")])
            .args(["--node", NODE, "--data-dir"])
            .arg(data.path())
            .args(["--http", &format!("{scheme}://127.0.0.1:0")]);
        let people = is_secure.then(|| {
            let folder = Folder::at(auth.path().join("auth"));
            let operator = [("olga".to_owned(), Role::Operator)];
            issue::init(&folder, &[], &operator).unwrap();
            command.arg("--auth-dir").arg(folder.path());
            folder
        });
        command
            .env("FAILPOINTS", failpoints)
            .stdin(Stdio::null())
            .stderr(Stdio::null())
            .stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let mut after = |start: &str| {
            let mut found = lines.by_ref().map(Result::unwrap);
            found.find_map(|line| Some(line.strip_prefix(start)?.to_owned()))
        };
        let endpoint = after("listening on ").unwrap();
        let address = after(&format!("http on {scheme}://")).unwrap();
        let token = match &people {
            Some(folder) => folder.credentials("olga").unwrap().token,
            None => std::fs::read_to_string(data.path().join("page-token")).unwrap(),
        };
        let few = Few {
            process: Process(child, data),
            endpoint,
            address: address.parse().unwrap(),
            token: token.trim().to_owned(),
            people,
            _auth: auth,
        };
        let created = few.jostle(&["create", "a", "--n", "3"]);
        assert!(created.status.success(), "{created:?}");
        few
    }

    /// Runs the command line.
    fn jostle(&self, arguments: &[&str]) -> Output {
        let jostle = Path::new(env!("CARGO_BIN_EXE_jostled")).with_file_name("jostle");
        assert!(
            jostle.exists(),
            "missing: cargo build --release --workspace"
        );
        let mut command = Command::new(jostle);
        if let Some(folder) = &self.people {
            command.arg("--credentials").arg(folder.of("olga"));
        }
        let command = command.args(["-e", &self.endpoint]).args(arguments);
        command.stdin(Stdio::null()).output().unwrap()
    }

    async fn connect(&self) -> Connection {
        match &self.people {
            Some(folder) => Box::new(connect_tls(self.address, folder).await.unwrap()),
            None => Box::new(TcpStream::connect(self.address).await.unwrap()),
        }
    }

    /// The status and body of a `GET` of an operator.
    async fn get(&self, path: &str) -> (u16, String) {
        let (address, token) = (self.address, &self.token);
        let request = format!(
            "GET {path} HTTP/1.1\r\nHost: {address}\r\nAuthorization: Bearer {token}\r\n\
             Connection: close\r\n\r\n"
        );
        let mut stream = self.connect().await;
        stream.write_all(request.as_bytes()).await.unwrap();
        let answer = read_to_close(&mut stream).await;
        let status = answer.split(' ').nth(1).unwrap().parse().unwrap();
        let (_, body) = answer.split_once("\r\n\r\n").unwrap();
        (status, body.to_owned())
    }

    /// The value of a metric.
    async fn metric(&self, name: &str) -> f64 {
        let (status, text) = self.get("/metrics").await;
        assert_eq!(status, 200, "{text}");
        let line = text.lines().find_map(|line| line.strip_prefix(name));
        let line = line.unwrap_or_else(|| panic!("no {name}: {text}"));
        line.trim().parse().unwrap()
    }

    /// The connections that the daemon has closed for a reason.
    async fn closed(&self, reason: &str) -> f64 {
        let name = format!("jostle_http_closed_total{{reason=\"{reason}\"}}");
        self.metric(&name).await
    }

    /// A connection that sends half a header.
    async fn half_header(&self) -> Connection {
        let mut stream = self.connect().await;
        // An error if it is evicted already.
        let _ = stream.write_all(b"GET /healthz HTTP/1.1\r\nHost: ").await;
        let _ = stream.flush().await;
        stream
    }

    /// Sends requests until a write fails, or `None` once one blocks, and reads no response.
    async fn write_until_error(&self, stream: &mut Connection) -> Option<ErrorKind> {
        let address = self.address;
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
    async fn worst(&self, more: impl AsyncFn() -> Connection) -> (Duration, Duration) {
        let (mut flood, mut worst) = (Vec::new(), (Duration::ZERO, Duration::ZERO));
        for attempt in 0..20 {
            for _ in 0..10 {
                flood.push(more().await);
            }
            let start = Instant::now();
            let answer = timeout(HEALTHZ_TIMEOUT, self.get("/healthz")).await;
            assert_eq!(answer.expect("no response in time").0, 200, "{attempt}");
            worst.0 = worst.0.max(start.elapsed());
            let start = Instant::now();
            let status = self.jostle(&["status", "a"]);
            worst.1 = worst.1.max(start.elapsed());
            assert!(status.status.success(), "{attempt}: {status:?}");
        }
        worst
    }
}

/// Reads until the daemon closes the connection.
async fn read_to_close(stream: &mut Connection) -> String {
    let mut answer = Vec::new();
    let reading = async {
        let mut piece = [0; 1024];
        loop {
            match stream.read(&mut piece).await {
                Ok(0) => break,
                Ok(length) => answer.extend_from_slice(&piece[..length]),
                // Over TLS the daemon closes without a close_notify alert.
                Err(error) => {
                    let expected = [ErrorKind::ConnectionReset, ErrorKind::UnexpectedEof];
                    assert!(expected.contains(&error.kind()), "{error}");
                    break;
                }
            }
        }
    };
    timeout(PATIENCE, reading).await.expect("it is still open");
    String::from_utf8(answer).unwrap()
}

/// A flood of half headers, beside a connection whose client reads nothing.
async fn flood_of_half_headers(daemon: &Few) {
    let mut unread = daemon.connect().await;
    assert_eq!(daemon.write_until_error(&mut unread).await, None);
    let mut flood = Vec::new();
    for _ in 0..FLOOD {
        flood.push(daemon.half_header().await);
    }
    let (healthz, status) = daemon.worst(async || daemon.half_header().await).await;
    println!("worst of 20: healthz {healthz:?}, jostle status {status:?}");
    assert!(healthz < HEALTHZ_TIMEOUT, "{healthz:?}");
    assert!(status < STATUS_TIMEOUT, "{status:?}");
    // The connection whose client reads nothing was evicted: its next write does not block.
    let error = daemon.write_until_error(&mut unread).await;
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
    let _alone = alone().await;
    let daemon = Few::serve("http", "");
    let mut socket = tab(&daemon.address.to_string(), "/api/ws").await;
    flood_of_half_headers(&daemon).await;
    socket.send(Message::Ping("flood".into())).await.unwrap();
    let pong =
        async { while !matches!(socket.next().await.unwrap().unwrap(), Message::Pong(_)) {} };
    timeout(PATIENCE, pong)
        .await
        .expect("the WebSocket is open");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_of_half_headers_over_tls_keeps_no_client_out() {
    let _alone = alone().await;
    flood_of_half_headers(&Few::serve("https", "")).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_of_unfinished_handshakes_keeps_no_client_out() {
    let _alone = alone().await;
    let daemon = Few::serve("https", "");
    let began = Instant::now();
    let silent = async || Box::new(TcpStream::connect(daemon.address).await.unwrap()) as Connection;
    let mut flood = Vec::new();
    for _ in 0..FLOOD {
        flood.push(silent().await);
    }
    let (healthz, status) = daemon.worst(&silent).await;
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

#[tokio::test(flavor = "multi_thread")]
async fn without_a_free_descriptor_a_connection_waits_and_is_served() {
    let _machine = beside_others().await;
    let daemon = Few::serve("http", "");
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
    // All that are free now are above the limit.
    limit(3);
    let mut waiting = std::pin::pin!(daemon.get("/healthz"));
    let early = timeout(Duration::from_millis(500), waiting.as_mut()).await;
    assert!(early.is_err(), "{early:?}");
    limit(DESCRIPTORS as u64);
    assert_eq!(timeout(PATIENCE, waiting).await.unwrap().0, 200);
    // One try each 100 ms.
    let failed = daemon.metric(failures).await;
    assert!((2.0..20.0).contains(&failed), "{failed}");
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
    let _machine = beside_others().await;
    for scheme in ["http", "https"] {
        let daemon = Few::serve(scheme, "");
        let mut stream = daemon.half_header().await;
        let start = Instant::now();
        read_to_close(&mut stream).await;
        assert!(start.elapsed() > Duration::from_secs(4), "{scheme}");
        assert_eq!(daemon.closed("header_timeout").await, 1.0, "{scheme}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_header_that_comes_byte_by_byte_times_out() {
    let _machine = beside_others().await;
    for scheme in ["http", "https"] {
        let daemon = Few::serve(scheme, "");
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
            (Duration::from_secs(4)..PATIENCE).contains(&took),
            "{scheme}: {took:?}"
        );
        assert_eq!(daemon.closed("header_timeout").await, 1.0, "{scheme}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_handshake_that_is_not_completed_times_out() {
    let _machine = beside_others().await;
    let daemon = Few::serve("https", "");
    let stream = TcpStream::connect(daemon.address).await.unwrap();
    let start = Instant::now();
    read_to_close(&mut (Box::new(stream) as Connection)).await;
    assert!(start.elapsed() > Duration::from_secs(4));
    assert_eq!(daemon.closed("handshake_timeout").await, 1.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slow_body_times_out() {
    let _machine = beside_others().await;
    for scheme in ["http", "https"] {
        let daemon = Few::serve(scheme, "");
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
        let read = timeout(PATIENCE, reader.read_exact(&mut answer)).await;
        read.expect("it is still open").unwrap();
        assert_eq!(answer, b"HTTP/1.1 408", "{scheme}");
        assert_eq!(daemon.closed("body_timeout").await, 1.0, "{scheme}");
        writing.abort();
    }
}
