//! The state that all request handlers share, and the entry point of requests.

use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use fail::fail_point;
use jostle_proto::verbs::{NodeVerb, SwarmVerb};
use jostle_proto::{Arguments, Claimant, Request, Role, Schemas, keys};
use serde_json::Value;

use crate::api::admission::{Admission, CountedAs, Unanswered};
use crate::api::idempotency::IdempotencyCache;
use crate::api::incoming::{Incoming, Target};
use crate::api::responder::{Replies, Responder};
use crate::api::verifications::Verifications;
use crate::audit::AuditLog;
use crate::auth::live::LiveRights;
use crate::auth::{NotPermitted, Rights};
use crate::convert::commands::{self, CommandError};
use crate::convert::digest::RequestIdentity;
use crate::experiments::ExperimentManager;
use crate::health::HealthMonitor;
use crate::lanes::{Full, Lane, Lanes, Task, Ticket};
use crate::persistence::limits::UserLimits;
use crate::playback::Uploads;
use crate::recording::Recordings;
use crate::store::Store;
use crate::swarm::awaited::Holder;
use crate::swarm::frame;
use crate::swarm::handle::Handle;
use crate::swarm::recovery_progress::RecoveryProgress;
use crate::swarm::registry::SwarmRegistry;
use crate::swarm::sender::Creation;

/// The longest request without values of individuals, in bytes.
const REQUEST_BYTES: usize = 64 * 1024;

/// The most bytes of a request for each individual: its position, or its part of a snapshot.
const BYTES_PER_INDIVIDUAL: usize = 256;

/// What handlers need to know of the connections to clients and to other daemons.
pub trait Peers: Send + Sync {
    /// The number of clients that are connected.
    fn clients(&self) -> usize;

    /// The swarms whose names another daemon holds, too: the name, this daemon and the other one.
    /// `None` is the name of the daemon itself.
    fn contests(&self) -> Vec<(Option<String>, [Claimant; 2])>;

    /// The liveliness token of a wait with this id in a swarm.
    fn holder_of_wait(&self, swarm: &str, id: &str) -> Arc<Holder>;
}

/// A callback: whether a controller holds its liveliness token.
pub type OnToken = Box<dyn FnOnce(bool) + Send>;

/// The liveliness tokens of controllers.
pub trait Tokens: Send + Sync {
    /// Whether a controller of a swarm holds its token.
    fn is_held(&self, swarm: &str, controller: &str) -> bool;

    /// Calls `then` once the token is held, or after [`MAX_TOKEN_WAIT`] without it. If the token is lost
    /// afterwards, the swarm receives that after all that `then` sends it.
    fn await_token(&self, swarm: &str, controller: &str, then: OnToken);
}

/// How long a `join` waits for the token of its controller: routers may forward a token later than a command.
pub const MAX_TOKEN_WAIT: Duration = Duration::from_secs(2);

/// A parsed command.
pub(super) struct Parsed<'a> {
    /// The key that it was sent to.
    pub(super) key: &'a str,
    pub(super) request: &'a Request,
    pub(super) responder: &'a Responder,
    /// Whose turn it takes in a lane.
    pub(super) turn: Arc<str>,
    /// The user who sent it, of a daemon with users.
    pub(super) user: Option<String>,
}

impl Parsed<'_> {
    /// The identity of the request, if it has an id.
    pub(super) fn identity(&self) -> Option<RequestIdentity> {
        RequestIdentity::of(self.key, self.request)
    }

    /// The creation of a swarm by this command.
    pub(super) fn creation(&self, verb: &str) -> Creation {
        Creation {
            verb: verb.to_owned(),
            client: self.request.client.clone(),
            request_id: self.request.request_id.clone(),
            owner: self.user.clone(),
            unix_secs: frame::unix_secs(),
            step: 0,
            origin: None,
        }
    }
}

/// The state that all request handlers share.
pub struct Context {
    /// The first chunk of every key.
    pub prefix: String,
    /// The name of the daemon.
    pub node: String,
    /// The URL of its HTTP server, if it has one.
    pub http: Option<String>,
    /// The id of its data.
    pub data_id: Option<String>,
    /// The limit for connected clients.
    pub max_clients: usize,
    /// The longest message of the transport, in bytes.
    pub max_message_bytes: usize,
    /// The connections.
    pub peers: Arc<dyn Peers>,
    /// The liveliness tokens of controllers.
    pub tokens: Arc<dyn Tokens>,
    /// Limits the requests that wait for a token.
    pub token_waits: (Admission, Unanswered),
    /// The swarms.
    pub registry: Arc<SwarmRegistry>,
    /// Sends replies.
    pub replies: Replies,
    /// The users and their roles.
    pub rights: Arc<LiveRights>,
    /// When the daemon started.
    pub started: Instant,
    /// The journals and checkpoints.
    pub store: Store,
    /// The requests that have an id.
    pub idempotency: IdempotencyCache,
    /// The schemas of all messages.
    pub schemas: Schemas,
    /// The experiments.
    pub experiments: ExperimentManager,
    /// Recordings that clients upload.
    pub uploads: Arc<Uploads>,
    /// Recordings that the daemon writes.
    pub recordings: Recordings,
    /// The checks and metrics; set once they run.
    pub watch: Arc<OnceLock<Arc<HealthMonitor>>>,
    /// The swarms of the previous run that are being recovered.
    pub recovery: Arc<RecoveryProgress>,
    /// Execute work that may take long.
    pub lanes: Lanes,
    /// The verifications that run or are queued.
    pub verifications: Arc<Verifications>,
    /// The limits of users.
    pub limits: UserLimits,
    /// Who sent which commands.
    pub audit: AuditLog,
}

