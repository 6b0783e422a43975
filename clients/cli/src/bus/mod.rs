//! The session with the daemon: requests out, answers in.

mod answer;
mod opening;
mod presence;

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use jostle_proto::keys;
use jostle_proto::{Error, Hello, JSON, NodeReply, Request};
use serde::Serialize;
use zenoh::Session;
use zenoh::handlers::{RingChannel, RingChannelHandler};
use zenoh::pubsub::Subscriber;
use zenoh::sample::Sample;

use crate::arguments::GlobalArguments;
pub use crate::bus::answer::Answer;
pub use crate::bus::presence::node_of;
use crate::failure::Failure;

/// How much longer than the daemon a client waits, so that the daemon's own answer arrives.
const MARGIN: Duration = Duration::from_secs(2);
/// How long a goodbye may take.
const CLOSING: Duration = Duration::from_secs(1);
/// Payloads up to this length pass every daemon's limit.
const SURELY_FITS: usize = 256 * 1024;

/// What is published, or tokens; the oldest are dropped when nobody keeps up.
pub type Samples = Subscriber<RingChannelHandler<Sample>>;

/// A session with a daemon.
pub struct Bus {
    session: Session,
    endpoint: String,
    prefix: String,
    node: Option<String>,
    client: String,
    timeout_secs: f64,
    expect_step: Option<u64>,
    asked: AtomicU64,
}

