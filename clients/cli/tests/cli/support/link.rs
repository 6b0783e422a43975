//! A proxy between a command line and its daemon, which a test can interrupt.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;

/// A proxy between a command line and a daemon.
pub struct Link {
    /// Where the command line connects.
    pub endpoint: String,
    wire: Arc<Wire>,
}

struct Wire {
    daemon: String,
    /// It forwards nothing and accepts no connections.
    is_cut: AtomicBool,
    /// It drops the daemon's replies after the next request.
    loses_answers: AtomicBool,
    /// A request has passed.
    is_mute: AtomicBool,
    streams: Mutex<Vec<TcpStream>>,
    /// What to do when a request with these bytes passes.
    watched: Mutex<Option<Watched>>,
}

struct Watched {
    bytes: Vec<u8>,
    is_met: Arc<AtomicBool>,
    action: Box<dyn Fn() + Send>,
}

impl Link {
    /// A link to the daemon at `endpoint`.
    pub fn to(endpoint: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let wire = Arc::new(Wire {
            daemon: endpoint.strip_prefix("tcp/").unwrap().to_owned(),
            is_cut: AtomicBool::new(false),
            loses_answers: AtomicBool::new(false),
            is_mute: AtomicBool::new(false),
            streams: Mutex::new(Vec::new()),
            watched: Mutex::new(None),
        });
        let address = listener.local_addr().unwrap();
        let accepting = wire.clone();
        thread::spawn(move || {
            for client in listener.incoming() {
                accepting.connect(client.unwrap());
            }
        });
        Link {
            endpoint: format!("tcp/{address}"),
            wire,
        }
    }

    /// Calls `action` once, when a request that contains `bytes` is received, and then forwards the
    /// request. Returns whether that has happened.
    pub fn on(&self, bytes: &[u8], action: impl Fn() + Send + 'static) -> Arc<AtomicBool> {
        let is_met = Arc::new(AtomicBool::new(false));
        *self.wire.watched.lock().unwrap() = Some(Watched {
            bytes: bytes.to_owned(),
            is_met: is_met.clone(),
            action: Box::new(action),
        });
        is_met
    }

    /// Drops the daemon's replies from the next request on, until [`Link::cut`].
    pub fn lose_answers(&self) {
        self.wire.loses_answers.store(true, Ordering::SeqCst);
    }

    /// Closes every connection, like a crash of the daemon.
    pub fn cut(&self) {
        self.wire.is_cut.store(true, Ordering::SeqCst);
        for stream in self.wire.streams.lock().unwrap().drain(..) {
            // It may be closed from the other side already.
            let _ = stream.shutdown(Shutdown::Both);
        }
    }

    /// Accepts connections again.
    pub fn mend(&self) {
        self.wire.loses_answers.store(false, Ordering::SeqCst);
        self.wire.is_mute.store(false, Ordering::SeqCst);
        self.wire.is_cut.store(false, Ordering::SeqCst);
    }
}

impl Wire {
    fn connect(self: &Arc<Self>, client: TcpStream) {
        if self.is_cut.load(Ordering::SeqCst) {
            return;
        }
        let Ok(daemon) = TcpStream::connect(&self.daemon) else {
            return;
        };
        let mut streams = self.streams.lock().unwrap();
        streams.push(client.try_clone().unwrap());
        streams.push(daemon.try_clone().unwrap());
        drop(streams);
        let (requests, answers) = (self.clone(), self.clone());
        let (to_daemon, to_client) = (daemon.try_clone().unwrap(), client.try_clone().unwrap());
        thread::spawn(move || requests.pass_requests(client, to_daemon));
        thread::spawn(move || answers.pass_answers(daemon, to_client));
    }

    fn pass_requests(&self, mut client: TcpStream, mut daemon: TcpStream) {
        const REQUEST: &[u8] = b"request_id";
        // The last bytes, since a request may arrive in two pieces.
        let (mut buffer, mut tail, mut seen) = ([0; 65_536], Vec::new(), Vec::new());
        while let Ok(length @ 1..) = client.read(&mut buffer) {
            tail.extend_from_slice(&buffer[..length]);
            let is_request = tail.windows(REQUEST.len()).any(|window| window == REQUEST);
            if is_request && self.loses_answers.load(Ordering::SeqCst) {
                self.is_mute.store(true, Ordering::SeqCst);
            }
            tail.drain(..tail.len().saturating_sub(REQUEST.len()));
            self.watch(&mut seen, &buffer[..length]);
            if daemon.write_all(&buffer[..length]).is_err() {
                break;
            }
        }
        let _ = daemon.shutdown(Shutdown::Both);
    }

    /// Searches the received bytes, with the previous ones in `seen`, for those of [`Link::on`].
    fn watch(&self, seen: &mut Vec<u8>, more: &[u8]) {
        let watched = self.watched.lock().unwrap();
        let Some(watched) = &*watched else {
            return;
        };
        seen.extend_from_slice(more);
        let length = watched.bytes.len();
        let is_met = seen.windows(length).any(|window| window == watched.bytes);
        seen.drain(..seen.len().saturating_sub(length));
        if is_met && !watched.is_met.swap(true, Ordering::SeqCst) {
            (watched.action)();
        }
    }

    fn pass_answers(&self, mut daemon: TcpStream, mut client: TcpStream) {
        let mut buffer = [0; 65_536];
        while let Ok(length @ 1..) = daemon.read(&mut buffer) {
            let is_lost = self.is_mute.load(Ordering::SeqCst);
            if !is_lost && client.write_all(&buffer[..length]).is_err() {
                break;
            }
        }
        let _ = client.shutdown(Shutdown::Both);
    }
}
