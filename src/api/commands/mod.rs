//! Commands: those that a swarm executes, and one file for each other verb.

mod create;
mod discard;
mod experiment;
mod fork;
mod join;
mod record;
mod replay;
mod restore;
mod seek;

use std::sync::Arc;
use std::time::Duration;

use jostle_physics::simulation::Spec;
use jostle_proto::verbs::{NodeVerb, SwarmVerb};
use jostle_proto::{Arguments, keys};

pub use record::count;

use crate::api::context::{Context, Parsed};
use crate::api::incoming::Incoming;
use crate::api::responder::Responder;
use crate::convert::commands::{self, CommandError, DEFAULT_TIMEOUT, truncate};
use crate::convert::digest::RequestIdentity;
use crate::convert::{self, Payload};
use crate::swarm::command::Command;
use crate::swarm::frame::Stamp;
use crate::swarm::handle::{CommandMessage, Handle, Message, Outcome};
use crate::swarm::watch::Action;

impl Context {
    /// Executes a command to a swarm.
    pub(crate) fn command(&self, swarm: &Arc<str>, incoming: &Incoming) {
        let responder = self.responder(incoming);
        let prefix = keys::cmd(&self.prefix, swarm, "");
        let verb = incoming.key.strip_prefix(&prefix).unwrap_or_default();
        let done = match SwarmVerb::of(verb) {
            _ if incoming.is_wild => Err(CommandError::Wildcard),
            Some(SwarmVerb::Fork) => self.fork(swarm, incoming, &responder),
            Some(SwarmVerb::Seek) => self.seek(swarm, incoming, &responder),
            Some(
                SwarmVerb::Delete
                | SwarmVerb::Run
                | SwarmVerb::Pause
                | SwarmVerb::Step
                | SwarmVerb::Reset
                | SwarmVerb::Set
                | SwarmVerb::Inform
                | SwarmVerb::Uninform
                | SwarmVerb::Inject
                | SwarmVerb::Remove
                | SwarmVerb::Batch
                | SwarmVerb::Join
                | SwarmVerb::Advance
                | SwarmVerb::Leave
                | SwarmVerb::Annotate
                | SwarmVerb::When
                | SwarmVerb::Protect,
            )
            // It has a better error after the payload's.
            | None => self.swarm_command(swarm, verb, incoming, &responder),
        };
        if let Err(error) = done {
            let step = self.registry.find(swarm).and_then(|handle| handle.step());
            responder.reject(&error, step);
        }
    }

    /// Executes a command of the swarm itself.
    fn swarm_command(
        &self,
        swarm: &Arc<str>,
        verb: &str,
        incoming: &Incoming,
        responder: &Responder,
    ) -> Result<(), CommandError> {
        let request = self.request(incoming)?;
        let (mut message, returns_state) = commands::read(verb, &request)?;
        // The journal may have such conditions, of an earlier version.
        if let Command::Watch(watch) = &message.command {
            if let Some(reason) = watch.condition.never_holds() {
                return Err(CommandError::NeverHolds(reason));
            }
            if let Action::Event(event) = &watch.action {
                commands::check_name("event", event)?;
            }
        }
        commands::check_new(&message.command)?;
        message.user = self.rights.current().owner(&incoming.token).cloned();
        let timeout = commands::timeout(&request)?;
        if let Some(controller) = message.command.controller()
            && let rights = self.rights.current()
            && let Some(person) = rights.sender(&incoming.token, verb)?
            && let Err(error) = person.permit_controller(controller)
        {
            self.audit_denied(incoming);
            return Err(error.into());
        }
        let identity = RequestIdentity::of(&incoming.key, &request);
        if let Some(sender) = Arc::get_mut(&mut message.sender) {
            sender.digest = identity.as_ref().map(|it| it.digest);
        }
        if !self.is_new(identity, responder)? {
            let step = self.registry.find(swarm).map(|handle| handle.last_step());
            responder.set_deadline(timeout, CommandError::deadline, step);
            return Ok(());
        }
        self.audit(&incoming.key, &request, responder);
        let handle = self.find(swarm)?;
        self.admit(swarm, &message)?;
        match &message.command {
            Command::Join(options) => {
                let controller = options.controller.clone();
                self.join(incoming, responder, (handle, &controller), timeout, message)
            }
            _ => {
                send(responder, &handle, timeout, message, returns_state);
                Ok(())
            }
        }
    }

