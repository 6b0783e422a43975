//! Requests with typed arguments and replies: commands, and queries of swarms, daemons and experiments.

use std::sync::atomic::Ordering;
use std::time::Duration;

use jostle_proto::verbs::{Command, CreateArgs, CreateResult, DiscardArgs};
use jostle_proto::{
    Experiments, Hello, Measures, NodeReply, Recordings, Reply, Request, Status, SwarmSummary,
    Swarms, keys,
};
use serde::Serialize;

use crate::client::{Client, TIMEOUT_MARGIN, Target, hold_time};
use crate::error::Error;
use crate::payload::Payload;

/// The end of the cause of an [`Error::NoDaemon`] of a command: it may have been sent before the
/// connection was lost, to a daemon that is only suspended.
pub const MAY_EXECUTE: &str = "it may still execute the request if it is only suspended";

/// Every daemon accepts requests up to this length.
const ALWAYS_ACCEPTED: usize = 256 * 1024;

/// The envelope of a command; by default it is executed at once, and has a new request id.
#[derive(Clone, Debug, Default)]
pub struct CommandOptions {
    /// The step at which it is executed; for a later step the daemon replies at once.
    pub at_step: Option<u64>,
    /// Reject it with `conflict` in another epoch.
    pub expect_epoch: Option<u64>,
    /// Reject it with `conflict` at another step.
    pub expect_step: Option<u64>,
    /// The request id; a command with the id of an earlier one is not executed again.
    pub request_id: Option<String>,
    /// The name of the sender, instead of that of the client.
    pub client: Option<String>,
    /// How long it may take, instead of the timeout of the client; at most an hour.
    pub timeout: Option<Duration>,
}

impl Client {
    /// Executes a command on a swarm once, with retries, and decodes the reply.
    ///
    /// Cancel safety: the command may be executed nevertheless; [`Client::command`] with a
    /// [`request_id`](CommandOptions::request_id) can be repeated.
    ///
    /// # Errors
    ///
    /// As [`Client::command`], and [`Error::Decode`].
    pub async fn execute<C: Command>(
        &self,
        swarm: &str,
        args: &C,
    ) -> Result<Reply<C::Result>, Error> {
        let options = CommandOptions::default();
        self.command(swarm, C::VERB.name(), args, options)
            .await?
            .read()
    }

    /// Executes a verb on a swarm once, however often it is sent. The reply to a command that waits
    /// for its step is a `Reply<Scheduled>`.
    ///
    /// Cancel safety: the command may be executed nevertheless. The same call with the same
    /// [`request_id`](CommandOptions::request_id) returns its reply.
    ///
    /// # Errors
    ///
    /// [`Error::Rejected`] with the daemon's error; [`Error::NoSwarm`], [`Error::NoDaemon`],
    /// [`Error::NoNode`], [`Error::Silent`] or [`Error::TimedOut`] after the last retry;
    /// [`Error::TooLarge`].
    pub async fn command<A: Serialize + Sync>(
        &self,
        swarm: &str,
        verb: &str,
        args: &A,
        options: impl Into<CommandOptions>,
    ) -> Result<Payload, Error> {
        let options = options.into();
        let timeout = options.timeout.unwrap_or(self.0.timeout);
        let request = self.request(args, options)?;
        let bytes = length(&request)?;
        if bytes > ALWAYS_ACCEPTED
            && let Some(node) = self.hosts_of(swarm).await?.first()
        {
            self.check_length(node, bytes).await?;
        }
        let key = keys::cmd(&self.0.prefix, swarm, verb);
        let target = Target::Swarm(swarm);
        self.query_within(target, &key, Some(request), timeout, self.0.timeout)
            .await
            .map_err(may_execute)
    }

    /// Executes a verb on the daemon once, however often it is sent.
    ///
    /// Cancel safety: the command may be executed nevertheless. The same call with the same
    /// [`request_id`](CommandOptions::request_id) returns its reply.
    ///
    /// # Errors
    ///
    /// As [`Client::command`], and [`Error::ManyNodes`].
    pub async fn command_node<A: Serialize + Sync>(
        &self,
        verb: &str,
        args: &A,
        options: impl Into<CommandOptions>,
    ) -> Result<Payload, Error> {
        let options = options.into();
        let timeout = options.timeout.unwrap_or(self.0.timeout);
        let request = self.request(args, options)?;
        let node = self.node().await?;
        self.check_length(&node, length(&request)?).await?;
        let key = keys::node_cmd(&self.0.prefix, &node, verb);
        let target = Target::Node(&node);
        self.query_within(target, &key, Some(request), timeout, self.0.timeout)
            .await
            .map_err(may_execute)
    }

