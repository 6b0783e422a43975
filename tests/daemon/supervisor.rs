//! What a supervisor such as systemd is told, over a socket as it makes one.

use std::os::unix::net::UnixDatagram;
use std::time::{Duration, Instant};

use serde_json::json;
use tempfile::TempDir;

use crate::apart::{Process, jostled};
use crate::support::{Client, PATIENCE, alone, beside_others};

/// Listens to a daemon, in the place of systemd.
struct Supervisor {
    socket: UnixDatagram,
    folder: TempDir,
}

impl Supervisor {
    fn listen() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let socket = UnixDatagram::bind(folder.path().join("notify")).unwrap();
        socket.set_read_timeout(Some(PATIENCE)).unwrap();
        Supervisor { socket, folder }
    }

    /// Starts a daemon that is to be heard from within `watchdog`, and that fails at these points.
    fn start(&self, watchdog: Option<Duration>, points: &str) -> (Process, String) {
        let mut command = jostled(&["serve", "--listen", "tcp/127.0.0.1:0", "--node", "test"]);
        command
            .env("NOTIFY_SOCKET", self.folder.path().join("notify"))
            .env("FAILPOINTS", points);
        if let Some(watchdog) = watchdog {
            command.env("WATCHDOG_USEC", watchdog.as_micros().to_string());
        }
        Process::start(&mut command, tempfile::tempdir().unwrap())
    }

    /// What the daemon says next.
    fn hear(&self) -> String {
        let mut message = [0; 4096];
        let length = self.socket.recv(&mut message).unwrap();
        String::from_utf8(message[..length].to_vec()).unwrap()
    }

    /// Hears on until a message starts like this, and tells what came before.
    fn hear_until(&self, start: &str) -> Vec<String> {
        let mut before = Vec::new();
        let deadline = Instant::now() + PATIENCE;
        loop {
            let message = self.hear();
            if message.starts_with(start) {
                return before;
            }
            before.push(message);
            assert!(Instant::now() < deadline, "no {start} in {before:?}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn it_is_ready_when_it_serves_feeds_the_watchdog_in_time_and_says_that_it_stops() {
    let _alone = alone().await;
    let supervisor = Supervisor::listen();
    let watchdog = Duration::from_secs(1);
    let (mut daemon, endpoint) = supervisor.start(Some(watchdog), "");
    assert_eq!(supervisor.hear(), "READY=1\n");
    assert_eq!(supervisor.hear(), "WATCHDOG=1\n");
    assert_eq!(supervisor.hear(), "STATUS=0 swarms, healthy\n");
    let began = Instant::now();
    for _ in 0..4 {
        let asked = Instant::now();
        assert_eq!(supervisor.hear(), "WATCHDOG=1\n");
        assert!(asked.elapsed() < watchdog, "{:?}", asked.elapsed());
    }
    let took = began.elapsed();
    println!("fed four times in {took:?}");
    assert!(took > Duration::from_millis(1900), "{took:?}");
    let client = Client::open(&endpoint).await;
    client.create("a", json!({"n": 5})).await;
    supervisor.hear_until("STATUS=1 swarm, healthy\n");
    daemon.signal("-TERM");
    let before = supervisor.hear_until("STOPPING=1\n");
    assert!(before.iter().all(|it| it == "WATCHDOG=1\n"), "{before:?}");
    assert_eq!(daemon.end().0, Some(0));
    supervisor.socket.set_nonblocking(true).unwrap();
    assert!(supervisor.socket.recv(&mut [0; 1]).is_err(), "the end");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_watchdog_starves_while_a_swarm_is_stuck() {
    let _machine = beside_others().await;
    let supervisor = Supervisor::listen();
    let stuck = "step=3*off->1*sleep(9000)->off";
    let (_daemon, endpoint) = supervisor.start(Some(Duration::from_millis(400)), stuck);
    let client = Client::open(&endpoint).await;
    client.create("a", json!({"n": 5})).await;
    client.ok("a", "run", json!({"rate": null})).await;
    let before = supervisor.hear_until("STATUS=1 swarm, unhealthy: swarm a");
    assert!(before.iter().any(|it| it == "WATCHDOG=1\n"), "{before:?}");
    let meanwhile = supervisor.hear_until("STATUS=1 swarm, healthy");
    let fed = meanwhile.iter().filter(|it| *it == "WATCHDOG=1\n").count();
    // The watchdog message is sent before the status.
    assert!(fed <= 1, "{meanwhile:?}");
    supervisor.hear_until("WATCHDOG=1\n");
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_watchdog_it_is_ready_all_the_same_and_feeds_nobody() {
    let _machine = beside_others().await;
    let supervisor = Supervisor::listen();
    let (mut daemon, _) = supervisor.start(None, "");
    assert_eq!(supervisor.hear(), "READY=1\n");
    assert_eq!(supervisor.hear(), "STATUS=0 swarms, healthy\n");
    daemon.signal("-TERM");
    assert_eq!(supervisor.hear(), "STOPPING=1\n");
    assert_eq!(daemon.end().0, Some(0));
}