    /// Counts a note, and a `join` or `leave` of a user who is no operator, unless it exceeds a limit.
    fn admit(&self, swarm: &str, message: &CommandMessage) -> Result<(), CommandError> {
        let user = message.user.as_ref();
        let is_limited = match message.command {
            Command::Annotate => true,
            Command::Join(_) | Command::Leave(_) => user.is_some_and(|user| !user.is_operator()),
            _ => false,
        };
        if !is_limited {
            return Ok(());
        }
        let user = user.map_or("", |user| &user.name);
        let exists = |name: &str| self.registry.find(name).is_some();
        Ok(self.limits.admit(swarm, user, message, exists)??)
    }

    /// Replies to a retry of `delete` after its swarm is gone. Other daemons reply for their own
    /// swarms, so a first `delete` of an unknown swarm gets no reply.
    pub(crate) fn replay_deletion(&self, incoming: &Incoming) {
        if self.permit(incoming).is_ok()
            && let Ok(request) = self.request(incoming)
            && let Some(identity) = RequestIdentity::of(&incoming.key, &request)
            && let Some(reply) = self.idempotency.find(identity)
        {
            self.responder(incoming).send(move || reply);
        }
    }

    /// Executes a command to the daemon.
    pub(crate) fn node_command(&self, incoming: &Incoming) {
        let responder = self.responder(incoming);
        if let Err(error) = self.execute_node_command(incoming, &responder) {
            responder.reject(&error, None);
        }
    }

    fn execute_node_command(
        &self,
        incoming: &Incoming,
        responder: &Responder,
    ) -> Result<(), CommandError> {
        if incoming.is_wild {
            return Err(CommandError::Wildcard);
        }
        let prefix = keys::node_cmd(&self.prefix, &self.node, "");
        let given = incoming.key.strip_prefix(&prefix).unwrap_or_default();
        let Some(verb) = NodeVerb::of(given) else {
            return Err(CommandError::UnknownVerb {
                verb: truncate(given),
                known: &keys::NODE_VERBS,
            });
        };
        let command = Parsed {
            key: &incoming.key,
            request: &self.request(incoming)?,
            responder,
            turn: self.turn(incoming, ""),
            user: self.user(incoming),
        };
        match verb {
            NodeVerb::Create => self.execute(verb, &command, Self::create),
            NodeVerb::Restore => self.execute(verb, &command, Self::restore),
            NodeVerb::Discard => self.execute(verb, &command, Self::discard),
            NodeVerb::Experiment => self.execute(verb, &command, Self::experiment),
            NodeVerb::Record => self.execute(verb, &command, Self::record),
            NodeVerb::Replay => self.replay(&command),
        }
    }

    /// Begins a command to the daemon, and executes it unless it is a duplicate.
    fn execute<A: Arguments>(
        &self,
        verb: NodeVerb,
        command: &Parsed<'_>,
        execute: fn(&Self, &Parsed<'_>, A) -> Result<(), CommandError>,
    ) -> Result<(), CommandError> {
        match self.begin(verb.name(), command, DEFAULT_TIMEOUT, |_| false)? {
            Some(args) => execute(self, command, args),
            None => Ok(()),
        }
    }
}

/// Sends a command to a swarm, and replies with its outcome.
fn send(
    responder: &Responder,
    swarm: &Handle,
    timeout: Duration,
    message: CommandMessage,
    returns_state: bool,
) {
    let output = swarm.output.clone();
    // Counted before the state is taken: later states have greater numbers.
    let published = returns_state.then(|| output.published());
    responder.send_to_swarm(
        swarm,
        (timeout, CommandError::deadline),
        |reply_to| {
            Message::Command(CommandMessage {
                reply_to,
                ..message
            })
        },
        move |stamp, outcome| convert::outcome(&output.name, &stamp, outcome, published),
    );
}

/// The reply to a command that creates a swarm.
fn created(name: &str, stamp: &Stamp, spec: &Spec, outcome: Outcome, is_new: bool) -> Payload {
    match outcome {
        Outcome::State(frame) => convert::created(name, stamp, spec, &frame, is_new),
        other => convert::outcome(name, stamp, other, None),
    }
}
