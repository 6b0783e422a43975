//! A daemon in this process, and command lines in child processes.

pub mod canned;
mod impostor;
mod link;
pub mod relay;
mod terminal;

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};

use jostled::app::{self, Server};
use jostled::cli::settings;
use jostled::config::Config;
use serde_json::Value;

pub use self::canned::Canned;
pub use self::impostor::Impostor;
pub use self::link::Link;
pub use self::terminal::Terminal;

/// The timeout of every wait, on a machine busy with other tests.
pub const TIMEOUT: Duration = Duration::from_secs(60);

/// A zenoh session that listens on a port of its own, without scouting.
pub async fn open_peer(mut config: zenoh::Config) -> zenoh::Session {
    for (key, value) in [
        ("listen/endpoints", r#"["tcp/127.0.0.1:0"]"#),
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
    ] {
        config.insert_json5(key, value).unwrap();
    }
    zenoh::open(config).await.unwrap()
}

/// A daemon on a port of its own.
pub struct Daemon {
    /// The daemon.
    pub server: Server,
    /// Where it listens.
    pub endpoint: String,
    folder: tempfile::TempDir,
}

/// A command line that has ended.
#[derive(Debug)]
pub struct Ended {
    /// Its exit code; none if it was killed.
    pub code: Option<i32>,
    /// The rest of its stdout.
    pub stdout: String,
    /// The rest of its stderr.
    pub stderr: String,
}

/// A command line that runs.
pub struct Running {
    line: String,
    child: Child,
    stdout: Option<Receiver<String>>,
    stderr: Receiver<String>,
}

impl Daemon {
    /// Starts a daemon with the settings of tests.
    pub async fn start() -> Self {
        Self::with(&[]).await
    }

    /// A daemon with these settings on top.
    pub async fn with(settings: &[(&str, &str)]) -> Self {
        Self::on(tempfile::tempdir().unwrap(), settings).await
    }

    /// Restarts it with the same data and, if the port is free, the same endpoint.
    pub async fn restart(self) -> Self {
        let Daemon {
            server,
            endpoint,
            folder,
        } = self;
        server.stop().await;
        Self::on(folder, &[("listen", &endpoint)]).await
    }

    async fn on(folder: tempfile::TempDir, settings: &[(&str, &str)]) -> Self {
        let base = [
            ("listen", "tcp/127.0.0.1:0"),
            ("node", "test"),
            ("http", ""),
            ("data_dir", folder.path().to_str().unwrap()),
        ];
        let flags = BTreeMap::from_iter(base.iter().chain(settings).copied());
        let resolved = settings::from_flags(flags).unwrap();
        let server = app::start(&Config::new(&resolved).unwrap()).await.unwrap();
        let endpoint = server.endpoints[0].clone();
        Daemon {
            server,
            endpoint,
            folder,
        }
    }

    /// Its data directory.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Stops it.
    pub async fn stop(self) {
        self.server.stop().await;
    }

    /// Starts a command line.
    pub fn begin(&self, line: &str) -> Running {
        Running::begin(&self.endpoint, line, "")
    }

    /// Runs a command line to its end.
    pub async fn jostle(&self, line: &str) -> Ended {
        self.jostle_with(line, "").await
    }

    /// Runs a command line to its end, with something on stdin.
    pub async fn jostle_with(&self, line: &str, stdin: &str) -> Ended {
        Running::begin(&self.endpoint, line, stdin).end().await
    }

    /// Runs a command line to its end and returns its stdout.
    pub async fn said(&self, line: &str) -> String {
        let ended = self.jostle(line).await;
        assert_eq!(ended.code, Some(0), "{ended:?}");
        ended.stdout
    }

    /// Runs a command line to its end and returns its answer.
    pub async fn reply(&self, line: &str) -> Value {
        object(&self.jostle(&format!("--json {line}")).await)
    }

    /// Runs a command line to its end and returns its error.
    pub async fn refusal(&self, line: &str) -> Value {
        let ended = self.jostle(&format!("--json {line}")).await;
        assert_ne!(ended.code, Some(0), "{ended:?}");
        serde_json::from_str(&ended.stderr).unwrap()
    }

    /// Waits until the daemon records, and returns the recording's name.
    pub async fn until_recording(&self) -> String {
        let mut name = String::new();
        until("the recording has begun", async || {
            let list = self.reply("record --list").await;
            let mut recordings = list["result"]["recordings"].as_array().unwrap().iter();
            let going = recordings.find(|it| it["phase"] == "recording");
            name = going.map_or_else(String::new, |it| {
                it["recording"].as_str().unwrap().to_owned()
            });
            !name.is_empty()
        })
        .await;
        name
    }

    /// Waits until a swarm runs.
    pub async fn until_running(&self, swarm: &str) {
        until("the swarm runs", async || {
            let ended = self.jostle(&format!("--json status {swarm}")).await;
            ended.json_lines()[0]["phase"] == "running"
        })
        .await;
    }
}

impl Ended {
    /// Checks its exit code, and that its stderr contains a text.
    pub fn assert_stderr(&self, code: i32, text: &str) {
        assert_eq!(self.code, Some(code), "{self:?}");
        assert!(self.stderr.contains(text), "no {text:?} in {self:?}");
    }

    /// Each line of the data as JSON.
    pub fn json_lines(&self) -> Vec<Value> {
        let lines = self.stdout.lines();
        lines
            .map(|line| serde_json::from_str(line).unwrap())
            .collect()
    }
}

impl Running {
    /// Starts a command line with this endpoint.
    pub fn begin(endpoint: &str, line: &str, stdin: &str) -> Self {
        Self::begin_on(endpoint, line, stdin, Stdio::piped())
    }

    /// Starts a command line with this endpoint and standard output.
    pub fn begin_on(endpoint: &str, line: &str, stdin: &str, stdout: Stdio) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_jostle"))
            .args(line.split(' '))
            // Not the user that runs the tests.
            .env("USER", "tester")
            .env("JOSTLE_ENDPOINT", endpoint)
            .stdin(Stdio::piped())
            .stdout(stdout)
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut input = child.stdin.take().unwrap();
        input.write_all(stdin.as_bytes()).unwrap();
        let stdout = child.stdout.take().map(lines_of);
        let stderr = lines_of(child.stderr.take().unwrap());
        Running {
            line: line.into(),
            child,
            stdout,
            stderr,
        }
    }

    /// Reads `count` lines of its stdout.
    pub fn lines(&mut self, count: usize) -> Vec<String> {
        let stdout = self.stdout.as_ref().unwrap();
        (0..count)
            .map(|_| stdout.recv_timeout(TIMEOUT).expect(&self.line))
            .collect()
    }

    /// Reads a line of its stderr.
    pub fn complaint(&mut self) -> String {
        self.stderr.recv_timeout(TIMEOUT).expect(&self.line)
    }

    /// Closes the other end of its stdout.
    pub fn stop_reading(&mut self) {
        self.stdout = None;
    }

    /// Presses Ctrl-C.
    pub fn interrupt(&self) {
        self.signal("-INT");
    }

    /// Sends it a signal.
    pub fn signal(&self, signal: &str) {
        let pid = self.child.id().to_string();
        let status = Command::new("kill").args([signal, &pid]).status().unwrap();
        assert!(status.success());
    }

    /// Whether it has not ended yet.
    pub fn is_running(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }

    /// Waits until it ends.
    pub async fn end(mut self) -> Ended {
        let deadline = Instant::now() + TIMEOUT;
        let status = loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                break status;
            }
            if Instant::now() > deadline {
                self.child.kill().unwrap();
                panic!("`jostle {}` does not end", self.line);
            }
            tokio::time::sleep(Duration::from_millis(5)).await;
        };
        Ended {
            code: status.code(),
            stdout: self
                .stdout
                .take()
                .map_or_else(String::new, |lines| rest(&lines)),
            stderr: rest(&self.stderr),
        }
    }
}

impl Drop for Running {
    /// A test that fails leaves no process.
    fn drop(&mut self) {
        if let Ok(None) = self.child.try_wait() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}

/// One object on stdout, exit code 0.
pub fn object(ended: &Ended) -> Value {
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let lines = ended.json_lines();
    assert_eq!(lines.len(), 1, "{ended:?}");
    lines[0].clone()
}

/// The lines of a pipe, read as they come; dropping them closes the pipe at its next line.
fn lines_of(pipe: impl Read + Send + 'static) -> Receiver<String> {
    let (to_read, lines) = channel();
    thread::spawn(move || {
        for line in BufReader::new(pipe).lines() {
            if to_read.send(line.unwrap()).is_err() {
                return;
            }
        }
    });
    lines
}

/// What is left of a pipe whose other end is closed.
fn rest(lines: &Receiver<String>) -> String {
    let lines: Vec<String> = lines.iter().collect();
    lines.join("\n")
}

/// Waits until `holds`, at most [`TIMEOUT`].
pub async fn until(what: &str, mut holds: impl AsyncFnMut() -> bool) {
    let deadline = Instant::now() + TIMEOUT;
    while !holds().await {
        assert!(Instant::now() < deadline, "{what} did not come about");
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}
