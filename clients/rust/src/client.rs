//! The client: a session with a daemon, its subscriptions, and queries with retries.

use std::collections::HashMap;
use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant, SystemTime};

use jostle_proto::claim::Claimant;
use jostle_proto::{Credentials, JSON, Request, keys};
use zenoh::Session;
use zenoh::handlers::{IntoHandler, RingChannel, RingChannelHandler};
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};

use crate::connect::{self, ConnectOptions};
use crate::error::Error;
use crate::payload::Payload;
use crate::retry::RetryPolicy;
use crate::wait_numbers::WaitNumbers;

/// How much longer than the daemon the client waits, so that it receives the daemon's timeout error.
pub(crate) const TIMEOUT_MARGIN: Duration = Duration::from_secs(2);
/// The timeout of closing the session.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(1);
/// The longest that a daemon holds a request.
const MAX_HELD: Duration = Duration::from_secs(3600);

/// The interval of checks for a connection.
const CONNECTION_POLL_INTERVAL: Duration = Duration::from_millis(20);

/// A command without a reply is sent again after this time, then after twice as long each time: zenoh
/// loses a query that is sent while its connection breaks.
const FIRST_RESEND: Duration = Duration::from_secs(1);
const MAX_RESEND: Duration = Duration::from_secs(30);
/// The shortest timeout that the daemon accepts.
const MIN_HELD: Duration = Duration::from_millis(1);

/// A query that ends without a reply after this share of its timeout ended because of it.
const LATE_SHARE: f64 = 0.9;

/// A session with a daemon. Clones share it.
///
/// zenoh requires a multi-thread runtime of tokio: `#[tokio::main(flavor = "multi_thread")]`.
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
    pub next_request: Arc<AtomicU64>,
    connections_lost: Arc<AtomicU64>,
    /// Targets whose claims were checked, each with the number of connections lost before, and the
    /// daemons that serve it.
    pub uncontested: Mutex<HashMap<String, (u64, Servers)>>,
    /// The data of runs of daemons, by instance.
    pub data_ids: Arc<DataIds>,
    pub waits: Arc<Mutex<WaitNumbers>>,
}

/// The daemons that serve a name: one, while no two claim it.
pub(crate) type Servers = Arc<[Claimant]>;

/// The ids of the data of runs of daemons, by instance; `None` of a daemon that does not say.
pub(crate) type DataIds = Mutex<HashMap<String, Option<String>>>;

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
pub struct Subscription {
    received: RingChannelHandler<Received>,
    _subscriber: Subscriber<()>,
}

type Received = (Sample, SystemTime);

/// A queue of samples with the times at which they were received, and what reads it.
fn queue(capacity: usize) -> (impl Fn(Sample) + Send + Sync, RingChannelHandler<Received>) {
    let (queue, received) = RingChannel::new(capacity).into_handler();
    (
        move |sample| queue.call((sample, SystemTime::now())),
        received,
    )
}

impl Subscription {
    pub(crate) async fn sample(&self) -> Result<Sample, Error> {
        Ok(self.received().await?.0)
    }

    async fn received(&self) -> Result<Received, Error> {
        self.received.recv_async().await.map_err(Error::internal)
    }

    pub(crate) fn try_next(&self) -> Option<Payload> {
        let (sample, at) = self.received.try_recv().ok().flatten()?;
        Some(Payload::received(&sample, at))
    }

    /// The next sample.
    ///
    /// Cancel safety: no sample is lost; the next call returns it.
    ///
    /// # Errors
    ///
    /// [`Error::Internal`] after the session was closed.
    pub async fn next(&self) -> Result<Payload, Error> {
        let (sample, at) = self.received().await?;
        Ok(Payload::received(&sample, at))
    }
}