impl Context {
    /// Handles a request. A panic ends the request with `internal` and not the daemon.
    pub fn handle(&self, incoming: &Incoming) {
        self.replies.catch_panic(incoming, || {
            fail_point!("query");
            self.dispatch(incoming);
        });
    }

    /// Replies to a request with an error.
    pub fn reject(&self, incoming: &Incoming, error: &CommandError) {
        self.responder(incoming).reject(error, None);
    }

    fn dispatch(&self, incoming: &Incoming) {
        let target = &incoming.target;
        let is_command = matches!(target, Target::Command(_) | Target::NodeCommand);
        if is_command && let Err(error) = self.permit(incoming) {
            self.audit_denied(incoming);
            return self.reject(incoming, &error.into());
        }
        if !is_command && !matches!(target, Target::Deletion) && !incoming.payload.is_empty() {
            let error = CommandError::Field {
                field: "payload",
                problem: "is not accepted by a get: send parameters after the key's `?`",
            };
            return self.reject(incoming, &error);
        }
        if let Some(error) = self.awaits_recovery(incoming) {
            return self.reject(incoming, &error);
        }
        match target {
            Target::State(swarm) => self.state(swarm, incoming),
            Target::Get(swarm) => self.get(swarm, incoming),
            Target::Command(swarm) => self.command(swarm, incoming),
            Target::Deletion => self.replay_deletion(incoming),
            Target::NodeGet => self.node_get(incoming),
            Target::NodeCommand => self.node_command(incoming),
            Target::Experiment => self.experiment_get(incoming),
        }
    }

    /// The error of a request that concerns a swarm which is not recovered yet, or swarms in general: its
    /// reply could be wrong. Queries of the daemon are judged by their nouns.
    pub fn awaits_recovery(&self, incoming: &Incoming) -> Option<CommandError> {
        let swarms_left = self.recovery.swarms_left()?;
        let awaits = match &incoming.target {
            Target::State(swarm) | Target::Get(swarm) => self.recovery.is_pending(swarm),
            // The new name may be one that is to be recovered.
            Target::Command(swarm) => {
                self.recovery.is_pending(swarm) || incoming.key.ends_with("/fork")
            }
            Target::NodeCommand | Target::Experiment => true,
            Target::NodeGet | Target::Deletion => false,
        };
        awaits.then_some(CommandError::Recovering { swarms_left })
    }

    /// A responder that replies under the key of the request.
    pub(crate) fn responder(&self, incoming: &Incoming) -> Responder {
        self.replies.responder(incoming, incoming.key.clone())
    }

    /// Checks whether the client may send the verb of a command; a wildcard is no verb.
    pub(crate) fn permit(&self, incoming: &Incoming) -> Result<(), NotPermitted> {
        match &*self.rights.current() {
            Rights::Open => Ok(()),
            rights => rights.permit(&incoming.token, &incoming.verb()).map(drop),
        }
    }

    /// Parses a command, and adds the name of the user to its client.
    pub(crate) fn request(&self, incoming: &Incoming) -> Result<Request, CommandError> {
        let mut request = incoming.request(self.max_request_bytes())?;
        let rights = self.rights.current();
        if let Rights::Users { .. } = &*rights {
            // A user may have been removed since the request was permitted: it must not be executed
            // without a name then.
            let sender = rights.sender(&incoming.token, &incoming.verb())?;
            request.client = sender.map(|person| person.signed(request.client.as_deref()));
        }
        Ok(request)
    }

    /// The name of the swarm that a request creates.
    pub fn creates(&self, incoming: &Incoming) -> Option<String> {
        let verb = incoming.key.rsplit('/').next()?;
        let definition = match incoming.target {
            Target::NodeCommand => NodeVerb::of(verb)?.definition(),
            _ => SwarmVerb::of(verb)?.definition(),
        };
        let place = definition.creates?;
        let args: Value = self.request(incoming).ok()?.args().ok()?;
        let name = args.pointer(place)?.as_str();
        name.filter(|it| keys::is_name(it)).map(str::to_owned)
    }

