//! Answers queries: an order or a look handed to a swarm, and the promise of its answer.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use fail::fail_point;
use jostle_proto::{Request, Schemas, keys};
use serde_json::Value;
use tracing::error;
use zenoh::Session;
use zenoh::bytes::ZBytes;
use zenoh::query::Query;

use crate::api::commands::{self, CommandError, DEFAULT_TIMEOUT};
use crate::api::experiments::Errands;
use crate::api::idempotency::Ledger;
use crate::api::responder::{Asked, Desk, Excuse, Keeper, Promise};
use crate::api::verifications::Verifications;
use crate::auth::live::LiveRights;
use crate::auth::{NotPermitted, Rights};
use crate::convert::{self, Payload};
use crate::experiments::Lab;
use crate::health::Watch;
use crate::playback::Uploads;
use crate::recording::Recordings;
use crate::store::Store;
use crate::swarm::frame::{Frame, Place};
use crate::swarm::handle::Ticket;
use crate::swarm::outcome::{Answered, OrderError, Outcome, Refusal};
use crate::swarm::registry::Host;
use crate::transport::zenoh::claims::{Claims, Gate, Name};
use crate::transport::zenoh::publisher::Press;
use crate::transport::zenoh::query::{self, Topic};
use crate::transport::zenoh::session_pool::SessionPool;

/// The longest request that is read where it came in, in bytes.
const MOST_BYTES_AT_THE_DOOR: usize = 16 * 1024;

/// What it takes to answer a query. Shared by the thread that dispatches and those that take in.
pub struct Clerk {
    /// The daemon's session.
    pub session: Session,
    /// The sessions that declare what a swarm needs.
    pub pool: SessionPool,
    /// Clients at once.
    pub max_clients: usize,
    /// The first chunk of every key.
    pub prefix: String,
    /// The daemon's name.
    pub node: String,
    /// Where it serves HTTP, if it does.
    pub http: Option<String>,
    /// The swarms.
    pub host: Arc<Host>,
    /// Where answers go.
    pub desk: Desk,
    /// Where states go.
    pub press: Arc<Press>,
    /// Who may do what.
    pub rights: Arc<LiveRights>,
    /// When the daemon started.
    pub started: Instant,
    /// What outlives the daemon.
    pub store: Store,
    /// What the named requests came to.
    pub ledger: Ledger,
    /// The schemas of every message.
    pub schemas: Schemas,
    /// The experiments.
    pub lab: Lab,
    /// Where what is to be done with them is handed in.
    pub errands: Errands<Lab>,
    /// Recordings on their way in.
    pub uploads: Arc<Uploads>,
    /// What it records.
    pub recordings: Recordings,
    /// Where what is to be done with that is handed in.
    pub to_record: Errands<Recordings>,
    /// The daemon in numbers, once it is watched.
    pub watch: Arc<OnceLock<Arc<Watch>>>,
    /// The claims of this daemon and of others, which decide what it may serve.
    pub claims: Arc<Claims>,
    /// Whether the swarms of an earlier run are being brought back.
    pub is_recovering: AtomicBool,
    /// How many queries wait for the dispatching thread, or are at it.
    pub waiting: AtomicUsize,
    /// The histories that are being verified.
    pub verifications: Arc<Verifications>,
}

impl Clerk {
    /// Reads a command where it came in and hands it to its swarm, if that is done in a moment and
    /// nothing came before it: it is worth one thread less to wake. Otherwise false.
    pub fn reads_at_the_door(&self, topic: &Topic, query: &Query, asked: &Asked) -> bool {
        let is_short = query.payload().map_or(0, ZBytes::len) <= MOST_BYTES_AT_THE_DOOR;
        let takes_long = |verb: &str| matches!(verb, "fork" | "seek" | "delete");
        let verb = query.key_expr().as_str().rsplit('/').next();
        let is_first = self.waiting.load(Ordering::Acquire) == 0;
        let Topic::Command(swarm) = topic else {
            return false;
        };
        let is_read = self.claims.gate(&Name::Swarm(swarm.to_string()), true) == Gate::Open
            && is_short
            && is_first
            && !verb.is_none_or(takes_long);
        if is_read {
            let door = Arc::default();
            self.survive(topic, &asked.at(&door));
            door.shut();
        }
        is_read
    }

    /// Dispatches a query.
    pub fn survive(&self, topic: &Topic, asked: &Asked) {
        self.guard(asked, || self.query(topic, asked));
    }

    /// Has a query answered; one that uncovers a defect ends with an error and not with the daemon.
    pub fn guard(&self, asked: &Asked, answer: impl FnOnce()) {
        if catch_unwind(AssertUnwindSafe(answer)).is_err() {
            let key = asked.query.key_expr().as_str().to_owned();
            error!(key, "a defect: the query panicked");
            let promise = self.desk.promise(asked, key);
            promise.refuse(&CommandError::Internal, None);
        }
    }

