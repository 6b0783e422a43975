//! The client: a session with a daemon, its subscriptions, and queries with retries.

use std::collections::HashSet;
use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use jostle_proto::{Credentials, JSON};
use zenoh::Session;
use zenoh::handlers::{RingChannel, RingChannelHandler};
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};

use crate::connect::{self, ConnectOptions};
use crate::error::Error;
use crate::payload::Payload;
use crate::retry::RetryPolicy;
use crate::tls::WrongName;

/// How much longer than the daemon the client waits, so that it receives the daemon's timeout error.
pub(crate) const TIMEOUT_MARGIN: Duration = Duration::from_secs(2);
/// The timeout of closing the session.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(1);
/// The longest that a daemon holds a request.
const MAX_HELD: Duration = Duration::from_secs(3600);

/// A query that ends without a reply after this share of its timeout ended because of it.
const LATE_SHARE: f64 = 0.9;

/// A session with a daemon. Clones share it.
///
/// zenoh requires a multi-thread runtime of tokio.
#[derive(Clone)]
pub struct Client(pub(crate) Arc<Inner>);

pub(crate) struct Inner {
    pub session: Session,
    pub endpoint: String,
    pub prefix: String,
    pub node: Option<String>,
    pub credentials: Option<Credentials>,
    pub timeout: Duration,
    /// The name of the sender in commands.
    pub name: String,
    pub next_request: AtomicU64,
    connections_lost: Arc<AtomicU64>,
    /// Targets whose claims were checked, each with the number of connections lost before.
    pub uncontested: Mutex<HashSet<(String, u64)>>,
}

/// How long the daemon may hold a request with this timeout before it replies.
pub(crate) fn hold_time(timeout: Duration) -> Duration {
    timeout.min(MAX_HELD)
}

