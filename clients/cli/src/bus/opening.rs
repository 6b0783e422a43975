//! How a client opens its session, and who it says it is.

use std::io::{self, Read, Write};
use std::net::{IpAddr, SocketAddr, TcpStream, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::time::Duration;

use jostle_proto::Credentials;
use zenoh::config::EndPoint;

use crate::arguments::DEFAULT_ENDPOINT;
use crate::bus::tls::{self, WrongName};
use crate::failure::Failure;

/// What a session can be opened over.
const PROTOCOLS: [&str; 3] = ["tcp", "tls", "unixsock-stream"];

/// What a client of zenoh says first (`InitSyn`), behind its length.
const GREETING: [u8; 21] = *b"\x13\x00\x01\x09\xf2jostle-probe-own";

/// How long whoever listens may take to say so.
const KNOCKING: Duration = Duration::from_secs(1);

/// Who somebody is, and the folder that says so.
pub struct Identity {
    folder: PathBuf,
    /// What it says.
    pub credentials: Credentials,
}

impl Identity {
    /// Reads the folder that is given, if one is; an empty name is none.
    ///
    /// # Errors
    ///
    /// [`Failure::Argument`] when it is none of `jostled auth`.
    pub fn given(folder: Option<&Path>) -> Result<Option<Self>, Failure> {
        let folder = folder.filter(|folder| !folder.as_os_str().is_empty());
        folder.map(Self::read).transpose()
    }

    /// Reads a folder that `jostled auth` made.
    ///
    /// # Errors
    ///
    /// [`Failure::Argument`] when it is none.
    fn read(folder: &Path) -> Result<Self, Failure> {
        let path = folder.join(Credentials::FILE);
        let wrong = |problem: String| Failure::Argument {
            argument: "--credentials".into(),
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

    /// What zenoh needs to prove it.
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

/// Whether only this machine is at `endpoint`.
fn is_here(endpoint: &EndPoint) -> bool {
    let address = endpoint.address();
    let address = address.as_str();
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    let bare = host.trim_start_matches('[').trim_end_matches(']');
    endpoint.protocol().as_str() == "unixsock-stream"
        || bare == "localhost"
        || bare.parse::<IpAddr>().is_ok_and(|it| it.is_loopback())
}

/// Where to look for a daemon: where one was told to, or else where one's credentials say.
pub fn endpoint(told: Option<String>, identity: Option<&Identity>) -> String {
    let theirs = || Some(identity?.credentials.endpoint.clone());
    let default = || DEFAULT_ENDPOINT.to_owned();
    told.or_else(theirs).unwrap_or_else(default)
}

/// Whether what listens at `endpoint` is a zenoh, or TLS, that did not let this client in.
pub fn speaks_zenoh(endpoint: &str) -> bool {
    let Some((protocol @ ("tcp" | "tls"), address)) = endpoint.split_once('/') else {
        return false;
    };
    let address = address.split(['?', '#']).next().unwrap_or(address);
    let mut addresses = address.to_socket_addrs().into_iter().flatten();
    let answer = addresses.find_map(|address| knock(address).ok());
    match (protocol, answer.as_deref()) {
        // It says that this is no handshake of its own.
        ("tls", Some([0x15 | 0x16, ..])) => true,
        // It says so behind the length of its answer.
        ("tcp", Some([low, high, rest @ ..])) => {
            !rest.is_empty() && usize::from(u16::from_le_bytes([*low, *high])) == rest.len()
        }
        _ => false,
    }
}

/// Greets whoever listens there, and returns the first of what it says.
fn knock(address: SocketAddr) -> io::Result<Vec<u8>> {
    let mut stream = TcpStream::connect_timeout(&address, KNOCKING)?;
    stream.set_read_timeout(Some(KNOCKING))?;
    stream.set_write_timeout(Some(KNOCKING))?;
    stream.write_all(&GREETING)?;
    let mut answer = [0; 64];
    let length = stream.read(&mut answer)?;
    Ok(answer[..length].to_vec())
}

/// A client of one endpoint and of nothing else.
///
/// # Errors
///
/// [`Failure::Argument`] when the endpoint cannot be used.
pub fn config(
    endpoint: &str,
    timeout_secs: f64,
    identity: Option<&Identity>,
) -> Result<zenoh::Config, Failure> {
    let wrong = |problem: String| Failure::Argument {
        argument: "--endpoint".into(),
        problem,
    };
    let parsed: EndPoint = endpoint.parse().map_err(|_| {
        wrong(format!(
            "`{endpoint}` is no endpoint: give one such as tcp/127.0.0.1:7447"
        ))
    })?;
    let protocol = parsed.protocol();
    if !PROTOCOLS.contains(&protocol.as_str()) {
        let known = PROTOCOLS.join(", ");
        return Err(wrong(format!(
            "`{protocol}` is not among the protocols it speaks: {known}"
        )));
    }
    if identity.is_some() && protocol.as_str() != "tls" && !is_here(&parsed) {
        return Err(wrong(format!(
            "`{endpoint}` is another machine's, and whatever is sent there in the clear can be \
             read on the way: with credentials give tls/HOST:PORT"
        )));
    }
    // Opening blocks its thread, so that only zenoh itself can give up.
    let open_timeout = Duration::from_secs_f64(timeout_secs)
        .as_millis()
        .to_string();
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

/// What zenoh says, without the line of its source where it says so.
pub fn words(error: &zenoh::Error) -> String {
    let text = error.to_string();
    let end = text.find(" at /").unwrap_or(text.len());
    text[..end].trim_end().into()
}

/// Who is at the keyboard, as far as the environment tells.
pub fn user_and_host() -> String {
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
    fn an_endpoint_is_a_protocol_it_speaks_and_an_address() {
        for endpoint in [
            "tcp/127.0.0.1:7447",
            "tcp/[::1]:1",
            "tls/host:1",
            "unixsock-stream//tmp/s",
        ] {
            assert!(config(endpoint, 5.0, None).is_ok(), "{endpoint}");
        }
        for endpoint in ["", "127.0.0.1:7447", "tcp", "udp/127.0.0.1:1", "http://a"] {
            assert_eq!(
                config(endpoint, 5.0, None).unwrap_err().exit_code(),
                2,
                "{endpoint}"
            );
        }
    }
}
