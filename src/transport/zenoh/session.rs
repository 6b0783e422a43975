//! Opens the daemon's zenoh session: its endpoints, limits and authentication.

use std::sync::Arc;
use std::thread;

use rustix::process::setpriority_process;
use serde_json::{Value, json};
use thiserror::Error;
use tokio::runtime::Handle;
use tracing::{debug, warn};
use zenoh::internal::runtime::{DynamicRuntime, Runtime, RuntimeBuilder};
use zenoh::{Config, Session, Wait};
use zenoh_runtime::ZRuntime;

use crate::auth::Rights;
use crate::auth::address::is_loopback;
use crate::auth::folder::Folder;
use crate::transport::zenoh::acl;
use crate::transport::zenoh::clients::{Handler, Sessions};
use crate::transport::zenoh::session_pool::SessionPool;

/// The niceness of zenoh's receiving threads.
const RX_NICENESS: i32 = -10;

/// The longest message that zenoh accepts, in bytes. It drops longer ones.
pub const MAX_MESSAGE_BYTES: usize = 1 << 20;

/// The most bytes that zenoh adds to a request.
pub const MAX_FRAMING_BYTES: usize = 4096;

/// Sessions beyond `max_clients` that zenoh accepts, so that they receive an error. zenoh closes
/// further ones without a reason.
const MAX_EXTRA_SESSIONS: usize = 96;

/// The time for a TLS handshake, in milliseconds. zenoh reads it only from the options of an endpoint.
const HANDSHAKE_TIMEOUT_MS: u32 = 2000;

/// Why the session cannot be opened.
#[derive(Debug, Error)]
pub enum SessionError {
    /// An endpoint cannot be parsed.
    #[error(
        "invalid endpoint {0:?}: use tcp/127.0.0.1:PORT, unixsock-stream/PATH, or with an auth_dir \
         tls/ADDRESS:PORT"
    )]
    NoEndpoint(String),
    /// Other machines can reach an endpoint that is not encrypted.
    #[error(
        "other machines can reach {0}, which is not encrypted: listen on tls/ADDRESS:PORT with an \
         auth_dir (`jostled auth init` creates one), or on tcp/127.0.0.1:PORT or \
         unixsock-stream/PATH with a tunnel for other machines"
    )]
    NotLoopback(String),
    /// TLS without users.
    #[error("{0} requires users: set auth_dir to their folder (`jostled auth init` creates one)")]
    NoAuthDir(String),
    /// A TLS endpoint with options that override those of the auth_dir.
    #[error(
        "invalid endpoint {0}: after # only iface=NAME is permitted, since the auth_dir determines \
         the certificates"
    )]
    TlsOptions(String),
    /// zenoh cannot listen on the endpoints.
    #[error("cannot listen on {endpoints}: {reason}")]
    Listen {
        /// The endpoints.
        endpoints: String,
        /// The error of zenoh.
        reason: String,
    },
    /// zenoh rejects a setting.
    #[error("zenoh rejects the setting {0}")]
    Setting(String),
}

/// Checks that each endpoint is local, or encrypted and only for users.
///
/// # Errors
///
/// [`SessionError::NoEndpoint`], [`SessionError::NotLoopback`], [`SessionError::NoAuthDir`] and
/// [`SessionError::TlsOptions`].
pub fn check(listen: &[String], has_users: bool) -> Result<(), SessionError> {
    for endpoint in listen {
        let error: fn(String) -> SessionError = match endpoint.split_once('/') {
            None => SessionError::NoEndpoint,
            Some(("tls", _)) if !has_users => SessionError::NoAuthDir,
            Some(("tls", address)) if has_options(address) => SessionError::TlsOptions,
            Some(("tls", _)) => continue,
            Some(_) if is_local(endpoint) => continue,
            Some(_) => SessionError::NotLoopback,
        };
        return Err(error(endpoint.clone()));
    }
    Ok(())
}

/// The session and what belongs to it.
pub struct Opened {
    /// The session.
    pub session: Session,
    /// Further sessions of the same runtime.
    pub pool: SessionPool,
    /// The runtime of the sessions.
    pub runtime: OpenRuntime,
    /// The sessions of the clients.
    pub clients: Arc<Sessions>,
}

