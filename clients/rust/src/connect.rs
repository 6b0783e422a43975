//! How a client connects: endpoint, credentials and the configuration of the zenoh session.

use std::net::{IpAddr, TcpStream, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use jostle_proto::Credentials;
use jostle_proto::keys::DEFAULT_PREFIX;
use tokio::runtime::RuntimeFlavor;
use zenoh::config::EndPoint;

use crate::error::Error;
use crate::retry::Delays;
use crate::tls::{self, WrongName};

/// The endpoint of a daemon with default settings.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// The protocols of an endpoint.
const PROTOCOLS: [&str; 3] = ["tcp", "tls", "unixsock-stream"];

/// The timeout of a TCP connection that only tests whether a process listens.
const PROBE_TIMEOUT: Duration = Duration::from_secs(1);

/// The shortest timeout of opening a session; zenoh takes 0 for none.
const MIN_OPEN_TIMEOUT: Duration = Duration::from_millis(1);

/// The endpoint, the credentials and the other options of a connection.
#[derive(Clone, Debug)]
pub struct ConnectOptions {
    /// The endpoint, such as `tcp/127.0.0.1:7447`. By default that of the credentials, or
    /// [`DEFAULT_ENDPOINT`].
    pub endpoint: Option<String>,
    /// The folder with the credentials that `jostled auth` wrote.
    pub credentials: Option<PathBuf>,
    /// The daemon that receives requests to a daemon, if the endpoint reaches several.
    pub node: Option<String>,
    /// The first chunk of the keys of the daemon, by default `jostle`.
    pub prefix: String,
    /// The timeout of connecting and of each request, by default 5 s.
    pub timeout: Duration,
    /// How long connecting waits, at most the timeout, for a daemon that is not there yet or recovers its
    /// swarms, as after a restart. By default the timeout.
    pub wait: Duration,
    /// The name that events and the journal contain for this client, by default `user@host`.
    pub client: Option<String>,
}

impl Default for ConnectOptions {
    fn default() -> Self {
        ConnectOptions {
            endpoint: None,
            credentials: None,
            node: None,
            prefix: DEFAULT_PREFIX.to_owned(),
            timeout: Duration::from_secs(5),
            wait: Duration::MAX,
            client: None,
        }
    }
}

impl ConnectOptions {
    /// Connects to this endpoint.
    pub fn to(endpoint: impl Into<String>) -> Self {
        ConnectOptions {
            endpoint: Some(endpoint.into()),
            ..Self::default()
        }
    }

    /// The endpoint to connect to: that of the options, of the credentials or the default.
    ///
    /// # Errors
    ///
    /// [`Error::Option`] if the credentials cannot be read.
    pub fn resolved_endpoint(&self) -> Result<String, Error> {
        Ok(self.endpoint_of(self.identity()?.as_ref()))
    }

    pub(crate) fn endpoint_of(&self, identity: Option<&Identity>) -> String {
        let of_identity = || Some(identity?.credentials.endpoint.clone());
        let endpoint = self.endpoint.clone().or_else(of_identity);
        endpoint.unwrap_or_else(|| DEFAULT_ENDPOINT.to_owned())
    }

    /// The token of the credentials, by which the page knows a user; `None` without credentials.
    ///
    /// # Errors
    ///
    /// [`Error::Option`] if the credentials cannot be read.
    pub fn token(&self) -> Result<Option<String>, Error> {
        Ok(self.identity()?.map(|it| it.credentials.token))
    }

    /// The credentials, if a folder is given; an empty path is none.
    pub(crate) fn identity(&self) -> Result<Option<Identity>, Error> {
        let folder = self.credentials.as_deref();
        let folder = folder.filter(|folder| !folder.as_os_str().is_empty());
        folder.map(Identity::read).transpose()
    }
}

/// Credentials, and the folder that contains them.
pub(crate) struct Identity {
    folder: PathBuf,
    pub credentials: Credentials,
}

impl Identity {
    fn read(folder: &Path) -> Result<Self, Error> {
        let path = folder.join(Credentials::FILE);
        let wrong = |problem: String| Error::Option {
            option: "credentials",
            problem: format!("{}: {problem}", path.display()),
        };
        let text = std::fs::read(&path).map_err(|error| wrong(error.to_string()))?;
        let credentials =
            serde_json::from_slice(&text).map_err(|error| wrong(error.to_string()))?;
        Ok(Identity {
            folder: folder.to_owned(),
            credentials,
        })
    }

    /// The names of the certificate at `endpoint`, if the connection fails because of them.
    pub fn wrong_name(&self, endpoint: &str) -> Option<WrongName> {
        let [ca, ..] = Credentials::CERTIFICATES;
        tls::wrong_name(endpoint, &self.folder.join(ca))
    }

    /// The settings of zenoh with the password and the certificate.
    fn settings(&self) -> [(&'static str, serde_json::Value); 2] {
        let [ca, certificate, key] = Credentials::CERTIFICATES.map(|file| self.folder.join(file));
        let Credentials {
            person, password, ..
        } = &self.credentials;
        [
            (
                "transport/auth/usrpwd",
                serde_json::json!({"user": person, "password": password}),
            ),
            (
                "transport/link/tls",
                serde_json::json!({
                    "root_ca_certificate": ca,
                    "connect_certificate": certificate,
                    "connect_private_key": key,
                    "enable_mtls": true,
                    "verify_name_on_connect": true,
                    "close_link_on_expiration": true,
                }),
            ),
        ]
    }
}

/// Whether `endpoint` is on this machine.
fn is_here(endpoint: &EndPoint) -> bool {
    let address = endpoint.address();
    let address = address.as_str();
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    let bare = host.trim_start_matches('[').trim_end_matches(']');
    endpoint.protocol().as_str() == "unixsock-stream"
        || bare == "localhost"
        || bare.parse::<IpAddr>().is_ok_and(|it| it.is_loopback())
}

/// The address of `endpoint`, if it is one of TCP, such as `127.0.0.1:7447`.
fn tcp_address(endpoint: &str) -> Option<&str> {
    let (protocol, address) = endpoint.split_once('/')?;
    let address = address.split(['?', '#']).next();
    address.filter(|_| matches!(protocol, "tcp" | "tls"))
}

/// Whether a process accepts TCP connections at `endpoint`.
pub(crate) fn is_listening(endpoint: &str) -> bool {
    let addresses = tcp_address(endpoint).and_then(|it| it.to_socket_addrs().ok());
    let mut addresses = addresses.into_iter().flatten();
    addresses.any(|address| TcpStream::connect_timeout(&address, PROBE_TIMEOUT).is_ok())
}

/// The host of `endpoint`, if it has no address.
pub(crate) fn unknown_host(endpoint: &str) -> Option<String> {
    let (host, port) = tcp_address(endpoint)?.rsplit_once(':')?;
    let is_unknown = port.parse::<u16>().is_ok() && (host, 1).to_socket_addrs().is_err();
    (is_unknown && !host.starts_with('[')).then(|| host.to_owned())
}

/// Whether zenoh works with the runtime of this task; with another one it panics.
pub(crate) fn has_runtime() -> bool {
    let runtime = tokio::runtime::Handle::try_current();
    runtime.is_ok_and(|it| it.runtime_flavor() != RuntimeFlavor::CurrentThread)
}

/// Opens a session with the endpoint within the timeout. Waits until the deadline for a process to listen
/// there.
pub(crate) async fn open(
    endpoint: &str,
    options: &ConnectOptions,
    identity: Option<&Identity>,
    deadline: Instant,
) -> Result<zenoh::Session, Error> {
    let mut delays = Delays::default();
    let mut was_rejected = false;
    let start = Instant::now();
    loop {
        let timeout = options.timeout.saturating_sub(start.elapsed());
        let timeout = timeout.max(MIN_OPEN_TIMEOUT);
        let config = config(endpoint, timeout, identity)?;
        let began = Instant::now();
        let cause = match zenoh::open(config).await {
            Ok(session) => return Ok(session),
            Err(error) => words(&error),
        };
        let is_early = began.elapsed() < timeout;
        if let Some(host) = unknown_host(endpoint) {
            let endpoint = endpoint.to_owned();
            return Err(Error::UnknownHost { endpoint, host });
        }
        let is_listening = is_listening(endpoint);
        if is_listening && !is_early {
            return Err(Error::Mute {
                endpoint: endpoint.to_owned(),
                secs: options.timeout.as_secs_f64(),
            });
        }
        // A daemon that rejects a client closes the connection at once. One that was not there yet, or has
        // just ended, does so too, but not twice.
        if is_listening && std::mem::replace(&mut was_rejected, true) {
            return Err(rejected(endpoint, identity));
        }
        was_rejected &= is_listening;
        let delay = delays.next();
        if !is_listening && Instant::now() + delay >= deadline {
            let waited = deadline.saturating_duration_since(start).as_secs_f64();
            return Err(Error::NoDaemon {
                endpoint: endpoint.to_owned(),
                cause: match waited > 0.0 {
                    true => format!("tried for {waited:.1} s"),
                    false => cause,
                },
            });
        }
        tokio::time::sleep(delay).await;
    }
}

fn rejected(endpoint: &str, identity: Option<&Identity>) -> Error {
    let endpoint = endpoint.to_owned();
    match identity.and_then(|it| it.wrong_name(&endpoint)) {
        Some(WrongName { host, names }) => Error::WrongName {
            endpoint,
            host,
            names,
        },
        None => Error::NotAdmitted {
            endpoint,
            person: identity.map(|it| it.credentials.person.clone()),
        },
    }
}

/// The configuration of a session that connects to this endpoint only.
pub(crate) fn config(
    endpoint: &str,
    timeout: Duration,
    identity: Option<&Identity>,
) -> Result<zenoh::Config, Error> {
    let wrong = |problem: String| Error::Option {
        option: "endpoint",
        problem,
    };
    let parsed: EndPoint = endpoint.parse().map_err(|_| {
        wrong(format!(
            "`{endpoint}` is not an endpoint: use one such as tcp/127.0.0.1:7447"
        ))
    })?;
    let protocol = parsed.protocol();
    if !PROTOCOLS.contains(&protocol.as_str()) {
        let known = PROTOCOLS.join(", ");
        return Err(wrong(format!(
            "unknown protocol `{protocol}`: use one of {known}"
        )));
    }
    if identity.is_some() && protocol.as_str() != "tls" && !is_here(&parsed) {
        return Err(wrong(format!(
            "`{endpoint}` is on another machine, and credentials would be sent there in the clear: \
             use tls/HOST:PORT"
        )));
    }
    // Opening blocks its thread, so that only zenoh itself can time out.
    let open_timeout = timeout.as_millis().to_string();
    let mut config = zenoh::Config::default();
    let endpoints = serde_json::json!([endpoint]).to_string();
    for (key, value) in [
        ("mode", "\"client\""),
        ("connect/endpoints", &endpoints),
        ("connect/timeout_ms", "0"),
        (
            "connect/retry",
            r#"{"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2}"#,
        ),
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
        ("transport/link/tx/lease", "3000"),
        ("transport/unicast/open_timeout", &open_timeout),
    ] {
        config
            .insert_json5(key, value)
            .map_err(|error| wrong(words(&error)))?;
    }
    for (key, value) in identity.map(Identity::settings).into_iter().flatten() {
        config
            .insert_json5(key, &value.to_string())
            .map_err(|error| wrong(words(&error)))?;
    }
    Ok(config)
}

/// The message of a zenoh error without its source line.
pub(crate) fn words(error: &zenoh::Error) -> String {
    let text = error.to_string();
    let end = text.find(" at /").unwrap_or(text.len());
    text[..end].trim_end().into()
}

/// The user and the host as named by the environment.
pub(crate) fn user_and_host() -> String {
    let user = std::env::var("USER").or_else(|_| std::env::var("LOGNAME"));
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname")
        .or_else(|_| std::env::var("HOSTNAME"))
        .map(|host| host.trim().to_owned());
    match (user, host) {
        (Ok(user), Ok(host)) if !user.is_empty() && !host.is_empty() => format!("{user}@{host}"),
        _ => "jostle".into(),
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn an_endpoint_is_a_known_protocol_and_an_address() {
        for endpoint in [
            "tcp/127.0.0.1:7447",
            "tcp/[::1]:1",
            "tls/host:1",
            "unixsock-stream//tmp/s",
        ] {
            assert!(
                config(endpoint, Duration::from_secs(5), None).is_ok(),
                "{endpoint}"
            );
        }
        for endpoint in ["", "127.0.0.1:7447", "tcp", "udp/127.0.0.1:1", "http://a"] {
            let error = config(endpoint, Duration::from_secs(5), None).unwrap_err();
            let is_of_endpoint = matches!(
                error,
                Error::Option {
                    option: "endpoint",
                    ..
                }
            );
            assert!(is_of_endpoint, "{endpoint}: {error}");
        }
    }
}
