//! The daemon's zenoh session: what it listens on and what it refuses from the bus.

use std::net::{IpAddr, SocketAddr};
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
use crate::auth::folder::Folder;
use crate::transport::zenoh::acl;
use crate::transport::zenoh::clients::{Handler, Sessions};
use crate::transport::zenoh::session_pool::SessionPool;

/// How much higher than the rest of the daemon the threads rank that read from the bus.
const READING_NICENESS: i32 = -10;

/// The largest message accepted from the bus, in bytes. Larger ones vanish.
pub const MAX_MESSAGE_BYTES: usize = 1 << 20;

/// The most bytes that zenoh adds to a request.
pub const FRAMING_BYTES: usize = 4096;

/// Sessions that are let in beyond the clients there may be, so that they are told: one more is cut
/// off by zenoh without a word.
const SESSIONS_TO_REFUSE: usize = 96;

/// Why there is no session.
#[derive(Debug, Error)]
pub enum SessionError {
    /// It is no endpoint at all.
    #[error(
        "{0:?} is no endpoint: give tcp/127.0.0.1:PORT, unixsock-stream/PATH, or with an auth_dir \
         tls/ADDRESS:PORT"
    )]
    NoEndpoint(String),
    /// An address that others could reach is not offered in the clear.
    #[error(
        "{0} can be reached from other machines, and is not encrypted: listen on \
         tls/ADDRESS:PORT, which takes an auth_dir (`jostled auth init` makes one), or on \
         tcp/127.0.0.1:PORT or unixsock-stream/PATH and let others in through a tunnel"
    )]
    NotLoopback(String),
    /// TLS without people.
    #[error(
        "{0} is for people who are known, and none are: name their folder as auth_dir \
         (`jostled auth init` makes one)"
    )]
    NobodyKnown(String),
    /// TLS in another way than that of the people's folder.
    #[error(
        "{0}: behind # may stand iface=NAME alone, since certificates and who must show one are \
         the auth_dir's to say"
    )]
    OtherTls(String),
    /// Nothing can be listened on.
    #[error(
        "cannot listen on {endpoints}: {reason}\nanother daemon may hold it, or a zenoh router, \
         whose own port 7447 is: `--listen tcp/127.0.0.1:0` takes a free one"
    )]
    Listen {
        /// Where.
        endpoints: String,
        /// What zenoh says.
        reason: String,
    },
    /// zenoh refuses the configuration.
    #[error("zenoh refuses the setting {0}")]
    Setting(String),
}

/// Checks that only this machine can reach each endpoint, or only people who are known.
///
/// # Errors
///
/// [`SessionError::NoEndpoint`], [`SessionError::NotLoopback`], [`SessionError::NobodyKnown`] and
/// [`SessionError::OtherTls`].
pub fn check(listen: &[String], are_people_known: bool) -> Result<(), SessionError> {
    for endpoint in listen {
        let refused: fn(String) -> SessionError = match endpoint.split_once('/') {
            None => SessionError::NoEndpoint,
            Some(("tls", _)) if !are_people_known => SessionError::NobodyKnown,
            Some(("tls", address)) if has_settings_of_its_own(address) => SessionError::OtherTls,
            Some(("tls", _)) => continue,
            Some(_) if is_local(endpoint) => continue,
            Some(_) => SessionError::NotLoopback,
        };
        return Err(refused(endpoint.clone()));
    }
    Ok(())
}

/// The daemon's session, and what it runs on.
pub struct Opened {
    /// The session.
    pub session: Session,
    /// Other sessions of the same runtime.
    pub pool: SessionPool,
    /// What it runs on, until this is dropped.
    pub runtime: OpenRuntime,
    /// The sessions of its clients.
    pub clients: Arc<Sessions>,
}

/// What zenoh runs on. It is closed when this is dropped, which is to be after its session.
pub struct OpenRuntime(Runtime);

impl Drop for OpenRuntime {
    fn drop(&mut self) {
        if let Err(error) = self.0.close().wait() {
            warn!(%error, "failed to close zenoh's runtime");
        }
    }
}

/// Opens the session on `listen`, for keys below `prefix`, whoever has rights there and so many
/// clients.
///
/// # Errors
///
/// [`SessionError`].
pub async fn open(
    listen: &[String],
    prefix: &str,
    rights: &Rights,
    max_clients: usize,
) -> Result<Opened, SessionError> {
    check(listen, rights.users().is_some())?;
    read_first();
    let mut config = Config::default();
    let mut settings = settings(listen, max_clients);
    settings.push(("access_control", acl::control(prefix, rights)));
    if let Rights::Users { folder, .. } = rights {
        settings.extend(proofs(folder));
    }
    for (key, value) in settings {
        config
            .insert_json5(key, &value.to_string())
            .map_err(|error| SessionError::Setting(format!("{key}: {error}")))?;
    }
    let clients = Arc::<Sessions>::default();
    start(config, clients.clone())
        .await
        .map(|(session, pool, runtime)| Opened {
            session,
            pool,
            runtime,
            clients,
        })
        .map_err(|error| SessionError::Listen {
            endpoints: listen.join(", "),
            reason: reason(&error.to_string()),
        })
}

