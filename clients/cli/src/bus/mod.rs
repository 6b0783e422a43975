//! The session with the daemon: requests out, answers in.

mod again;
mod answer;
mod opening;
mod presence;
mod tls;

use std::collections::HashSet;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use jostle_proto::keys;
use jostle_proto::verbs::DiscardArgs;
use jostle_proto::{
    Error, Experiments, Hello, JSON, NodeReply, Recordings, Request, SwarmSummary, Swarms,
};
use serde::Serialize;
use zenoh::Session;
use zenoh::handlers::{RingChannel, RingChannelHandler};
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};

use crate::arguments::{GlobalArguments, SenderArguments, SendingArguments};
use crate::bus::again::Again;
pub use crate::bus::answer::Answer;
use crate::bus::opening::Identity;
pub use crate::bus::presence::node_of;
use crate::bus::tls::WrongName;
use crate::failure::Failure;

/// How much longer than the daemon a client waits, so that the daemon's own answer arrives.
const MARGIN: Duration = Duration::from_secs(2);
/// How long a goodbye may take.
const CLOSING: Duration = Duration::from_secs(1);
/// The longest a daemon holds a request.
const LONGEST_HELD_SECS: f64 = 3600.0;
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
    token: Option<String>,
    page: Option<String>,
    user_and_host: String,
    timeout_secs: f64,
    asked: AtomicU64,
    /// How many connections were lost.
    lost: Arc<AtomicU64>,
    /// Names whose claims were checked, each with the number of connections lost by then.
    looked: Mutex<HashSet<(String, u64)>>,
}