/// Who is asked.
#[derive(Clone, Copy)]
enum Whom<'a> {
    Swarm(&'a str),
    Node(&'a str),
}

impl Bus {
    /// Connects to the daemon, or says that none answers.
    ///
    /// # Errors
    ///
    /// [`Failure::NoDaemon`], or [`Failure::Argument`] when the endpoint cannot be used.
    pub async fn open(global: GlobalArguments) -> Result<Self, Failure> {
        let GlobalArguments {
            endpoint,
            node,
            prefix,
            timeout,
            expect_step,
            client,
            json: _,
        } = global;
        let config = opening::config(&endpoint, timeout)?;
        let session = zenoh::open(config)
            .await
            .map_err(|error| Failure::NoDaemon {
                endpoint: endpoint.clone(),
                cause: opening::words(&error),
            })?;
        Ok(Bus {
            session,
            endpoint,
            prefix,
            node,
            client: client.unwrap_or_else(opening::user_and_host),
            timeout_secs: timeout,
            expect_step,
            asked: AtomicU64::new(0),
        })
    }

    /// Says goodbye.
    pub async fn close(&self) {
        // The daemon notices anyway; a stuck connection must not hold up the shell.
        let _ = tokio::time::timeout(CLOSING, async { self.session.close().await }).await;
    }

    /// Subscribes to what is published; the latest win.
    ///
    /// # Errors
    ///
    /// [`Failure::Unreadable`] when zenoh does not take the key.
    pub async fn subscribe(&self, key: &str, backlog: usize) -> Result<Samples, Failure> {
        self.session
            .declare_subscriber(key)
            .with(RingChannel::new(backlog))
            .await
            .map_err(Failure::unreadable)
    }

    /// The first chunk of every key.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Executes a verb on a swarm.
    ///
    /// # Errors
    ///
    /// What the daemon says, or why it says nothing.
    pub async fn command<A: Serialize + Sync>(
        &self,
        swarm: &str,
        verb: &str,
        args: &A,
    ) -> Result<Answer, Failure> {
        let key = keys::cmd(&self.prefix, swarm, verb);
        let payload = self.request(args, self.expect_step)?;
        if payload.len() > SURELY_FITS {
            // Without a token there is no swarm, which the daemon's silence will tell.
            if let Some(node) = self.hosts_of(swarm).await?.first() {
                self.check_length(node, payload.len()).await?;
            }
        }
        self.ask(Whom::Swarm(swarm), &key, Some(payload), self.patience())
            .await
    }

    /// Executes a verb on the daemon.
    ///
    /// # Errors
    ///
    /// What the daemon says, or why it says nothing.
    pub async fn command_node<A: Serialize + Sync>(
        &self,
        verb: &str,
        args: &A,
    ) -> Result<Answer, Failure> {
        let node = self.node().await?;
        let payload = self.request(args, None)?;
        self.check_length(&node, payload.len()).await?;
        let key = keys::node_cmd(&self.prefix, &node, verb);
        self.ask(Whom::Node(&node), &key, Some(payload), self.patience())
            .await
    }

    /// Asks a swarm something.
    ///
    /// # Errors
    ///
    /// What the daemon says, or why it says nothing.
    pub async fn get(&self, swarm: &str, noun: &str) -> Result<Answer, Failure> {
        let key = keys::get(&self.prefix, swarm, noun);
        self.ask(Whom::Swarm(swarm), &key, None, self.patience())
            .await
    }

    /// Asks a swarm to answer when `what`, such as `step=5000`, has come about; the daemon holds
    /// the question up to `held`.
    ///
    /// # Errors
    ///
    /// What the daemon says, or why it says nothing.
    pub async fn wait(&self, swarm: &str, what: &str, held: Duration) -> Result<Answer, Failure> {
        let key = keys::get(&self.prefix, swarm, "wait");
        let selector = format!("{key}?{what};timeout_secs={}", held.as_secs_f64());
        self.ask(Whom::Swarm(swarm), &selector, None, held + MARGIN)
            .await
    }

    /// A swarm's state as it is now, in CBOR.
    ///
    /// # Errors
    ///
    /// What the daemon says, or why it says nothing.
    pub async fn state(&self, swarm: &str) -> Result<Answer, Failure> {
        let key = keys::state(&self.prefix, swarm);
        self.ask(Whom::Swarm(swarm), &key, None, self.patience())
            .await
    }

    /// Asks the daemon something.
    ///
    /// # Errors
    ///
    /// What the daemon says, or why it says nothing.
    pub async fn get_node(&self, noun: &str) -> Result<Answer, Failure> {
        let node = self.node().await?;
        let key = keys::node_get(&self.prefix, &node, noun);
        self.ask(Whom::Node(&node), &key, None, self.patience())
            .await
    }

    /// Sends one query and returns its first answer.
    async fn ask(
        &self,
        whom: Whom<'_>,
        selector: &str,
        payload: Option<Vec<u8>>,
        patience: Duration,
    ) -> Result<Answer, Failure> {
        let mut query = self.session.get(selector).timeout(patience);
        if let Some(payload) = payload {
            query = query.payload(payload).encoding(JSON);
        }
        let replies = query.await.map_err(Failure::unreadable)?;
        let Ok(reply) = replies.recv_async().await else {
            return Err(self.explain_silence(whom).await);
        };
        match reply.into_result() {
            Ok(sample) => Ok(Answer::from(&sample)),
            // zenoh's own word, with one encoding or another; the daemon speaks JSON.
            Err(error) if *error.payload().to_bytes() == *b"Timeout" => Err(Failure::TimedOut {
                whom: whom.to_string(),
                secs: patience.as_secs_f64(),
            }),
            Err(error) => {
                let error: Error = serde_json::from_slice(&error.payload().to_bytes())
                    .map_err(Failure::unreadable)?;
                Err(Failure::Refused(Box::new(error)))
            }
        }
    }

    /// zenoh drops what is too long without a word, so it is refused here.
    async fn check_length(&self, node: &str, bytes: usize) -> Result<(), Failure> {
        if bytes <= SURELY_FITS {
            return Ok(());
        }
        let key = keys::node_get(&self.prefix, node, "hello");
        let answer = self.ask(Whom::Node(node), &key, None, self.patience());
        let hello: NodeReply<Hello> = answer.await?.read()?;
        let (bytes, limit) = (bytes as u64, hello.result.limits.max_message_bytes);
        if bytes > limit {
            return Err(Failure::TooLarge { bytes, limit });
        }
        Ok(())
    }

    /// The envelope around a verb's arguments.
    fn request<A: Serialize>(
        &self,
        args: &A,
        expect_step: Option<u64>,
    ) -> Result<Vec<u8>, Failure> {
        let number = self.asked.fetch_add(1, Ordering::Relaxed);
        let request = Request {
            request_id: Some(format!("{}-{number}", self.session.zid())),
            client: Some(self.client.clone()),
            expect_step,
            timeout_secs: Some(self.timeout_secs),
            args: Some(serde_json::value::to_raw_value(args).map_err(Failure::defect)?),
            ..Request::default()
        };
        serde_json::to_vec(&request).map_err(Failure::defect)
    }

    fn patience(&self) -> Duration {
        Duration::from_secs_f64(self.timeout_secs) + MARGIN
    }
}

impl std::fmt::Display for Whom<'_> {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Whom::Swarm(swarm) => formatter.write_str(swarm),
            Whom::Node(node) => write!(formatter, "node {node}"),
        }
    }
}