/// Does what `zenoh::open` does, which has no place for a handler of transports.
async fn start(
    config: Config,
    clients: Arc<Sessions>,
) -> zenoh::Result<(Session, SessionPool, OpenRuntime)> {
    let mut runtime = OpenRuntime(RuntimeBuilder::new(config).build().await?);
    let shared = DynamicRuntime::from(runtime.0.clone());
    shared.new_handler(Arc::new(Handler(clients)));
    let session = zenoh::session::init(shared.clone()).await?;
    runtime.0.start().await?;
    Ok((session, SessionPool::new(shared), runtime))
}

/// Starts zenoh's reading threads, and has them rank above the daemon's others where that is
/// permitted: in a flood they turn away most of what they read, and whoever is behind it is read
/// soon, while each thread that only answers the flood would have as much of a core as they.
fn read_first() {
    // What a thread starts ranks like it. Whoever sends is not to come before whoever has more to
    // send: several messages that leave together cost little more than one.
    let _: &Handle = &ZRuntime::TX;
    let started = thread::spawn(|| {
        if let Err(error) = setpriority_process(None, READING_NICENESS) {
            debug!(%error, "not permitted to rank the reading of queries above all else");
        }
        let _: &Handle = &ZRuntime::RX;
    });
    if started.join().is_err() {
        debug!("zenoh failed to start its reading threads: it tries again with the first client");
    }
}

/// What zenoh says, without the places in its source.
fn reason(text: &str) -> String {
    if text.contains("Address already in use") {
        return "the address is in use".to_owned();
    }
    text.split(" at /").next().unwrap_or(text).to_owned()
}

/// Every setting that differs from zenoh's own default, each measured to matter.
fn settings(listen: &[String], max_clients: usize) -> Vec<(&'static str, Value)> {
    vec![
        // A zenoh router forwards claims to other routers, but not from one peer to another.
        ("mode", json!("router")),
        // The daemon opens no connections, so there is nothing to wait for.
        ("scouting/delay", json!(0)),
        ("listen/endpoints", json!(listen)),
        // Nobody joins whom they did not name.
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        // A query of it that meets a client's declaration locks up the whole session for good.
        ("adminspace/enabled", json!(false)),
        // Sequence numbers order events. After the clock is set back zenoh logs two lines for every
        // sample with a timestamp, until the clock catches up.
        ("timestamping/enabled", json!(false)),
        ("transport/shared_memory/enabled", json!(false)),
        // Silent connections must not lock out new clients.
        ("transport/unicast/accept_timeout", json!(2000)),
        ("transport/unicast/accept_pending", json!(1000)),
        (
            "transport/unicast/max_sessions",
            json!(max_clients + SESSIONS_TO_REFUSE),
        ),
        // A client that is gone is noticed within three seconds.
        ("transport/link/tx/lease", json!(3000)),
        (
            "transport/link/rx/max_message_size",
            json!(MAX_MESSAGE_BYTES),
        ),
    ]
}

/// How whoever opens a session proves who they are: by their password, and over TLS by their
/// certificate too.
fn proofs(folder: &Folder) -> [(&'static str, Value); 2] {
    let ([authority, _], [certificate, key]) = (folder.authority(), folder.daemon());
    [
        (
            "transport/auth/usrpwd/dictionary_file",
            json!(folder.passwords_file()),
        ),
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

/// Whether an address says more of how it is to be listened on than the interface, as
/// `0.0.0.0:7447#enable_mtls=false` does: to zenoh that stands above the settings.
fn has_settings_of_its_own(address: &str) -> bool {
    let Some((_, settings)) = address.split_once('#') else {
        return false;
    };
    settings
        .split(';')
        .any(|setting| !setting.starts_with("iface="))
}

/// Whether only this machine can reach `endpoint`.
fn is_local(endpoint: &str) -> bool {
    let Some((protocol, rest)) = endpoint.split_once('/') else {
        return false;
    };
    let address = rest.split(['?', '#']).next().unwrap_or(rest);
    match protocol {
        "unixsock-stream" => true,
        "tcp" => match address.parse::<SocketAddr>() {
            Ok(address) => address.ip().is_loopback(),
            Err(_) => address.rsplit_once(':').is_some_and(|(host, _)| {
                host == "localhost" || host.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
            }),
        },
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
    fn others_are_let_in_by_tls_alone_and_only_if_people_are_known() {
        let check = |endpoint: &str, are_known| check(&[endpoint.to_owned()], are_known);
        assert!(check("tls/0.0.0.0:7447", true).is_ok());
        assert!(check("tls/0.0.0.0:7447#iface=eth0", true).is_ok());
        assert!(check("tcp/127.0.0.1:7447", true).is_ok());
        for settings in ["enable_mtls=false", "iface=eth0;enable_mtls=false", ""] {
            let refused = check(&format!("tls/0.0.0.0:7447#{settings}"), true);
            assert!(
                matches!(refused, Err(SessionError::OtherTls(_))),
                "{settings}"
            );
        }
        for endpoint in ["tls/0.0.0.0:7447", "tls/127.0.0.1:7447"] {
            let refused = check(endpoint, false);
            assert!(
                matches!(refused, Err(SessionError::NobodyKnown(_))),
                "{endpoint}"
            );
        }
        for endpoint in ["tcp/0.0.0.0:7447", "quic/0.0.0.0:7447", "ws/10.0.0.1:1"] {
            let refused = check(endpoint, true);
            assert!(
                matches!(refused, Err(SessionError::NotLoopback(_))),
                "{endpoint}"
            );
        }
        assert!(matches!(
            check("7447", true),
            Err(SessionError::NoEndpoint(_))
        ));
    }
}
