//! Sessions over TLS that read and write at once, and connections that complete no handshake.

use std::io::Read as _;
use std::net::TcpStream;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use jostle_proto::{Role, keys};
use jostled::auth::folder::Folder;
use jostled::auth::issue;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use serde_json::json;
use tempfile::TempDir;
use zenoh::Session;

use super::{SessionCredentials, UserSession};
use crate::support::daemon_process::DaemonProcess;
use crate::support::process::{Process, jostled};
use crate::support::{NODE, PREFIX, TIMEOUT, until, until_within};

/// The time within which a session opens, whatever the connections of others do.
const PROMPT: Duration = Duration::from_secs(2);

/// A daemon process with users, which listens over TLS.
struct TlsDaemon {
    process: DaemonProcess,
    people: Folder,
    _base: TempDir,
}

impl TlsDaemon {
    /// Three operators; the daemon is started with at most this number of descriptors.
    fn start(descriptors: Option<u64>) -> Self {
        let base = tempfile::tempdir().unwrap();
        let people = Folder::new(base.path().join("auth"));
        let operators = ["olga", "otto", "oona"].map(|name| (name.to_owned(), Role::Operator));
        issue::init(&people, &[], &operators).unwrap();
        let mut command = match descriptors {
            None => jostled(&[]),
            Some(limit) => {
                let mut command = Command::new("sh");
                let limited = format!("ulimit -n {limit} && exec \"$0\" \"$@\"");
                command
                    .args(["-c", &limited])
                    .arg(jostled(&[]).get_program());
                command.env("JOSTLED_HTTP", "");
                command
            }
        };
        command
            .args(["serve", "--listen", "tls/127.0.0.1:0", "--node", NODE])
            .arg("--data-dir")
            .arg(base.path().join("data"))
            .arg("--auth-dir")
            .arg(people.path());
        TlsDaemon {
            process: DaemonProcess::start(&mut command).unwrap(),
            people,
            _base: base,
        }
    }

    /// The address of its listener.
    fn address(&self) -> &str {
        self.process.endpoint.strip_prefix("tls/").unwrap()
    }

    /// A new session of an operator, and how long it took to open.
    async fn open(&self, name: &str) -> (UserSession, Duration) {
        let begun = Instant::now();
        let credentials = SessionCredentials::of(&self.people, name);
        let session = credentials.open(&self.process.endpoint).await.unwrap();
        let token = Some(self.people.credentials(name).unwrap().token);
        (UserSession { session, token }, begun.elapsed())
    }

    /// Connections that send nothing.
    fn silent(&self, count: usize) -> Vec<TcpStream> {
        let connect = |_| TcpStream::connect(self.address()).unwrap();
        (0..count).map(connect).collect()
    }

    /// The number of files that it has open.
    fn open_files(&self) -> usize {
        let files = format!("/proc/{}/fd", self.process.child.id());
        std::fs::read_dir(files).unwrap().count()
    }
}

