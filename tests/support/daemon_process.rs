//! Daemon processes that use one data folder after each other.

use std::fs::{self, File};
use std::io::{BufRead, BufReader};
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use jostled::store::{Row, Settings, Store};

use super::process::jostled;
use crate::support::{Client, TIMEOUT};

/// A daemon from its start to its end; it is killed when dropped.
pub struct DaemonProcess {
    pub child: Child,
    pub endpoint: String,
    /// From its start to the line with its endpoint.
    pub took: Duration,
}

impl Drop for DaemonProcess {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A daemon on `folder`, not yet started. Its log is a file there.
pub fn daemon(folder: &Path) -> Command {
    let mut command = jostled(&["serve", "--listen", "tcp/127.0.0.1:0", "--node", "test"]);
    let log = folder.join("log");
    let log = File::options().create(true).append(true).open(log).unwrap();
    command.arg("--data-dir").arg(folder).stderr(log);
    command
}

impl DaemonProcess {
    /// Starts a daemon; `None` with its exit code if it ends before it listens.
    pub fn start(command: &mut Command) -> Result<DaemonProcess, Option<i32>> {
        let began = Instant::now();
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        let output = child.stdout.take().unwrap();
        BufReader::new(output).read_line(&mut line).unwrap();
        match line.trim().strip_prefix("listening on ") {
            Some(endpoint) => Ok(DaemonProcess {
                child,
                endpoint: endpoint.to_owned(),
                took: began.elapsed(),
            }),
            None => Err(code(child.wait().unwrap())),
        }
    }

    /// Kills it.
    pub fn kill(&mut self) {
        let _ = self.child.kill();
        self.child.wait().unwrap();
    }

    /// The number of its threads.
    pub fn threads(&self) -> usize {
        let tasks = format!("/proc/{}/task", self.child.id());
        fs::read_dir(tasks).unwrap().count()
    }

    /// Sends SIGTERM.
    pub fn stop(&self) {
        let pid = self.child.id().to_string();
        let signalled = Command::new("kill").args(["-TERM", &pid]).status();
        assert!(signalled.unwrap().success());
    }

    /// Waits until it ends. Returns its exit code; `None` if it was killed.
    pub fn end(&mut self) -> Option<i32> {
        let began = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return code(status);
            }
            assert!(began.elapsed() < TIMEOUT, "it does not end");
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

/// The exit code; `None` if the daemon was killed. No test sends another signal that ends a daemon:
/// one that ends by it has crashed.
fn code(status: ExitStatus) -> Option<i32> {
    const SIGKILL: i32 = 9;
    assert!(
        status.signal().is_none_or(|signal| signal == SIGKILL),
        "the daemon crashed: {status}"
    );
    status.code()
}

/// Starts a daemon on a folder, and a client of it.
pub async fn start(folder: &Path) -> (DaemonProcess, Client) {
    let process = DaemonProcess::start(&mut daemon(folder)).unwrap();
    let client = Client::open(&process.endpoint).await;
    (process, client)
}

/// Kills a daemon, and starts one on the same folder.
pub async fn killed(
    folder: &Path,
    (mut process, client): (DaemonProcess, Client),
) -> (DaemonProcess, Client) {
    process.kill();
    drop(client);
    start(folder).await
}

/// The log of the daemons on `folder`.
pub fn log(folder: &Path) -> String {
    fs::read_to_string(folder.join("log")).unwrap_or_default()
}

/// Copies a folder with all that it contains.
pub fn copy_all(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let to = to.join(entry.file_name());
        match entry.path().is_dir() {
            true => copy_all(&entry.path(), &to),
            false => drop(fs::copy(entry.path(), to).unwrap()),
        }
    }
}

/// Copies the database and its WAL as they are.
pub fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for suffix in ["-shm", "-wal", ""] {
        let name = format!("jostle.sqlite{suffix}");
        let _ = fs::remove_file(to.join(&name));
        if suffix != "-shm" && from.join(&name).exists() {
            fs::copy(from.join(&name), to.join(&name)).unwrap();
        }
    }
}

/// The store that a killed daemon left on `folder`: a copy, which does not change the folder.
pub struct StoreCopy(
    Store,
    #[expect(dead_code, reason = "held for its end")] tempfile::TempDir,
);

impl StoreCopy {
    pub fn of(folder: &Path) -> Self {
        let aside = tempfile::tempdir().unwrap();
        copy(folder, aside.path());
        let settings = Settings::default();
        let store = Store::open(aside.path(), settings, Box::new(|_| {})).unwrap();
        StoreCopy(store, aside)
    }

    pub fn rows(&self, swarm: &str, after: u64) -> Vec<Row> {
        let rows = self.0.rows(swarm, after, usize::MAX >> 1).unwrap();
        assert_eq!(rows.damaged_at, None);
        rows.rows
    }

    /// The epoch and the step of the newest checkpoint of a swarm.
    pub fn newest_checkpoint(&self, swarm: &str) -> (u64, u64) {
        let newest = &self.0.checkpoints(swarm).unwrap()[0];
        (newest.epoch, newest.step)
    }
}
