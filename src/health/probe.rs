//! Probes whether a listener of the daemon responds.
//!
//! zenoh's acceptor has been seen to hang: the kernel completes connections that are never accepted.
//! So the probe sends the first message of a client and waits for the first bytes of the reply. It
//! then disconnects before a session is opened, so no session event is published.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs as _};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use fail::fail_point;

use crate::health::reason::Reason;

/// The time for each step of a probe: connect, write, read.
pub const TIMEOUT: Duration = Duration::from_secs(2);

/// The first message of a zenoh client (`InitSyn`) after its length: message id, protocol version,
/// role client with an id of 16 bytes, and the id.
const INIT_SYN: [u8; 21] = *b"\x13\x00\x01\x09\xf2jostle-probe-own";

/// A request over HTTP, to which a listener that speaks TLS replies with an alert.
const HTTP_REQUEST: &[u8] =
    b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";

/// A probe of one listener.
pub struct Probe {
    endpoint: String,
    address: Address,
    request: &'static [u8],
}

enum Address {
    Tcp(String),
    Unix(String),
}

/// The results of the probes of one listener.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ProbeStatus {
    /// The response time of the last successful probe.
    pub secs: Option<f64>,
    /// The number of failures since.
    pub failures: u32,
    /// The last failure, if there was one since.
    pub problem: Option<Reason>,
}

impl ProbeStatus {
    /// Records the result of a probe.
    pub fn record(&mut self, result: Result<Duration, Reason>) {
        match result {
            Ok(took) => {
                *self = ProbeStatus {
                    secs: Some(took.as_secs_f64()),
                    ..ProbeStatus::default()
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
    /// A probe of `endpoint`; `None` if its protocol is unknown.
    pub fn of(endpoint: &str) -> Option<Self> {
        let (protocol, rest) = endpoint.split_once('/')?;
        let address = rest.split(['?', '#']).next().unwrap_or(rest).to_owned();
        let (address, request): (_, &[u8]) = match protocol {
            // Over TLS the reply is an alert, since this is no handshake.
            "tcp" | "tls" => (Address::Tcp(address), &INIT_SYN),
            "unixsock-stream" => (Address::Unix(address), &INIT_SYN),
            "http" | "https" => (Address::Tcp(address), HTTP_REQUEST),
            _ => return None,
        };
        Some(Probe {
            endpoint: endpoint.to_owned(),
            address,
            request,
        })
    }

    /// Connects, sends a message and waits for the reply; returns how long it took.
    pub fn try_once(&self) -> Result<Duration, Reason> {
        let began = Instant::now();
        let result = match &self.address {
            Address::Tcp(address) => connect(address).and_then(|mut stream| {
                stream.set_read_timeout(Some(TIMEOUT))?;
                stream.set_write_timeout(Some(TIMEOUT))?;
                exchange(&mut stream, self.request)
            }),
            Address::Unix(path) => UnixStream::connect(path).and_then(|mut stream| {
                stream.set_read_timeout(Some(TIMEOUT))?;
                stream.set_write_timeout(Some(TIMEOUT))?;
                exchange(&mut stream, self.request)
            }),
        };
        result.map_err(|error| Reason::Unresponsive {
            endpoint: self.endpoint.clone(),
            problem: match error.kind() {
                io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => {
                    format!("no reply within {} s", TIMEOUT.as_secs())
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
    TcpStream::connect_timeout(first, TIMEOUT)
}

fn exchange(stream: &mut (impl Read + Write), request: &[u8]) -> io::Result<()> {
    fail_point!("probe", |_| Err(io::ErrorKind::TimedOut.into()));
    stream.write_all(request)?;
    // Any reply of zenoh begins with its length.
    stream.read_exact(&mut [0; 3])
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::net::TcpListener;

    use super::*;

    #[test]
    fn a_listener_that_does_not_accept_connections_is_unresponsive() {
        // The kernel completes connections to it, as with an acceptor that hangs.
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let endpoint = format!("tcp/{}", listener.local_addr().unwrap());
        let probe = Probe::of(&endpoint).unwrap();
        let mut status = ProbeStatus::default();
        for failures in 1..=2 {
            let began = Instant::now();
            status.record(probe.try_once());
            assert!(began.elapsed() < TIMEOUT + Duration::from_secs(1));
            assert_eq!(status.failures, failures);
        }
        let problem = status.problem.clone().unwrap().to_string();
        assert_eq!(
            problem,
            format!("{endpoint} does not answer: no reply within 2 s")
        );
        status.record(Ok(Duration::from_millis(1)));
        assert_eq!((status.failures, status.problem), (0, None));
        drop(listener);
        let error = probe.try_once().unwrap_err().to_string();
        assert!(error.contains("refused"), "{error}");
    }

    #[test]
    fn every_protocol_that_is_listened_on_has_a_probe() {
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
        assert_eq!(usize::from(INIT_SYN[0]), INIT_SYN.len() - 2);
    }
}