/// Requests states without waiting for them, for some time. Returns how many bytes of states were
/// received, and how many replies were errors.
async fn flood(session: Session, token: String, time: Duration) -> [usize; 2] {
    let received: Arc<[AtomicUsize; 2]> = Arc::default();
    let begun = Instant::now();
    while begun.elapsed() < time {
        for sent in 0..40 {
            let received = received.clone();
            let mut query = session.get(keys::state(PREFIX, "a")).attachment(&token);
            if sent % 4 == 0 {
                // It is rejected, and takes long to decrypt.
                query = query.payload(vec![0; 48 * 1024]);
            }
            let sent = query.timeout(TIMEOUT).callback(move |reply| {
                let (of, count) = match reply.result() {
                    Ok(sample) => (0, sample.payload().len()),
                    Err(_) => (1, 1),
                };
                received[of].fetch_add(count, Ordering::Relaxed);
            });
            sent.await.unwrap();
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    [0, 1].map(|of| received[of].load(Ordering::Relaxed))
}

/// Not a test by itself: the client that [`the_session_of_a_client_that_reads_nothing_is_closed`] starts
/// as a process of its own.
#[tokio::test(flavor = "multi_thread")]
async fn a_subscribing_process() {
    let Ok(endpoint) = std::env::var("JOSTLE_TEST_TLS_ENDPOINT") else {
        return;
    };
    let people = Folder::new(std::env::var("JOSTLE_TEST_TLS_PEOPLE").unwrap().into());
    let credentials = SessionCredentials::of(&people, "otto");
    let session = credentials.open(&endpoint).await.unwrap();
    let states = session.declare_subscriber(keys::state(PREFIX, "a"));
    let states = states.await.unwrap();
    while states.recv_async().await.is_ok() {}
}

/// Its connection is full, so the daemon cannot send what remains.
#[tokio::test(flavor = "multi_thread")]
async fn the_session_of_a_client_that_reads_nothing_is_closed() {
    let daemon = TlsDaemon::start(None);
    let (operator, _) = daemon.open("olga").await;
    let disc = json!({"kind": "disc", "radius": 500});
    let spec = json!({"n": 2000, "rate": null, "publish_every": 1, "start": disc});
    operator
        .node_cmd("create", json!({"name": "a", "spec": spec}))
        .await;
    operator.cmd("a", "run", json!({})).await;
    let mut command = Command::new(std::env::current_exe().unwrap());
    command
        .args(["--exact", "rights::tls::a_subscribing_process"])
        .env("JOSTLE_TEST_TLS_ENDPOINT", &daemon.process.endpoint)
        .env("JOSTLE_TEST_TLS_PEOPLE", daemon.people.path())
        .stdout(Stdio::null());
    let subscriber = Process::of(&mut command);
    let status = keys::node_get(PREFIX, NODE, "status");
    let clients = async || operator.ok(&status, None).await["result"]["clients"].clone();
    until("the subscriber", async || clients().await == 2).await;
    subscriber.signal("-STOP");
    // Sooner than a close that waits for the peer, whose default is 10 s.
    let closed = async || clients().await == 1;
    until_within(Duration::from_secs(14), "its session is closed", closed).await;
}

/// A TLS session encrypts its replies on one thread while another decrypts its requests. Without a lock
/// the daemon crashed in four of eleven runs; `tests/architecture/patched.rs` fails without it.
#[tokio::test(flavor = "multi_thread")]
async fn a_flood_of_large_replies_does_not_end_the_daemon() {
    let mut daemon = TlsDaemon::start(None);
    let (operator, _) = daemon.open("olga").await;
    let spec = json!({"n": 2000, "seed": 1, "rate": null});
    operator
        .node_cmd("create", json!({"name": "a", "spec": spec}))
        .await;
    let (mut floods, mut received) = (Vec::new(), 0);
    for name in ["olga", "otto", "oona"] {
        let (user, _) = daemon.open(name).await;
        let token = user.token.clone().unwrap();
        let flood = flood(user.session, token, Duration::from_secs(6));
        floods.push(tokio::spawn(flood));
    }
    for flood in floods {
        let [bytes, errors] = flood.await.unwrap();
        println!("{bytes} bytes of states, {errors} errors");
        received += bytes;
    }
    let ended = daemon.process.child.try_wait().unwrap();
    assert!(ended.is_none(), "the daemon ended: {ended:?}");
    assert!(received > 1 << 20, "nothing was measured: {received} bytes");
    let (user, _) = daemon.open("otto").await;
    let hello = keys::node_get(PREFIX, NODE, "hello");
    user.ok(&hello, None).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn connections_that_are_closed_again_delay_no_session() {
    let daemon = TlsDaemon::start(None);
    let (_, alone) = daemon.open("olga").await;
    drop(daemon.silent(400));
    let (_, took) = daemon.open("otto").await;
    println!("{took:?}, {alone:?} before");
    assert!(took < PROMPT, "{took:?}, {alone:?} before");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_handshake_that_is_not_completed_times_out() {
    let daemon = TlsDaemon::start(None);
    let begun = Instant::now();
    let [mut silent] = <[TcpStream; 1]>::try_from(daemon.silent(1)).unwrap();
    silent.set_read_timeout(Some(TIMEOUT)).unwrap();
    let ended = silent.read(&mut [0]);
    let took = begun.elapsed();
    assert!(matches!(ended, Ok(0)), "{ended:?}");
    // Two seconds, and the delays of a busy machine.
    let expected = Duration::from_millis(1900)..Duration::from_secs(8);
    assert!(expected.contains(&took), "{took:?}");
}

/// A thousand handshakes may be in progress; for each further one the oldest is ended.
#[tokio::test(flavor = "multi_thread")]
async fn handshakes_in_progress_are_bounded() {
    let limit = getrlimit(Resource::Nofile);
    let raised = Rlimit {
        current: limit.maximum,
        ..limit
    };
    setrlimit(Resource::Nofile, raised).unwrap();
    let daemon = TlsDaemon::start(None);
    let before = daemon.open_files();
    let silent = daemon.silent(1500);
    // A session opens once those before it have been accepted.
    let (user, took) = daemon.open("olga").await;
    let more = daemon.open_files() - before;
    println!("{more} more files, {took:?}");
    assert!(more < 1050, "{more} more files");
    assert!(took < PROMPT, "{took:?}");
    drop((silent, user));
}

/// They are closed although no further connection can be accepted.
#[tokio::test(flavor = "multi_thread")]
async fn silent_connections_that_take_every_descriptor_are_closed() {
    let daemon = TlsDaemon::start(Some(256));
    let silent = daemon.silent(400);
    let (user, took) = daemon.open("olga").await;
    println!("{took:?}");
    let hello = keys::node_get(PREFIX, NODE, "hello");
    user.ok(&hello, None).await;
    drop(silent);
}
