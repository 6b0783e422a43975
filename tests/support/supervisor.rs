//! Receives the messages of a daemon to its supervisor, in place of systemd.

use std::os::unix::net::UnixDatagram;
use std::time::{Duration, Instant};

use tempfile::TempDir;

use super::TIMEOUT;
use super::process::{Process, jostled};

/// The socket of a supervisor.
pub struct Supervisor {
    pub socket: UnixDatagram,
    pub folder: TempDir,
}

impl Supervisor {
    pub fn listen() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let socket = UnixDatagram::bind(folder.path().join("notify")).unwrap();
        socket.set_read_timeout(Some(TIMEOUT)).unwrap();
        Supervisor { socket, folder }
    }

    /// Starts a daemon with this watchdog interval, which fails at these points.
    pub fn start(&self, watchdog: Option<Duration>, points: &str) -> (Process, String) {
        let mut command = jostled(&["serve", "--listen", "tcp/127.0.0.1:0", "--node", "test"]);
        command
            .env("NOTIFY_SOCKET", self.folder.path().join("notify"))
            .env("FAILPOINTS", points);
        if let Some(watchdog) = watchdog {
            command.env("WATCHDOG_USEC", watchdog.as_micros().to_string());
        }
        Process::start(&mut command, tempfile::tempdir().unwrap())
    }

    /// The next message of the daemon.
    pub fn receive(&self) -> String {
        let mut message = [0; 4096];
        let length = self.socket.recv(&mut message).unwrap();
        String::from_utf8(message[..length].to_vec()).unwrap()
    }

    /// Receives until a message starts with `start`. Returns the messages before it.
    pub fn receive_until(&self, start: &str) -> Vec<String> {
        let mut before = Vec::new();
        let deadline = Instant::now() + TIMEOUT;
        loop {
            let message = self.receive();
            if message.starts_with(start) {
                return before;
            }
            before.push(message);
            assert!(Instant::now() < deadline, "no {start} in {before:?}");
        }
    }
}