impl Client {
    /// Connects to a daemon. Waits for it, at most [`ConnectOptions::wait`], while it is not there yet or
    /// recovers its swarms.
    ///
    /// Cancel safety: the session is closed; call it again.
    ///
    /// # Errors
    ///
    /// [`Error::Runtime`] in a current-thread runtime; [`Error::Option`] for invalid options or unreadable
    /// credentials; [`Error::NoDaemon`], [`Error::UnknownHost`], [`Error::Mute`], [`Error::NotAdmitted`] or
    /// [`Error::WrongName`] if the session cannot be opened; [`Error::Rejected`] with `busy` if the daemon
    /// still recovers its swarms at the end of the timeout.
    pub async fn connect(options: ConnectOptions) -> Result<Self, Error> {
        if !connect::has_runtime() {
            return Err(Error::Runtime);
        }
        let identity = options.identity()?;
        let endpoint = options.endpoint_of(identity.as_ref());
        let deadline = Instant::now() + options.wait.min(options.timeout);
        let session = connect::open(&endpoint, &options, identity.as_ref(), deadline).await?;
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
        let client = Client(Arc::new(Inner {
            session,
            endpoint,
            prefix: options.prefix,
            node: options.node,
            credentials: identity.map(|it| it.credentials),
            timeout: options.timeout,
            name: options.client.unwrap_or_else(connect::user_and_host),
            next_request: Arc::default(),
            connections_lost,
            uncontested: Mutex::default(),
            data_ids: Arc::default(),
            waits: Arc::default(),
        }));
        if !options.wait.is_zero()
            && let Err(error) = client.await_recovery(deadline).await
        {
            client.close().await;
            return Err(error);
        }
        Ok(client)
    }

    /// A client of the same session, each of whose requests has this timeout.
    #[must_use]
    pub fn with_timeout(&self, timeout: Duration) -> Self {
        let this = &self.0;
        Client(Arc::new(Inner {
            session: this.session.clone(),
            endpoint: this.endpoint.clone(),
            prefix: this.prefix.clone(),
            node: this.node.clone(),
            credentials: this.credentials.clone(),
            timeout,
            name: this.name.clone(),
            next_request: this.next_request.clone(),
            connections_lost: this.connections_lost.clone(),
            uncontested: Mutex::default(),
            data_ids: this.data_ids.clone(),
            waits: this.waits.clone(),
        }))
    }

    /// Closes the session, which ends it for all clones.
    ///
    /// Cancel safety: the session may be closed; call it again.
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
    /// Cancel safety: the subscription ends; call it again.
    ///
    /// # Errors
    ///
    /// [`Error::Internal`] if the key is invalid or the session closed.
    pub async fn subscribe(&self, key: &str, capacity: usize) -> Result<Subscription, Error> {
        let (queue, received) = queue(capacity);
        let subscriber = self.0.session.declare_subscriber(key).callback(queue).await;
        Ok(Subscription {
            received,
            _subscriber: subscriber.map_err(Error::internal)?,
        })
    }

    /// Subscribes to liveliness tokens, including those that are declared already.
    pub(crate) async fn subscribe_tokens(&self, key: &str) -> Result<Subscription, Error> {
        /// Tokens of one swarm, or of all daemons in reach.
        const CAPACITY: usize = 64;
        let subscriber = self.0.session.liveliness().declare_subscriber(key);
        let (queue, received) = queue(CAPACITY);
        let subscriber = subscriber.history(true).callback(queue).await;
        Ok(Subscription {
            received,
            _subscriber: subscriber.map_err(Error::internal)?,
        })
    }

    /// Sends a query, with retries until the timeout of the client. With a payload, a [`Request`] as
    /// JSON, it is a command.
    ///
    /// Cancel safety: as [`Client::command`].
    ///
    /// # Errors
    ///
    /// As [`Client::command`]; [`Error::Decode`] if the payload is no request.
    pub async fn query(
        &self,
        target: Target<'_>,
        key: &str,
        payload: Option<Vec<u8>>,
    ) -> Result<Payload, Error> {
        let request = payload.map(|payload| Request::from_json(&payload));
        let request = request.transpose().map_err(Error::decode)?;
        let timeout = self.0.timeout;
        self.query_within(target, key, request, timeout, timeout)
            .await
    }

