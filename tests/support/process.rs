//! A daemon in a process of its own, whose memory and processor time can be measured.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use tempfile::TempDir;

use crate::support::TIMEOUT;
use crate::support::programs::program;

/// A process that ends when the test does, and its data with it.
pub struct Process(
    pub Child,
    #[expect(dead_code, reason = "held for its end")] pub TempDir,
);

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A daemon with these arguments, not yet started. Its program is the one that the environment's
/// `JOSTLED` names, such as that of a wheel, or else the one that Cargo built with this test.
pub fn jostled(arguments: &[&str]) -> Command {
    let named = std::env::var_os("JOSTLED");
    let mut command = Command::new(named.unwrap_or_else(|| program("jostled").into()));
    command
        .env_remove("JOSTLED")
        .args(arguments)
        // The usual port may be taken.
        .env("JOSTLED_HTTP", "")
        .stdin(Stdio::null())
        .stderr(Stdio::null());
    command
}

impl Process {
    /// Starts a daemon. Returns its endpoint.
    pub fn serve() -> (Self, String) {
        Self::start(&mut jostled(&SERVE), tempfile::tempdir().unwrap())
    }

    /// Starts a daemon that fails at these points.
    pub fn serve_failing(points: &str) -> (Self, String) {
        let folder = tempfile::tempdir().unwrap();
        Self::start(jostled(&SERVE).env("FAILPOINTS", points), folder)
    }

    /// Starts a process that is not a daemon.
    pub fn of(command: &mut Command) -> Self {
        Process(command.spawn().unwrap(), tempfile::tempdir().unwrap())
    }

    /// Starts a daemon on the data of an earlier one.
    pub fn start(command: &mut Command, folder: TempDir) -> (Self, String) {
        let command = command.arg("--data-dir").arg(folder.path());
        let mut process = Process(command.stdout(Stdio::piped()).spawn().unwrap(), folder);
        let mut line = String::new();
        let output = process.0.stdout.take().unwrap();
        BufReader::new(output).read_line(&mut line).unwrap();
        let endpoint = line.trim().strip_prefix("listening on ").unwrap();
        (process, endpoint.to_owned())
    }

    pub fn signal(&self, signal: &str) {
        send_signal(self.0.id(), signal);
    }

    /// Waits until it ends. Returns the exit code and how long that took.
    pub fn end(&mut self) -> (Option<i32>, Duration) {
        let began = Instant::now();
        loop {
            if let Some(status) = self.0.try_wait().unwrap() {
                return (status.code(), began.elapsed());
            }
            assert!(began.elapsed() < TIMEOUT, "it does not end");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Its resident memory.
    pub fn resident_bytes(&self) -> u64 {
        let path = format!("/proc/{}/statm", self.0.id());
        let statm = std::fs::read_to_string(path).unwrap();
        let pages: u64 = statm.split(' ').nth(1).unwrap().parse().unwrap();
        pages * 4096
    }
}

const SERVE: [&str; 5] = ["serve", "--listen", "tcp/127.0.0.1:0", "--node", "test"];

/// Sends a signal to a process. After `-STOP` it waits until all threads of the process have stopped:
/// the kernel stops them after the signal is sent.
pub fn send_signal(id: u32, signal: &str) {
    let id = id.to_string();
    let sent = Command::new("kill").args([signal, &id]).status().unwrap();
    assert!(sent.success());
    if signal != "-STOP" {
        return;
    }
    let threads = std::path::Path::new("/proc").join(&id).join("task");
    let is_stopped = |thread: std::io::Result<std::fs::DirEntry>| {
        // The state follows the name, which is in parentheses.
        let stat = std::fs::read_to_string(thread.unwrap().path().join("stat"));
        stat.is_ok_and(|stat| stat.rsplit(')').next().unwrap().starts_with(" T"))
    };
    let began = Instant::now();
    while !std::fs::read_dir(&threads).unwrap().all(is_stopped) {
        assert!(
            began.elapsed() < Duration::from_secs(30),
            "it runs after SIGSTOP"
        );
        std::thread::sleep(Duration::from_millis(1));
    }
}