/// The receiver of a request.
#[derive(Clone, Copy, Debug)]
pub enum Target<'a> {
    /// A swarm.
    Swarm(&'a str),
    /// A daemon.
    Node(&'a str),
}

/// A subscription with a bounded queue that drops the oldest samples.
pub struct Subscription(Subscriber<RingChannelHandler<Sample>>);

impl Subscription {
    pub(crate) async fn sample(&self) -> Result<Sample, Error> {
        self.0.recv_async().await.map_err(Error::internal)
    }

    pub(crate) fn try_next(&self) -> Option<Payload> {
        let sample = self.0.try_recv().ok().flatten()?;
        Some(Payload::from(&sample))
    }

    /// The next sample. Cancel safe.
    ///
    /// # Errors
    ///
    /// [`Error::Internal`] after the session was closed.
    pub async fn next(&self) -> Result<Payload, Error> {
        Ok(Payload::from(&self.sample().await?))
    }
}

impl Client {
    /// Connects to a daemon.
    ///
    /// # Errors
    ///
    /// [`Error::Option`] for invalid options or unreadable credentials; [`Error::NoDaemon`],
    /// [`Error::UnknownHost`], [`Error::Mute`], [`Error::NotAdmitted`] or [`Error::WrongName`] if the session cannot be opened.
    pub async fn connect(options: ConnectOptions) -> Result<Self, Error> {
        let identity = options.identity()?;
        let endpoint = options.endpoint_of(identity.as_ref());
        let config = connect::config(&endpoint, options.timeout, identity.as_ref())?;
        let began = Instant::now();
        let session = match zenoh::open(config).await {
            Ok(session) => session,
            // A daemon that rejects a client closes the connection at once.
            Err(_) if began.elapsed() < options.timeout && connect::is_listening(&endpoint) => {
                let wrong_name = identity.as_ref().and_then(|it| it.wrong_name(&endpoint));
                return Err(match wrong_name {
                    Some(WrongName { host, names }) => Error::WrongName {
                        endpoint,
                        host,
                        names,
                    },
                    None => Error::NotAdmitted {
                        endpoint,
                        person: identity.map(|it| it.credentials.person),
                    },
                });
            }
            Err(_) if let Some(host) = connect::unknown_host(&endpoint) => {
                return Err(Error::UnknownHost { endpoint, host });
            }
            Err(_) if began.elapsed() >= options.timeout && connect::is_listening(&endpoint) => {
                let secs = options.timeout.as_secs_f64();
                return Err(Error::Mute { endpoint, secs });
            }
            Err(error) => {
                let cause = connect::words(&error);
                return Err(Error::NoDaemon { endpoint, cause });
            }
        };
        let connections_lost = Arc::new(AtomicU64::new(0));
        let counter = connections_lost.clone();
        session
            .info()
            .transport_events_listener()
            .callback(move |event| {
                if event.kind() == SampleKind::Delete {
                    counter.fetch_add(1, Ordering::SeqCst);
                }
            })
            .background()
            .await
            .map_err(Error::internal)?;
        Ok(Client(Arc::new(Inner {
            session,
            endpoint,
            prefix: options.prefix,
            node: options.node,
            credentials: identity.map(|it| it.credentials),
            timeout: options.timeout,
            name: options.client.unwrap_or_else(connect::user_and_host),
            next_request: AtomicU64::new(0),
            connections_lost,
            uncontested: Mutex::default(),
        })))
    }

    /// Closes the session, which ends it for all clones.
    pub async fn close(&self) {
        // The daemon notices the end anyway; a stuck connection must not delay the caller.
        let _ = tokio::time::timeout(CLOSE_TIMEOUT, async { self.0.session.close().await }).await;
    }

    /// The zenoh session, for operations that this crate does not offer.
    pub fn session(&self) -> &Session {
        &self.0.session
    }

    /// The endpoint that it is connected to.
    pub fn endpoint(&self) -> &str {
        &self.0.endpoint
    }

    /// The first chunk of every key.
    pub fn prefix(&self) -> &str {
        &self.0.prefix
    }

    /// The daemon that was named in the options.
    pub fn named_node(&self) -> Option<&str> {
        self.0.node.as_deref()
    }

    /// The token of the credentials, which the page and every request contain.
    pub fn token(&self) -> Option<&str> {
        Some(&self.0.credentials.as_ref()?.token)
    }

    /// The URL of the page in the credentials.
    pub fn page(&self) -> Option<&str> {
        self.0.credentials.as_ref()?.page.as_deref()
    }

    /// The number of connections lost so far. The session reconnects automatically.
    pub fn connections_lost(&self) -> u64 {
        self.0.connections_lost.load(Ordering::SeqCst)
    }

    /// Subscribes to the samples of a key; the queue holds the newest `capacity`.
    ///
    /// # Errors
    ///
    /// [`Error::Internal`] if the key is invalid or the session closed.
    pub async fn subscribe(&self, key: &str, capacity: usize) -> Result<Subscription, Error> {
        let subscriber = self.0.session.declare_subscriber(key);
        let subscriber = subscriber.with(RingChannel::new(capacity)).await;
        Ok(Subscription(subscriber.map_err(Error::internal)?))
    }

    /// Subscribes to liveliness tokens, including those that are declared already.
    pub(crate) async fn subscribe_tokens(&self, key: &str) -> Result<Subscription, Error> {
        /// Tokens of one swarm, or of all daemons in reach.
        const CAPACITY: usize = 64;
        let subscriber = self.0.session.liveliness().declare_subscriber(key);
        let subscriber = subscriber.history(true).with(RingChannel::new(CAPACITY));
        Ok(Subscription(subscriber.await.map_err(Error::internal)?))
    }

    /// Sends a query, with retries until the timeout of the client. With a payload it is a command.
    ///
    /// # Errors
    ///
    /// As [`Client::command`].
    pub async fn query(
        &self,
        target: Target<'_>,
        key: &str,
        payload: Option<Vec<u8>>,
    ) -> Result<Payload, Error> {
        self.query_within(target, key, payload, self.0.timeout)
            .await
    }

    /// [`Client::query`] with another timeout.
    pub(crate) async fn query_within(
        &self,
        target: Target<'_>,
        key: &str,
        payload: Option<Vec<u8>>,
        timeout: Duration,
    ) -> Result<Payload, Error> {
        let deadline = Instant::now() + timeout;
        let mut policy = RetryPolicy::new(deadline, payload.is_some());
        let lost_before = self.connections_lost();
        let timeout = hold_time(timeout) + TIMEOUT_MARGIN;
        self.check_contested(target).await?;
        loop {
            let attempt = self.query_once(target, key, payload.clone(), timeout);
            let error = match attempt.await {
                Ok(reply) => return Ok(reply),
                Err(error) => error,
            };
            let is_interrupted = self.connections_lost() != lost_before;
            match policy.delay(&error, is_interrupted, Instant::now()) {
                Some(delay) => tokio::time::sleep(delay).await,
                None => return Err(error),
            }
        }
    }

    /// Sends a query once; returns the first reply.
    ///
    /// # Errors
    ///
    /// As [`Client::command`].
    pub async fn query_once(
        &self,
        target: Target<'_>,
        selector: &str,
        payload: Option<Vec<u8>>,
        timeout: Duration,
    ) -> Result<Payload, Error> {
        let mut query = self.0.session.get(selector).timeout(timeout);
        if let Some(payload) = payload {
            query = query.payload(payload).encoding(JSON);
        }
        if let Some(token) = self.token() {
            query = query.attachment(token);
        }
        let timed_out = || Error::TimedOut {
            target: target.to_string(),
            secs: timeout.as_secs_f64(),
        };
        let sent = Instant::now();
        let replies = query.await.map_err(Error::internal)?;
        let Ok(reply) = replies.recv_async().await else {
            // zenoh ends a query on both sides at its timeout. If the daemon's side is first, the
            // query ends without an error. A query without a receiver ends at once.
            return Err(match sent.elapsed() >= timeout.mul_f64(LATE_SHARE) {
                true => timed_out(),
                false => self.explain_silence(target, selector).await,
            });
        };
        match reply.into_result() {
            Ok(sample) => Ok(Payload::from(&sample)),
            // The error of zenoh itself, in various encodings; that of a daemon is JSON.
            Err(error) if *error.payload().to_bytes() == *b"Timeout" => Err(timed_out()),
            Err(error) => {
                let error = serde_json::from_slice(&error.payload().to_bytes());
                Err(Error::rejected(error.map_err(Error::decode)?))
            }
        }
    }
}

impl fmt::Debug for Client {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let endpoint = &self.0.endpoint;
        formatter.debug_tuple("Client").field(endpoint).finish()
    }
}

impl fmt::Display for Target<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Target::Swarm(swarm) => formatter.write_str(swarm),
            Target::Node(node) => write!(formatter, "node {node}"),
        }
    }
}