    /// Creates a swarm.
    ///
    /// Cancel safety: the command may be executed nevertheless; [`Client::command`] with a
    /// [`request_id`](CommandOptions::request_id) can be repeated.
    ///
    /// # Errors
    ///
    /// As [`Client::command_node`].
    pub async fn create(&self, args: &CreateArgs) -> Result<Reply<CreateResult>, Error> {
        let options = CommandOptions::default();
        self.command_node("create", args, options).await?.read()
    }

    /// Deletes the swarm on this daemon; a swarm of the same name on another daemon remains.
    ///
    /// Cancel safety: the command may be executed nevertheless. The same call with the same
    /// [`request_id`](CommandOptions::request_id) returns its reply.
    ///
    /// # Errors
    ///
    /// As [`Client::command_node`].
    pub async fn discard(
        &self,
        swarm: &str,
        options: impl Into<CommandOptions>,
    ) -> Result<Payload, Error> {
        let name = swarm.to_owned();
        self.command_node("discard", &DiscardArgs { name }, options)
            .await
    }

    /// Queries a swarm, such as `parameters` or `events?after=7`.
    ///
    /// Cancel safety: a dropped query changes nothing.
    ///
    /// # Errors
    ///
    /// As [`Client::command`].
    pub async fn get(&self, swarm: &str, noun: &str) -> Result<Payload, Error> {
        let key = keys::get(&self.0.prefix, swarm, noun);
        self.query(Target::Swarm(swarm), &key, None).await
    }

    /// The status of a swarm.
    ///
    /// Cancel safety: a dropped query changes nothing.
    ///
    /// # Errors
    ///
    /// As [`Client::command`], and [`Error::Decode`].
    pub async fn status(&self, swarm: &str) -> Result<Reply<Status>, Error> {
        self.get(swarm, "status").await?.read()
    }

    /// Measures of the newest state of a swarm, by name: `order`, `clusters.count(0.1)`; if `names` is
    /// empty all that need no earlier state.
    ///
    /// Cancel safety: a dropped query changes nothing.
    ///
    /// # Errors
    ///
    /// As [`Client::status`]; `invalid_argument` if there is no such measure or it needs earlier states.
    pub async fn measures(&self, swarm: &str, names: &[&str]) -> Result<Reply<Measures>, Error> {
        let noun = match names {
            [] => "measures".to_owned(),
            names => format!("measures?names={}", names.join(",")),
        };
        self.get(swarm, &noun).await?.read()
    }

    /// The state of a swarm, a CBOR [`State`](jostle_proto::State).
    ///
    /// Cancel safety: a dropped query changes nothing.
    ///
    /// # Errors
    ///
    /// As [`Client::command`].
    pub async fn state(&self, swarm: &str) -> Result<Payload, Error> {
        let key = keys::state(&self.0.prefix, swarm);
        self.query(Target::Swarm(swarm), &key, None).await
    }

    /// The status of a swarm once `condition` holds, such as `step=5000` or `phase=paused`. The
    /// daemon holds the query for at most `held` and then rejects it with `deadline_exceeded`. Not
    /// retried.
    ///
    /// Cancel safety: a dropped query changes nothing.
    ///
    /// # Errors
    ///
    /// As [`Client::command`].
    pub async fn wait(
        &self,
        swarm: &str,
        condition: &str,
        held: Duration,
    ) -> Result<Payload, Error> {
        let key = keys::get(&self.0.prefix, swarm, "wait");
        let selector = format!("{key}?{condition};timeout_secs={}", held.as_secs_f64());
        let target = Target::Swarm(swarm);
        self.query_once(target, &selector, None, held + TIMEOUT_MARGIN)
            .await
    }

    /// Queries the daemon.
    ///
    /// Cancel safety: a dropped query changes nothing.
    ///
    /// # Errors
    ///
    /// As [`Client::command_node`].
    pub async fn get_node(&self, noun: &str) -> Result<Payload, Error> {
        let node = self.node().await?;
        let key = keys::node_get(&self.0.prefix, &node, noun);
        self.query(Target::Node(&node), &key, None).await
    }