/// The runtime of the sessions, which is closed on drop. Drop it after the sessions.
pub struct OpenRuntime(Runtime);

impl Drop for OpenRuntime {
    fn drop(&mut self) {
        if let Err(error) = self.0.close().wait() {
            warn!(%error, "failed to close zenoh's runtime");
        }
    }
}

/// Opens the session: it listens on `listen`, for these users and at most `max_clients` clients.
pub async fn open(
    listen: &[String],
    prefix: &str,
    rights: &Rights,
    max_clients: usize,
) -> Result<Opened, SessionError> {
    check(listen, rights.users().is_some())?;
    prioritise_rx();
    let mut config = Config::default();
    let mut settings = settings(listen, max_clients);
    settings.push(("access_control", acl::control(prefix, rights)));
    if let Rights::Users { folder, .. } = rights {
        settings.extend(authentication(folder));
    }
    for (key, value) in settings {
        config
            .insert_json5(key, &value.to_string())
            .map_err(|error| SessionError::Setting(format!("{key}: {error}")))?;
    }
    start(config).await.map_err(|error| SessionError::Listen {
        endpoints: listen.join(", "),
        reason: reason(&error.to_string()),
    })
}

/// Like `zenoh::open`, which does not accept a transport event handler.
async fn start(config: Config) -> zenoh::Result<Opened> {
    let clients = Arc::<Sessions>::default();
    let mut runtime = OpenRuntime(RuntimeBuilder::new(config).build().await?);
    let shared = DynamicRuntime::from(runtime.0.clone());
    shared.new_handler(Arc::new(Handler(clients.clone())));
    let session = zenoh::session::init(shared.clone()).await?;
    runtime.0.start().await?;
    Ok(Opened {
        session,
        pool: SessionPool::new(shared),
        runtime,
        clients,
    })
}

/// Starts zenoh's receiving threads, with a higher priority than the other threads if that is
/// permitted. In a flood they reject most requests; with equal priorities the threads that reply to the
/// flood would delay the requests of other clients.
fn prioritise_rx() {
    // A thread inherits the niceness of its parent, so TX is started first: with a higher priority it
    // would send each message by itself, and a batch of messages costs little more than one.
    let _: &Handle = &ZRuntime::TX;
    let started = thread::spawn(|| {
        if let Err(error) = setpriority_process(None, RX_NICENESS) {
            debug!(%error, "not permitted to raise the priority of zenoh's receiving threads");
        }
        let _: &Handle = &ZRuntime::RX;
    });
    if started.join().is_err() {
        debug!("zenoh failed to start its receiving threads; it retries with the first client");
    }
}

/// zenoh's error without the positions in its source.
fn reason(text: &str) -> String {
    if text.contains("Address already in use") {
        return "the address is in use".to_owned();
    }
    text.split(" at /").next().unwrap_or(text).to_owned()
}

/// Every setting that differs from zenoh's default.
fn settings(listen: &[String], max_clients: usize) -> Vec<(&'static str, Value)> {
    let (max_sessions, max_bytes) = (max_clients + MAX_EXTRA_SESSIONS, MAX_MESSAGE_BYTES);
    let listen: Vec<String> = listen.iter().map(|it| with_timeout(it)).collect();
    vec![
        // A zenoh router forwards claims to other routers, but not from one peer to another.
        ("mode", json!("router")),
        // The daemon opens no connections, so there is nothing to wait for.
        ("scouting/delay", json!(0)),
        ("listen/endpoints", json!(listen)),
        // Sessions connect only to configured endpoints.
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        // A query to it during a declaration of a client deadlocks the session.
        ("adminspace/enabled", json!(false)),
        // Sequence numbers order events. After the clock is set back zenoh logs two lines for every
        // sample with a timestamp, until the clock catches up.
        ("timestamping/enabled", json!(false)),
        ("transport/shared_memory/enabled", json!(false)),
        // Connections that send nothing must not block new clients.
        ("transport/unicast/accept_timeout", json!(2000)),
        ("transport/unicast/accept_pending", json!(1000)),
        ("transport/unicast/max_sessions", json!(max_sessions)),
        // A client that was disconnected is noticed within three seconds.
        ("transport/link/tx/lease", json!(3000)),
        ("transport/link/rx/max_message_size", json!(max_bytes)),
    ]
}

