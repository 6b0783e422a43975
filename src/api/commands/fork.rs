//! `fork`: a new swarm with the state of another one, now or on arrival at an earlier step.

use std::sync::Arc;

use jostle_proto::verbs::ForkArgs;

use super::created;
use crate::api::context::{Context, Parsed};
use crate::api::incoming::Incoming;
use crate::api::responder::Responder;
use crate::convert::commands::{CommandError, DEFAULT_TIMEOUT, check_name};
use crate::convert::digest::RequestIdentity;
use crate::lanes::{Lane, Rank};
use crate::persistence::replay;
use crate::persistence::writer::NewSwarm;
use crate::store::Store;
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::frame;
use crate::swarm::handle::{Message, Outcome, Rejection, ReplyTo};
use crate::swarm::phase::{PauseReason, Phase};
use crate::swarm::registry::SwarmRegistry;
use crate::swarm::sender::{Creation, Origin, OriginKind};

impl Context {
    pub(super) fn fork(
        &self,
        swarm: &Arc<str>,
        incoming: &Incoming,
        responder: &Responder,
    ) -> Result<(), CommandError> {
        let command = Parsed {
            key: &incoming.key,
            request: &self.request(incoming)?,
            responder,
            turn: self.turn(incoming, swarm),
            user: self.user(incoming),
        };
        let at_step = |args: &ForkArgs| args.step.is_some();
        let begun = self.begin("fork", &command, DEFAULT_TIMEOUT, at_step)?;
        let Some(ForkArgs { name, step }) = begun else {
            return Ok(());
        };
        check_name("name", &name)?;
        let handle = self.find(swarm)?;
        let now = handle.step().unwrap_or_default();
        if let Some(step) = step
            && jostle_convert::value::whole("step", step)? > now
        {
            return Err(CommandError::NotReached { step, now });
        }
        let from = (
            Some(swarm.to_string()),
            handle.record.swarm_id.get().copied(),
        );
        let fork = self.swarm_from_checkpoint(name, (OriginKind::Fork, from), &command);
        match step {
            Some(step) => {
                let (store, of) = (self.store.clone(), swarm.clone());
                let identity = command.identity();
                let task =
                    Self::creation(&command.turn, identity.as_ref(), responder, move |ticket| {
                        let goes_on = Box::new(move || ticket.goes_on());
                        match replay::replay_to(&store, &of, step, goes_on) {
                            Ok(Some(checkpoint)) if fork.is_to_be_created() => {
                                fork.create(checkpoint);
                            }
                            Ok(_) => {}
                            Err(error) => fork.responder.reject(&error, None),
                        }
                    });
                let task = task.alone_on(swarm, Rank::First);
                self.lanes.submit(Lane::Replays, task)?;
            }
            None => handle.send(Message::TakeCheckpoint(ReplyTo::new(
                move |answered| match answered {
                    Ok((_, Outcome::Checkpoint(checkpoint))) => fork.create(*checkpoint),
                    Ok(_) => fork.responder.reject(&CommandError::Internal, None),
                    Err(Rejection { step, error }) => fork.responder.reject(&error.into(), step),
                },
            ))),
        }
        Ok(())
    }

    /// The swarm that `command` creates from a checkpoint of another one: its name, and its number in the
    /// store if it is there.
    pub(super) fn swarm_from_checkpoint(
        &self,
        name: String,
        (kind, from): (OriginKind, (Option<String>, Option<u64>)),
        command: &Parsed<'_>,
    ) -> SwarmFromCheckpoint {
        let (verb, reason) = match kind {
            OriginKind::Restore => ("restore", PauseReason::Restored),
            OriginKind::Fork | OriginKind::Play => ("fork", PauseReason::Forked),
        };
        SwarmFromCheckpoint {
            registry: self.registry.clone(),
            store: self.store.clone(),
            identity: command.identity(),
            responder: command.responder.clone(),
            name,
            reason,
            kind,
            from,
            creation: command.creation(verb),
        }
    }
}

/// A swarm to create from a checkpoint.
pub(super) struct SwarmFromCheckpoint {
    registry: Arc<SwarmRegistry>,
    store: Store,
    identity: Option<RequestIdentity>,
    responder: Responder,
    name: String,
    reason: PauseReason,
    kind: OriginKind,
    from: (Option<String>, Option<u64>),
    creation: Creation,
}

impl SwarmFromCheckpoint {
    /// Whether the client learns of it: in the reply, or by sending the request again under its id.
    fn is_to_be_created(&self) -> bool {
        self.responder.commits() || self.identity.is_some()
    }

    /// Creates it, and replies.
    pub(super) fn create(self, checkpoint: Checkpoint) {
        let (name, responder) = (self.name, self.responder);
        let (swarm, swarm_id) = self.from;
        let origin = Origin {
            kind: self.kind,
            swarm,
            swarm_id,
            step: checkpoint.simulation.state.step,
            seq: Some(checkpoint.seq()),
            state_hash: Some(checkpoint.simulation.state.hash()),
        };
        let checkpoint = checkpoint.for_another(Phase::Paused(self.reason));
        let spec = checkpoint.simulation.spec.clone();
        let persist = Box::new(NewSwarm {
            store: self.store,
            name: name.clone(),
            spec: spec.clone(),
            identity: self.identity,
        });
        let reply_to = || {
            let (responder, name) = (responder.clone(), name.clone());
            ReplyTo::new(move |answered| {
                responder.respond(answered, move |stamp, outcome| {
                    created(&name, &stamp, &spec, outcome, true)
                });
            })
        };
        let creation = Creation {
            unix_secs: frame::unix_secs(),
            origin: Some(origin),
            ..self.creation
        };
        if let Err(error) = self
            .registry
            .create_from_checkpoint(&name, checkpoint, creation, persist, reply_to)
        {
            responder.reject(&error.into(), None);
        }
    }
}