/// Who is asked.
#[derive(Clone, Copy)]
pub enum Whom<'a> {
    /// A swarm.
    Swarm(&'a str),
    /// A daemon.
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
            credentials,
            node,
            prefix,
            timeout,
            json: _,
        } = global;
        let identity = Identity::given(credentials.as_deref())?;
        let endpoint = opening::endpoint(endpoint, identity.as_ref());
        let config = opening::config(&endpoint, timeout, identity.as_ref())?;
        let session = match zenoh::open(config).await {
            Ok(session) => session,
            Err(_) if opening::speaks_zenoh(&endpoint) => {
                let wrong_name = identity.as_ref().and_then(|it| it.wrong_name(&endpoint));
                return Err(match wrong_name {
                    Some(WrongName { host, names }) => Failure::WrongName {
                        endpoint,
                        host,
                        names,
                    },
                    None => Failure::NotLetIn {
                        endpoint,
                        person: identity.map(|it| it.credentials.person),
                    },
                });
            }
            Err(error) => {
                return Err(Failure::NoDaemon {
                    endpoint,
                    cause: opening::words(&error),
                });
            }
        };
        let lost = Arc::new(AtomicU64::new(0));
        let counting = lost.clone();
        session
            .info()
            .transport_events_listener()
            .callback(move |event| {
                if event.kind() == SampleKind::Delete {
                    counting.fetch_add(1, Ordering::SeqCst);
                }
            })
            .background()
            .await
            .map_err(Failure::defect)?;
        Ok(Bus {
            session,
            endpoint,
            prefix,
            node,
            page: identity.as_ref().and_then(|it| it.credentials.page.clone()),
            token: identity.map(|it| it.credentials.token),
            user_and_host: opening::user_and_host(),
            timeout_secs: timeout,
            asked: AtomicU64::new(0),
            lost,
            looked: Mutex::default(),
        })
    }

    /// Where a daemon would be looked for.
    ///
    /// # Errors
    ///
    /// [`Failure::Argument`] when the credentials cannot be read.
    pub fn endpoint_for(global: &GlobalArguments) -> Result<String, Failure> {
        let identity = Identity::given(global.credentials.as_deref())?;
        Ok(opening::endpoint(
            global.endpoint.clone(),
            identity.as_ref(),
        ))
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

    /// What the daemon's page takes for this person's, if it is one.
    pub fn token(&self) -> Option<&str> {
        self.token.as_deref()
    }

    /// Where the credentials say that the daemon's page is.
    pub fn page(&self) -> Option<&str> {
        self.page.as_deref()
    }

    /// Where the daemon is reached.
    pub fn endpoint(&self) -> &str {
        &self.endpoint
    }

    /// The first chunk of every key.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// How many connections were lost so far.
    pub fn lost(&self) -> u64 {
        self.lost.load(Ordering::SeqCst)
    }

    /// Executes a verb on a swarm, once, however often it has to be sent.
    ///
    /// # Errors
    ///
    /// What the daemon says, or why it says nothing.
    pub async fn command<A: Serialize + Sync>(
        &self,
        swarm: &str,
        verb: &str,
        args: &A,
        sending: &SendingArguments,
    ) -> Result<Answer, Failure> {
        let key = keys::cmd(&self.prefix, swarm, verb);
        let payload = payload(&Request {
            at_step: sending.at_step,
            expect_epoch: sending.expect_epoch,
            expect_step: sending.expect_step,
            ..self.request(args, &sending.sender)?
        })?;
        if payload.len() > SURELY_FITS {
            // Without a token there is no swarm, which the daemon's silence will tell.
            if let Some(node) = self.hosts_of(swarm).await?.first() {
                self.check_length(node, payload.len()).await?;
            }
        }
        self.ask_again(Whom::Swarm(swarm), &key, Some(payload))
            .await
    }

    /// Executes a verb on the daemon, once, however often it has to be sent.
    ///
    /// # Errors
    ///
    /// What the daemon says, or why it says nothing.
    pub async fn command_node<A: Serialize + Sync>(
        &self,
        verb: &str,
        args: &A,
        sender: &SenderArguments,
    ) -> Result<Answer, Failure> {
        let node = self.node().await?;
        let payload = payload(&self.request(args, sender)?)?;
        self.check_length(&node, payload.len()).await?;
        let key = keys::node_cmd(&self.prefix, &node, verb);
        self.ask_again(Whom::Node(&node), &key, Some(payload)).await
    }

    /// Deletes one daemon's swarm, and no other daemon's of the same name.
    ///
    /// # Errors
    ///
    /// What the daemon says, or why it says nothing.
    pub async fn discard(&self, swarm: &str, sender: &SenderArguments) -> Result<Answer, Failure> {
        let args = DiscardArgs {
            name: swarm.to_owned(),
        };
        self.command_node("discard", &args, sender).await
    }

    /// The node given by `--node`, if any.
    pub fn named_node(&self) -> Option<&str> {
        self.node.as_deref()
    }

    /// Asks a swarm something, such as `status` or `events?after=7`.
    ///
    /// # Errors
    ///
    /// What the daemon says, or why it says nothing.
    pub async fn get(&self, swarm: &str, noun: &str) -> Result<Answer, Failure> {
        let key = keys::get(&self.prefix, swarm, noun);
        self.ask_again(Whom::Swarm(swarm), &key, None).await
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
        self.ask_again(Whom::Swarm(swarm), &key, None).await
    }

    /// Asks the daemon something.
    ///
    /// # Errors
    ///
    /// What the daemon says, or why it says nothing.
    pub async fn get_node(&self, noun: &str) -> Result<Answer, Failure> {
        let node = self.node().await?;
        let key = keys::node_get(&self.prefix, &node, noun);
        self.ask_again(Whom::Node(&node), &key, None).await
    }

    /// The swarms of a daemon, ordered by name.
    ///
    /// # Errors
    ///
    /// What the daemon says, or why it says nothing.
    pub async fn swarms_of(&self, node: &str) -> Result<Vec<SwarmSummary>, Failure> {
        let key = keys::node_get(&self.prefix, node, "swarms");
        let answer = self.ask_again(Whom::Node(node), &key, None).await?;
        let reply: NodeReply<Swarms> = answer.read()?;
        Ok(reply.result.swarms)
    }

    /// The key of what an experiment tells, such as its `progress`.
    ///
    /// # Errors
    ///
    /// That there is no node to have it, or several.
    pub async fn experiment_key(&self, experiment: &str, noun: &str) -> Result<String, Failure> {
        let node = self.node().await?;
        Ok(keys::experiment(&self.prefix, &node, experiment, noun))
    }

    /// Asks about an experiment, such as `progress` or `results?after=7`.
    ///
    /// # Errors
    ///
    /// What the daemon says, or why it says nothing.
    pub async fn get_experiment(&self, experiment: &str, noun: &str) -> Result<Answer, Failure> {
        let node = self.node().await?;
        let key = keys::experiment(&self.prefix, &node, experiment, noun);
        self.ask_again(Whom::Node(&node), &key, None).await
    }

    /// The names of the daemon's experiments.
    ///
    /// # Errors
    ///
    /// What the daemon says, or why it says nothing.
    pub async fn experiments(&self) -> Result<Vec<String>, Failure> {
        let reply: NodeReply<Experiments> = self.get_node("experiments").await?.read()?;
        let experiments = reply.result.experiments.into_iter();
        Ok(experiments.map(|it| it.name).collect())
    }

    /// The names of the daemon's recordings.
    ///
    /// # Errors
    ///
    /// What the daemon says, or why it says nothing.
    pub async fn recordings(&self) -> Result<Vec<String>, Failure> {
        let reply: NodeReply<Recordings> = self.get_node("recordings").await?.read()?;
        let recordings = reply.result.recordings.into_iter();
        Ok(recordings.map(|it| it.recording).collect())
    }

    /// Sends the same request until it is answered, a repetition cannot help or the time is over.
    ///
    /// # Errors
    ///
    /// What the daemon says, or why it says nothing.
    pub async fn ask_again(
        &self,
        whom: Whom<'_>,
        key: &str,
        payload: Option<Vec<u8>>,
    ) -> Result<Answer, Failure> {
        let deadline = Instant::now() + Duration::from_secs_f64(self.timeout_secs);
        let mut again = Again::until(deadline, payload.is_some());
        let lost_before = self.lost();
        self.check_contested(whom).await?;
        loop {
            let failure = match self.ask(whom, key, payload.clone(), self.patience()).await {
                Ok(answer) => return Ok(answer),
                Err(failure) => failure,
            };
            let is_cut_off = self.lost() != lost_before;
            match again.rest(&failure, is_cut_off, Instant::now()) {
                Some(rest) => tokio::time::sleep(rest).await,
                None => return Err(failure),
            }
        }
    }

    /// Sends one query and returns its first answer.
    ///
    /// # Errors
    ///
    /// What the daemon says, or why it says nothing.
    pub async fn ask(
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
        if let Some(token) = &self.token {
            query = query.attachment(token);
        }
        let replies = query.await.map_err(Failure::unreadable)?;
        let Ok(reply) = replies.recv_async().await else {
            return Err(self.explain_silence(whom, selector).await);
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
                Err(Failure::refused(error))
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
        sender: &SenderArguments,
    ) -> Result<Request, Failure> {
        let new_id = || {
            let number = self.asked.fetch_add(1, Ordering::Relaxed);
            format!("{}-{number}", self.session.zid())
        };
        let client = sender.client.as_ref().unwrap_or(&self.user_and_host);
        Ok(Request {
            request_id: Some(sender.request_id.clone().unwrap_or_else(new_id)),
            client: Some(client.clone()),
            timeout_secs: Some(self.timeout_secs.min(LONGEST_HELD_SECS)),
            args: Some(serde_json::value::to_raw_value(args).map_err(Failure::defect)?),
            ..Request::default()
        })
    }

    fn patience(&self) -> Duration {
        Duration::from_secs_f64(self.timeout_secs.min(LONGEST_HELD_SECS)) + MARGIN
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

fn payload(request: &Request) -> Result<Vec<u8>, Failure> {
    serde_json::to_vec(request).map_err(Failure::defect)
}