    fn query(&self, topic: &Topic, asked: &Asked) {
        fail_point!("query");
        let has_payload = asked
            .query
            .payload()
            .is_some_and(|payload| !payload.is_empty());
        if has_payload
            && matches!(
                topic,
                Topic::State(_) | Topic::Get(_) | Topic::NodeGet | Topic::Experiment
            )
        {
            let error = CommandError::Field {
                field: "payload",
                problem: "means nothing to a get: what it takes goes behind the key's `?`",
            };
            let key = asked.query.key_expr().as_str().to_owned();
            return self.desk.promise(asked, key).refuse(&error, None);
        }
        if matches!(topic, Topic::Command(_) | Topic::NodeCommand)
            && let Err(refused) = self.permit(&asked.query)
        {
            let key = asked.query.key_expr().as_str().to_owned();
            return self.desk.promise(asked, key).refuse(&refused.into(), None);
        }
        match topic {
            Topic::State(swarm) => self.state(swarm, asked),
            Topic::Get(swarm) => self.get(swarm, asked),
            Topic::Command(swarm) => self.command(swarm, asked),
            Topic::Deletion => {
                unreachable!("only the dispatching thread knows which swarms are gone")
            }
            Topic::NodeGet => self.node_get(asked),
            Topic::NodeCommand => self.node_command(asked),
            Topic::Experiment => self.experiment_get(asked),
        }
    }

    /// Whether whoever sends a command may; by its verb, which a wildcard is not.
    pub(crate) fn permit(&self, query: &Query) -> Result<(), NotPermitted> {
        match &*self.rights.current() {
            Rights::Everybody => Ok(()),
            rights => rights.permit(&query::token(query), &verb(query)).map(drop),
        }
    }

    /// Reads the request in a query, signed by whoever sends it if people are known.
    pub(crate) fn request(&self, query: &Query) -> Result<Request, CommandError> {
        let mut request = query::request(query, self.most_bytes())?;
        let rights = self.rights.current();
        if let Rights::People { .. } = &*rights {
            // A person may have been removed since the query was permitted: the request must not
            // execute unsigned then.
            let sender = rights.sender(&query::token(query), &verb(query))?;
            request.client = sender.map(|person| person.signed(request.client.as_deref()));
        }
        Ok(request)
    }

    /// The name of the swarm that a query creates; `None` if no other daemon can be reached.
    pub(crate) fn creates(&self, topic: &Topic, asked: &Asked) -> Option<String> {
        if !self.claims.is_connected() {
            return None;
        }
        let verb = asked.query.key_expr().as_str().rsplit('/').next()?;
        let is_of_node = matches!(topic, Topic::NodeCommand);
        let args: Value = self.request(&asked.query).ok()?.args().ok()?;
        let name = match (is_of_node, verb) {
            (true, "create" | "restore") | (false, "fork") => &args["name"],
            (true, "replay") => &args["open"]["name"],
            _ => return None,
        };
        let name = name.as_str().filter(|it| keys::is_name(it))?;
        Some(name.to_owned())
    }

    /// Looks at a swarm and answers with what `payload` makes of it.
    pub(crate) fn look(
        &self,
        swarm: &str,
        promise: &Promise,
        payload: impl FnOnce(Place, Arc<Frame>) -> Payload + Send + 'static,
    ) {
        let name = swarm.to_owned();
        self.send(
            swarm,
            promise,
            (DEFAULT_TIMEOUT, CommandError::deadline),
            |answer| {
                Ticket::Look(Box::new(move |answered| {
                    answer(answered, move |place, outcome| match outcome {
                        Outcome::Seen(seen) => payload(place, seen),
                        other => convert::outcome(&name, &place, other, None),
                    });
                }))
            },
        );
    }

    /// Hands a ticket to a swarm. The promise is kept by its answer, in time or with an excuse.
    pub(crate) fn send<A>(
        &self,
        swarm: &str,
        promise: &Promise,
        (patience, excuse): (Duration, Excuse),
        ticket: impl FnOnce(AnswerTo<A>) -> Ticket,
    ) where
        A: FnOnce(Place, Outcome) -> Payload + Send + 'static,
    {
        let Some(handle) = self.host.find(swarm) else {
            let error = CommandError::UnknownSwarm(swarm.to_owned());
            return promise.refuse(&error, None);
        };
        let late = handle.step_later();
        promise.keep_within(patience, excuse, late);
        match ticket(answer_to(promise)) {
            Ticket::Command(command) if promise.is_at_the_door() => handle.send_here(command),
            ticket => handle.send(ticket),
        }
    }
}

/// The verb of a command; its whole key if there is none.
pub(crate) fn verb(query: &Query) -> String {
    let key = query.key_expr().as_str();
    commands::shortened(key.split_once("/cmd/").map_or(key, |(_, verb)| verb))
}

/// Takes what a swarm answers and how to word it.
pub(crate) type AnswerTo<A> = Box<dyn FnOnce(Answered, A) + Send>;

/// Keeps `promise` with whatever is answered; if it is dropped unanswered, with a refusal.
fn answer_to<A>(promise: &Promise) -> AnswerTo<A>
where
    A: FnOnce(Place, Outcome) -> Payload + Send + 'static,
{
    let keeper = Keeper::new(promise.clone());
    Box::new(move |answered, payload| match answered {
        Ok((place, outcome)) => keeper.0.fulfil(move || Ok(payload(place, outcome))),
        // It was carried out, though not to its end.
        Err(Refusal {
            step,
            error: error @ OrderError::Faulted(_),
        }) => keeper
            .0
            .fulfil(move || Err(Payload::json(&CommandError::from(error).to_wire(step)))),
        Err(Refusal { step, error }) => keeper.0.refuse(&error.into(), step),
    })
}
