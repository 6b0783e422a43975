//! Tries whether the daemon's own listener answers.
//!
//! zenoh's acceptor has been seen to wedge: connections are made, by the kernel, and nobody comes
//! to them. So the probe says what a client says first, and waits for the first word of the
//! answer. It then hangs up: a session never comes about, and nobody is told of one.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs as _};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use fail::fail_point;

use crate::health::Reason;

/// How long the listener may take to answer.
pub const PATIENCE: Duration = Duration::from_secs(2);

/// What a client says first (`InitSyn`), behind its length: the message's number, the version of
/// the protocol, a client with a name of 16 bytes, and the name.
const GREETING: [u8; 21] = *b"\x13\x00\x01\x09\xf2jostle-probe-own";

/// A request over HTTP, to which a listener that speaks TLS replies with an alert.
const HTTP_REQUEST: &[u8] =
    b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";

/// A way to the listener.
pub struct Probe {
    endpoint: String,
    way: Way,
    request: &'static [u8],
}

enum Way {
    Tcp(String),
    Unix(String),
}

/// What the listener was heard to say.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hearing {
    /// How long the last answer took.
    pub secs: Option<f64>,
    /// How often in a row there was none.
    pub failures: u32,
    /// What was wrong the last time, if anything was.
    pub problem: Option<Reason>,
}

impl Hearing {
    /// Notes how a try went.
    pub fn note(&mut self, heard: Result<Duration, Reason>) {
        match heard {
            Ok(took) => {
                *self = Hearing {
                    secs: Some(took.as_secs_f64()),
                    ..Hearing::default()
                };
            }
            Err(problem) => {
                self.failures += 1;
                self.problem = Some(problem);
            }
        }
    }
}

impl Probe {
    /// A way to `endpoint`; none where its protocol is not known here.
    pub fn of(endpoint: &str) -> Option<Self> {
        let (protocol, rest) = endpoint.split_once('/')?;
        let address = rest.split(['?', '#']).next().unwrap_or(rest).to_owned();
        let (way, request): (_, &[u8]) = match protocol {
            // Over TLS this is no greeting, and the answer is that it is none.
            "tcp" | "tls" => (Way::Tcp(address), &GREETING),
            "unixsock-stream" => (Way::Unix(address), &GREETING),
            "http" | "https" => (Way::Tcp(address), HTTP_REQUEST),
            _ => return None,
        };
        Some(Probe {
            endpoint: endpoint.to_owned(),
            way,
            request,
        })
    }

    /// Connects, greets and waits for a word; tells how long it took.
    ///
    /// # Errors
    ///
    /// [`Reason::Deaf`].
    pub fn try_once(&self) -> Result<Duration, Reason> {
        let began = Instant::now();
        let heard = match &self.way {
            Way::Tcp(address) => connect(address).and_then(|mut stream| {
                stream.set_read_timeout(Some(PATIENCE))?;
                stream.set_write_timeout(Some(PATIENCE))?;
                greet(&mut stream, self.request)
            }),
            Way::Unix(path) => UnixStream::connect(path).and_then(|mut stream| {
                stream.set_read_timeout(Some(PATIENCE))?;
                stream.set_write_timeout(Some(PATIENCE))?;
                greet(&mut stream, self.request)
            }),
        };
        heard.map_err(|error| Reason::Deaf {
            endpoint: self.endpoint.clone(),
            problem: match error.kind() {
                io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => {
                    format!("no word within {} s", PATIENCE.as_secs())
                }
                _ => error.to_string(),
            },
        })?;
        Ok(began.elapsed())
    }
}

fn connect(address: &str) -> io::Result<TcpStream> {
    let addresses: Vec<SocketAddr> = address.to_socket_addrs()?.collect();
    let first = addresses.first().ok_or(io::ErrorKind::AddrNotAvailable)?;
    TcpStream::connect_timeout(first, PATIENCE)
}

fn greet(stream: &mut (impl Read + Write), request: &[u8]) -> io::Result<()> {
    fail_point!("probe", |_| Err(io::ErrorKind::TimedOut.into()));
    stream.write_all(request)?;
    // zenoh's answer begins with its length, whatever it is.
    stream.read_exact(&mut [0; 3])
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::net::TcpListener;

    use super::*;

    #[test]
    fn a_listener_whose_connections_nobody_accepts_is_deaf() {
        // The kernel makes connections to it, as it does to an acceptor that has wedged.
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let endpoint = format!("tcp/{}", listener.local_addr().unwrap());
        let probe = Probe::of(&endpoint).unwrap();
        let mut hearing = Hearing::default();
        for failures in 1..=2 {
            let began = Instant::now();
            hearing.note(probe.try_once());
            assert!(began.elapsed() < PATIENCE + Duration::from_secs(1));
            assert_eq!(hearing.failures, failures);
        }
        let problem = hearing.problem.clone().unwrap().to_string();
        assert_eq!(
            problem,
            format!("{endpoint} does not answer: no word within 2 s")
        );
        hearing.note(Ok(Duration::from_millis(1)));
        assert_eq!((hearing.failures, hearing.problem), (0, None));
        drop(listener);
        let refused = probe.try_once().unwrap_err().to_string();
        assert!(refused.contains("refused"), "{refused}");
    }

    #[test]
    fn every_protocol_that_is_listened_on_has_a_way() {
        for endpoint in [
            "tcp/127.0.0.1:7447",
            "tcp/[::1]:0#iface=lo",
            "tls/0.0.0.0:7447",
            "unixsock-stream//tmp/x",
            "http/127.0.0.1:8080",
            "https/0.0.0.0:8443",
        ] {
            assert!(Probe::of(endpoint).is_some(), "{endpoint}");
        }
        assert!(Probe::of("udp/127.0.0.1:1").is_none());
        assert_eq!(usize::from(GREETING[0]), GREETING.len() - 2);
    }
}