    /// The first steps of a command of the daemon: parses its arguments, looks up its id and sets
    /// its deadline, at which it ends without an id if `ends` of its arguments. `None` if it is a
    /// duplicate, which gets the first reply.
    pub(super) fn begin<A: Arguments>(
        &self,
        verb: &'static str,
        command: &Parsed<'_>,
        default_timeout: Duration,
        ends: fn(&A) -> bool,
    ) -> Result<Option<A>, CommandError> {
        let Parsed {
            request, responder, ..
        } = *command;
        reject_preconditions(request)?;
        commands::sender(verb, request)?;
        let args: A = request.args()?;
        let timeout = match request.timeout_secs {
            Some(_) => commands::timeout(request)?,
            None => default_timeout,
        };
        let identity = command.identity();
        let late = match identity.is_none() && ends(&args) {
            true => CommandError::ended,
            false => CommandError::node_deadline,
        };
        let is_new = self.is_new(identity, responder)?;
        if is_new {
            self.audit(command.key, request, responder);
        }
        responder.set_deadline(timeout, late, None);
        Ok(is_new.then_some(args))
    }

    /// Whether a request is new; a duplicate gets the first reply.
    pub(crate) fn is_new(
        &self,
        identity: Option<RequestIdentity>,
        responder: &Responder,
    ) -> Result<bool, CommandError> {
        identity.map_or(Ok(true), |it| self.idempotency.begin(it, responder))
    }

    /// The client whose turn a request takes in a lane: a user, or without users the swarm or
    /// experiment that it is about.
    pub(crate) fn turn(&self, incoming: &Incoming, about: &str) -> Arc<str> {
        match (&*self.rights.current(), about) {
            (Rights::Open, about) => about.into(),
            (rights, _) => {
                let user = rights.owner(&incoming.token);
                user.map_or("", |user| user.name.as_str()).into()
            }
        }
    }

    /// The user as whose a request with this token is counted.
    pub(crate) fn counted_as(&self, token: &[u8]) -> CountedAs {
        match &*self.rights.current() {
            Rights::Open => None,
            rights => {
                let user = rights.owner(token);
                Some(user.map_or("", |user| user.name.as_str()).into())
            }
        }
    }

    /// The user who sent a request, of a daemon with users.
    pub(crate) fn user(&self, incoming: &Incoming) -> Option<String> {
        let rights = self.rights.current();
        let user = rights.owner(&incoming.token);
        user.map(|user| user.name.clone())
    }

    /// Whether a request is of an operator; without users everyone is one.
    pub(crate) fn is_operator(&self, incoming: &Incoming) -> bool {
        match &*self.rights.current() {
            Rights::Open => true,
            rights => {
                let user = rights.owner(&incoming.token);
                user.is_some_and(|user| user.role == Role::Operator)
            }
        }
    }

    /// Queues a read, which is dropped once it has a reply or its client is gone.
    pub(crate) fn queue_read(
        &self,
        lane: Lane,
        turn: &Arc<str>,
        responder: &Responder,
        work: impl FnOnce() + Send + 'static,
    ) -> Result<(), CommandError> {
        let task = Task::new(turn, |_| work()).while_wanted(responder.is_wanted());
        Ok(self.lanes.submit(lane, task)?)
    }

    /// Queues a command that was accepted: it is executed even if its client is gone.
    pub(crate) fn queue_command(
        &self,
        lane: Lane,
        turn: &Arc<str>,
        work: impl FnOnce() + Send + 'static,
    ) -> Result<(), CommandError> {
        Ok(self.lanes.submit(lane, Task::new(turn, |_| work()))?)
    }

    /// A task that creates a swarm, for which `work` prepares the state and then calls
    /// [`Responder::commits`]. Without an id of its request it is dropped like a read; with one, the reply
    /// is stored, and it goes on.
    pub(crate) fn creation(
        turn: &Arc<str>,
        identity: Option<&RequestIdentity>,
        responder: &Responder,
        work: impl FnOnce(Ticket) + Send + 'static,
    ) -> Task {
        let task = Task::new(turn, work);
        match identity {
            Some(_) => task,
            None => task.while_wanted(responder.is_wanted()),
        }
    }

    /// The swarm of this name.
    pub(crate) fn find(&self, swarm: &str) -> Result<Handle, CommandError> {
        let handle = self.registry.find(swarm);
        handle.ok_or_else(|| CommandError::UnknownSwarm(swarm.to_owned()))
    }

    /// The longest request that is read. A longer one gets an error, unless it is longer than what
    /// the transport passes on.
    pub(crate) fn max_request_bytes(&self) -> usize {
        let all = BYTES_PER_INDIVIDUAL.saturating_mul(self.registry.limits().max_individuals);
        all.saturating_add(REQUEST_BYTES)
            .min(self.max_message_bytes)
    }
}

impl From<Full> for CommandError {
    fn from(_: Full) -> Self {
        CommandError::Busy
    }
}

/// Rejects the preconditions of a request that concerns no existing swarm.
pub(crate) fn reject_preconditions(request: &Request) -> Result<(), CommandError> {
    for (field, given) in [
        ("at_step", request.at_step),
        ("expect_step", request.expect_step),
        ("expect_epoch", request.expect_epoch),
    ] {
        if given.is_some() {
            let problem = "applies only to an existing swarm: leave it out";
            return Err(CommandError::Field { field, problem });
        }
    }
    Ok(())
}