    /// [`Client::query`] with other limits: `timeout`, and how long every attempt may fail.
    pub(crate) async fn query_within(
        &self,
        target: Target<'_>,
        key: &str,
        mut request: Option<Request>,
        timeout: Duration,
        failing: Duration,
    ) -> Result<Payload, Error> {
        let began = Instant::now();
        let deadline = began + timeout;
        let mut policy = RetryPolicy::new(deadline, failing);
        let mut resend = FIRST_RESEND;
        // The daemons that may have executed the command.
        let mut sent_to: Option<Servers> = None;
        let lost_before = self.connections_lost();
        let was_connected = self.is_connected().await;
        if !was_connected {
            self.await_connection(deadline.min(began + failing)).await;
        }
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let left = left.max(MIN_HELD);
            let wait = match &mut request {
                Some(request) => {
                    request.timeout_secs = Some(hold_time(left).as_secs_f64());
                    match left > resend {
                        true => resend,
                        false => left + TIMEOUT_MARGIN,
                    }
                }
                None => hold_time(left) + TIMEOUT_MARGIN,
            };
            let was_sent = sent_to.is_some();
            let attempt = self.attempt(target, key, request.as_ref(), wait, &mut sent_to);
            let error = match attempt.await {
                Ok(Some(reply)) => return Ok(reply),
                Ok(None) => return Err(self.forgotten()),
                Err(error) => error,
            };
            if !was_sent && error.is_busy() {
                // This attempt has executed nothing.
                sent_to = None;
            }
            if request.is_some() && matches!(error, Error::TimedOut { .. }) {
                if Instant::now() >= deadline {
                    return Err(Error::TimedOut {
                        target: target.to_string(),
                        secs: timeout.as_secs_f64(),
                    });
                }
                // The command takes long; the connection is fine.
                policy.reset();
                resend = MAX_RESEND.min(2 * resend);
                continue;
            }
            let is_interrupted = !was_connected
                || self.connections_lost() != lost_before
                || self.is_gone(target, &error).await;
            match policy.delay(&error, is_interrupted, Instant::now()) {
                Some(delay) => tokio::time::sleep(delay).await,
                // A caller that gives failures no time asks again itself.
                None if error.is_silence() && !policy.is_settled() && !failing.is_zero() => {
                    return Err(self.explain_unsettled(error).await);
                }
                None => return Err(error),
            }
            self.await_connection(policy.give_up_at()).await;
        }
    }

    /// Sends a request once. `None` if it is a command that `sent_to` may have executed, and the daemon that
    /// serves the name now does not know that.
    async fn attempt(
        &self,
        target: Target<'_>,
        key: &str,
        request: Option<&Request>,
        wait: Duration,
        sent_to: &mut Option<Servers>,
    ) -> Result<Option<Payload>, Error> {
        if let Some(before) = &sent_to
            && !self.is_known(target, key, before).await?
        {
            return Ok(None);
        }
        let mut servers = self.check_contested(target).await?;
        if let (Some(request), None) = (request, &sent_to) {
            if servers.is_empty() {
                // No daemon serves the name: any may begin to, such as one behind a router.
                servers = self.serving(Target::Node("*")).await?.into();
            }
            if servers.is_empty() {
                // A daemon without claims is one of an earlier version.
                let nodes = self.tokens(&keys::node_alive(self.prefix(), "*")).await?;
                if nodes.is_empty() {
                    return Err(self.no_node().await);
                }
            }
            let left = Duration::from_secs_f64(request.timeout_secs.unwrap_or_default());
            self.learn_data_ids(&servers, left).await;
            *sent_to = Some(servers);
        }
        let payload = request.map(serde_json::to_vec).transpose();
        let payload = payload.map_err(Error::internal)?;
        let reply = self.query_once(target, key, payload, wait).await?;
        Ok(Some(reply))
    }

    /// The error of a command whose daemon is gone.
    fn forgotten(&self) -> Error {
        Error::NoDaemon {
            endpoint: self.0.endpoint.clone(),
            cause: "the daemon that got the command is gone, perhaps after executing it, and the one there now \
                    does not know that"
                .into(),
        }
    }

    /// Whether the session is connected to a daemon or a router.
    pub(crate) async fn is_connected(&self) -> bool {
        let info = self.0.session.info();
        info.peers_zid().await.next().is_some() || info.routers_zid().await.next().is_some()
    }

    /// Waits at most until `deadline` while zenoh reconnects.
    pub(crate) async fn await_connection(&self, deadline: Instant) {
        while !self.is_connected().await && !self.0.session.is_closed() && Instant::now() < deadline
        {
            tokio::time::sleep(CONNECTION_POLL_INTERVAL).await;
        }
    }

    /// Sends a query once; returns the first reply.
    ///
    /// Cancel safety: as [`Client::command`].
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