    /// The swarms of a daemon, ordered by name.
    ///
    /// Cancel safety: a dropped query changes nothing.
    ///
    /// # Errors
    ///
    /// As [`Client::command`], and [`Error::Decode`].
    pub async fn swarms_of(&self, node: &str) -> Result<Vec<SwarmSummary>, Error> {
        let key = keys::node_get(&self.0.prefix, node, "swarms");
        let payload = self.query(Target::Node(node), &key, None).await?;
        let reply: NodeReply<Swarms> = payload.read()?;
        Ok(reply.result.swarms)
    }

    /// The key of an experiment's `progress` and other nouns.
    ///
    /// Cancel safety: a dropped query changes nothing.
    ///
    /// # Errors
    ///
    /// As [`Client::node`].
    pub async fn experiment_key(&self, experiment: &str, noun: &str) -> Result<String, Error> {
        let node = self.node().await?;
        Ok(keys::experiment(&self.0.prefix, &node, experiment, noun))
    }

    /// Queries an experiment, such as `progress` or `results?after=7`.
    ///
    /// Cancel safety: a dropped query changes nothing.
    ///
    /// # Errors
    ///
    /// As [`Client::command_node`].
    pub async fn get_experiment(&self, experiment: &str, noun: &str) -> Result<Payload, Error> {
        let node = self.node().await?;
        let key = keys::experiment(&self.0.prefix, &node, experiment, noun);
        self.query(Target::Node(&node), &key, None).await
    }

    /// The names of the daemon's experiments.
    ///
    /// Cancel safety: a dropped query changes nothing.
    ///
    /// # Errors
    ///
    /// As [`Client::command_node`], and [`Error::Decode`].
    pub async fn experiments(&self) -> Result<Vec<String>, Error> {
        let reply: NodeReply<Experiments> = self.get_node("experiments").await?.read()?;
        let experiments = reply.result.experiments.into_iter();
        Ok(experiments.map(|it| it.name).collect())
    }

    /// The names of the daemon's recordings.
    ///
    /// Cancel safety: a dropped query changes nothing.
    ///
    /// # Errors
    ///
    /// As [`Client::command_node`], and [`Error::Decode`].
    pub async fn recordings(&self) -> Result<Vec<String>, Error> {
        let reply: NodeReply<Recordings> = self.get_node("recordings").await?.read()?;
        let recordings = reply.result.recordings.into_iter();
        Ok(recordings.map(|it| it.recording).collect())
    }

    /// Rejects a request that the daemon does not accept: zenoh would drop it without an error.
    async fn check_length(&self, node: &str, bytes: usize) -> Result<(), Error> {
        if bytes <= ALWAYS_ACCEPTED {
            return Ok(());
        }
        let key = keys::node_get(&self.0.prefix, node, "hello");
        let timeout = hold_time(self.0.timeout) + TIMEOUT_MARGIN;
        let hello = self.query_once(Target::Node(node), &key, None, timeout);
        let hello: NodeReply<Hello> = hello.await?.read()?;
        let (bytes, limit) = (bytes as u64, hello.result.limits.max_message_bytes);
        if bytes > limit {
            return Err(Error::TooLarge { bytes, limit });
        }
        Ok(())
    }

    /// An id that no other client has used.
    #[must_use]
    pub fn new_id(&self) -> String {
        let number = self.0.next_request.fetch_add(1, Ordering::Relaxed);
        format!("{}-{number}", self.0.session.zid())
    }

    /// The envelope of a command.
    fn request<A: Serialize>(&self, args: &A, options: CommandOptions) -> Result<Request, Error> {
        let timeout = options.timeout.unwrap_or(self.0.timeout);
        Ok(Request {
            request_id: Some(options.request_id.unwrap_or_else(|| self.new_id())),
            client: Some(options.client.unwrap_or_else(|| self.0.name.clone())),
            at_step: options.at_step,
            expect_epoch: options.expect_epoch,
            expect_step: options.expect_step,
            timeout_secs: Some(hold_time(timeout).as_secs_f64()),
            args: Some(serde_json::value::to_raw_value(args).map_err(Error::internal)?),
        })
    }
}

/// The length of a request as JSON.
fn length(request: &Request) -> Result<usize, Error> {
    Ok(serde_json::to_vec(request).map_err(Error::internal)?.len())
}

/// Adds to the error of a command that it may be executed.
fn may_execute(error: Error) -> Error {
    match error {
        Error::NoDaemon { endpoint, cause } => Error::NoDaemon {
            endpoint,
            cause: format!("{cause}; {MAY_EXECUTE}"),
        },
        error => error,
    }
}
