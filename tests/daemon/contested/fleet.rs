//! The daemons, routers and connections that the tests of contested names start and cut.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread;

use serde_json::json;
use tempfile::TempDir;
use zenoh::Session;

use super::create;
use crate::harness::free_ports;
use crate::support::Client;
use crate::support::daemon_process::{DaemonProcess, StoreCopy};
use crate::support::process::{Process, jostled, send_signal};
use crate::support::programs::program;

/// The environment variable with the endpoints that the router connects to.
pub const ROUTER: &str = "JOSTLE_TEST_ROUTER_CONNECTS_TO";

/// A session that is a router, as zenohd is one.
pub async fn as_router(connect: &[&str], listen: &[&str]) -> Session {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", json!("router")),
        ("connect/endpoints", json!(connect)),
        ("connect/exit_on_failure", json!(false)),
        (
            "connect/retry",
            json!({"period_init_ms": 100, "period_max_ms": 200, "period_increase_factor": 2}),
        ),
        ("listen/endpoints", json!(listen)),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/delay", json!(0)),
        ("adminspace/enabled", json!(false)),
    ] {
        config.insert_json5(key, &value.to_string()).unwrap();
    }
    zenoh::open(config).await.unwrap()
}

/// A router, which ends with the test.
pub struct Router(
    #[expect(dead_code, reason = "held for its end")] Process,
    pub String,
);

impl Router {
    pub fn connected_to(endpoints: &[&str]) -> Self {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command
            .args(["--exact", "contested::a_router_process", "--nocapture"])
            .env(ROUTER, endpoints.join(","))
            .stdout(Stdio::piped());
        let mut process = Process::of(&mut command);
        let lines = BufReader::new(process.0.stdout.take().unwrap()).lines();
        let mut lines = lines.map_while(Result::ok);
        let endpoint = lines.find_map(|it| it.strip_prefix("router on ").map(str::to_owned));
        // Drain its output, so that a full pipe does not block it.
        thread::spawn(move || lines.for_each(drop));
        Router(process, endpoint.unwrap())
    }
}

/// The node name, endpoint and data folder of a daemon across restarts.
pub struct RestartableDaemon {
    pub node: &'static str,
    pub endpoint: String,
    pub folder: TempDir,
}

impl RestartableDaemon {
    pub fn new(node: &'static str) -> Self {
        let [port] = free_ports("127.0.0.1");
        RestartableDaemon {
            node,
            endpoint: format!("tcp/127.0.0.1:{port}"),
            folder: tempfile::tempdir().unwrap(),
        }
    }

    pub fn start(&self) -> DaemonProcess {
        self.start_failing("")
    }

    /// Starts it, and it fails at these points.
    pub fn start_failing(&self, points: &str) -> DaemonProcess {
        let log = self.folder.path().join("log");
        let log = File::options().create(true).append(true).open(log).unwrap();
        let mut command = jostled(&["serve", "--listen", &self.endpoint, "--node", self.node]);
        command
            .arg("--data-dir")
            .arg(self.folder.path())
            .env("FAILPOINTS", points)
            .stderr(log);
        DaemonProcess::start(&mut command).unwrap()
    }

    /// Creates swarms that the next run recovers.
    pub async fn prepare(&self, swarms: &[&str]) {
        let mut process = self.start();
        let client = Client::open(&self.endpoint).await;
        for swarm in swarms {
            create(&client, self.node, swarm).await.unwrap();
        }
        client.session.close().await.unwrap();
        process.stop();
        process.end();
    }

    /// How often each of these is in the journal of a swarm, once the daemon has ended.
    pub fn executed(&self, swarm: &str, ids: &[String]) -> BTreeMap<String, usize> {
        let rows = StoreCopy::of(self.folder.path()).rows(swarm, 0);
        // Text in CBOR: its length, if it is short, then its bytes.
        let count = |id: &String| {
            assert!(id.len() < 24, "{id}");
            let text = [&[0x60 + u8::try_from(id.len()).unwrap()], id.as_bytes()].concat();
            let has = |body: &[u8]| body.windows(text.len()).any(|it| it == text);
            rows.iter().filter(|row| has(&row.body)).count()
        };
        ids.iter().map(|id| (id.clone(), count(id))).collect()
    }
}

/// The command line, beside the daemon; built by the same build.
pub fn jostle(endpoint: &str, arguments: &[&str]) -> (Option<i32>, String) {
    let mut command = Command::new(program("jostle"));
    let output = command
        .args(["-e", endpoint])
        .args(arguments)
        .output()
        .unwrap();
    let text = [output.stdout, output.stderr].concat();
    (output.status.code(), String::from_utf8(text).unwrap())
}

pub fn signal(process: &DaemonProcess, signal: &str) {
    send_signal(process.child.id(), signal);
}

/// Forwards connections to a daemon until it is cut.
pub struct CuttableProxy {
    pub endpoint: String,
    open: Arc<Mutex<Option<Vec<TcpStream>>>>,
}

impl CuttableProxy {
    pub fn to(endpoint: &str) -> Self {
        let target: SocketAddr = endpoint.strip_prefix("tcp/").unwrap().parse().unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let endpoint = format!("tcp/{}", listener.local_addr().unwrap());
        let open = Arc::new(Mutex::new(Some(Vec::new())));
        let connections = open.clone();
        thread::spawn(move || {
            for from in listener.incoming().map_while(Result::ok) {
                let mut connections = connections.lock().unwrap();
                let (Some(open), Ok(to)) = (connections.as_mut(), TcpStream::connect(target))
                else {
                    continue;
                };
                for (from, to) in [(&from, &to), (&to, &from)] {
                    let (mut from, mut to) = (from.try_clone().unwrap(), to.try_clone().unwrap());
                    open.push(from.try_clone().unwrap());
                    thread::spawn(move || {
                        let _ = std::io::copy(&mut from, &mut to);
                        let _ = to.shutdown(Shutdown::Both);
                    });
                }
            }
        });
        CuttableProxy { endpoint, open }
    }

    pub fn cut(&self) {
        for stream in self.open.lock().unwrap().take().unwrap() {
            let _ = stream.shutdown(Shutdown::Both);
        }
    }

    pub fn heal(&self) {
        *self.open.lock().unwrap() = Some(Vec::new());
    }
}