/// The authentication of sessions: by password, and over TLS by certificate, too.
fn authentication(folder: &Folder) -> [(&'static str, Value); 2] {
    let ([authority, _], [certificate, key]) = (folder.authority(), folder.daemon());
    let passwords = json!(folder.passwords_file());
    [
        ("transport/auth/usrpwd/dictionary_file", passwords),
        (
            "transport/link/tls",
            json!({
                "root_ca_certificate": authority,
                "listen_certificate": certificate,
                "listen_private_key": key,
                "enable_mtls": true,
                "close_link_on_expiration": true,
            }),
        ),
    ]
}

/// An endpoint with [`HANDSHAKE_TIMEOUT_MS`], if it is for TLS.
fn with_timeout(endpoint: &str) -> String {
    if !endpoint.starts_with("tls/") {
        return endpoint.to_owned();
    }
    let separator = if endpoint.contains('#') { ';' } else { '#' };
    format!("{endpoint}{separator}tls_handshake_timeout_ms={HANDSHAKE_TIMEOUT_MS}")
}

/// Whether an address has options other than the interface, such as `0.0.0.0:7447#enable_mtls=false`:
/// to zenoh they take precedence over its settings.
fn has_options(address: &str) -> bool {
    let settings = address.split_once('#').map(|(_, settings)| settings);
    let mut settings = settings.into_iter().flat_map(|it| it.split(';'));
    settings.any(|setting| !setting.starts_with("iface="))
}

/// Whether only this machine can reach `endpoint`.
fn is_local(endpoint: &str) -> bool {
    let Some((protocol, rest)) = endpoint.split_once('/') else {
        return false;
    };
    let address = rest.split(['?', '#']).next().unwrap_or(rest);
    match protocol {
        "unixsock-stream" => true,
        "tcp" => address
            .rsplit_once(':')
            .is_some_and(|(host, _)| is_loopback(host)),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_addresses_of_this_machine_are_listened_on() {
        for local in [
            "tcp/127.0.0.1:7447",
            "tcp/127.0.0.1:0",
            "tcp/127.9.9.9:1",
            "tcp/[::1]:7447",
            "tcp/localhost:7447",
            "tcp/127.0.0.1:0#iface=lo",
            "unixsock-stream//tmp/jostled.sock",
        ] {
            assert!(is_local(local), "{local}");
        }
        for open in [
            "tcp/0.0.0.0:7447",
            "tcp/[::]:7447",
            "tcp/10.0.0.1:7447",
            "tcp/*:7447",
            "tcp/example.org:7447",
            "tcp/127.0.0.1.example.org:7447",
            "udp/127.0.0.1:7447",
            "127.0.0.1:7447",
            "",
        ] {
            assert!(!is_local(open), "{open}");
        }
    }

    #[test]
    fn other_machines_need_tls_and_users() {
        use SessionError::{NoAuthDir, NoEndpoint, NotLoopback, TlsOptions};
        type Rejection = fn(String) -> SessionError;
        let cases: [(&str, bool, Option<Rejection>); 12] = [
            ("tls/0.0.0.0:7447", true, None),
            ("tls/0.0.0.0:7447#iface=eth0", true, None),
            ("tcp/127.0.0.1:7447", true, None),
            ("tls/0.0.0.0:7447#enable_mtls=false", true, Some(TlsOptions)),
            (
                "tls/0.0.0.0:7447#iface=eth0;enable_mtls=false",
                true,
                Some(TlsOptions),
            ),
            ("tls/0.0.0.0:7447#", true, Some(TlsOptions)),
            ("tls/0.0.0.0:7447", false, Some(NoAuthDir)),
            ("tls/127.0.0.1:7447", false, Some(NoAuthDir)),
            ("tcp/0.0.0.0:7447", false, Some(NotLoopback)),
            ("quic/0.0.0.0:7447", false, Some(NotLoopback)),
            ("ws/10.0.0.1:1", false, Some(NotLoopback)),
            ("7447", true, Some(NoEndpoint)),
        ];
        for (endpoint, has_users, expected) in cases {
            let rejected = check(&[endpoint.to_owned()], has_users).err();
            let expected = expected.map(|error| error(endpoint.to_owned()).to_string());
            assert_eq!(rejected.map(|it| it.to_string()), expected, "{endpoint}");
        }
    }
}
