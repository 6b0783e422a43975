//! `get/verify`: replays the history of a swarm and compares the hashes.

use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::Duration;

use jostle_proto::Verified;

use crate::api::context::Context;
use crate::api::incoming::Incoming;
use crate::api::responder::Responder;
use crate::api::verifications::{Verification, Work};
use crate::convert::commands::CommandError;
use crate::convert::{self, Payload};
use crate::persistence::replay::{self, Replayed};
use crate::store::Store;
use crate::swarm::error::SwarmError;
use crate::swarm::frame::Stamp;
use crate::swarm::handle::{Handle, Message};
use crate::swarm::outcome::{Outcome, ReplyTo};
use crate::swarm::worker::replay::ReplayTarget;

/// The longest verification that the client waits for.
const TIMEOUT: Duration = Duration::from_secs(3600);

impl Context {
    pub(super) fn verify(
        &self,
        swarm: &Arc<str>,
        incoming: &Incoming,
        responder: &Responder,
    ) -> Result<(), CommandError> {
        incoming.no_parameters()?;
        let handle = self.find(swarm)?;
        if handle.summary().is_some_and(|it| it.is_replay) {
            responder.reject(&SwarmError::Recorded.into(), handle.step());
            return Ok(());
        }
        responder.set_deadline(TIMEOUT, CommandError::deadline, None);
        let step = handle.step();
        let work = Box::new(Replay {
            store: self.store.clone(),
            swarm: swarm.clone(),
            handle,
            responder: responder.clone(),
        });
        if self.verifications.begin(swarm, work).is_err() {
            responder.reject(&CommandError::Busy, step);
        }
        Ok(())
    }
}

/// A replay of the history of a swarm.
struct Replay {
    store: Store,
    swarm: Arc<str>,
    handle: Handle,
    responder: Responder,
}

impl Work for Replay {
    fn run(self: Box<Self>, verification: Arc<Verification>) {
        let Replay {
            store,
            swarm,
            handle,
            responder,
        } = *self;
        // The deadline may have passed while it was queued.
        if responder.is_done() {
            return;
        }
        let seen = present(&handle);
        let to = match &seen {
            Some((stamp, _)) if !stamp.phase.is_moving() => {
                ReplayTarget::At(stamp.epoch, stamp.step)
            }
            _ => ReplayTarget::LastHash,
        };
        let progress = verification.clone();
        let on_progress = move |share| progress.advance(share);
        let replayed = replay::replay_to(&store, &swarm, to, on_progress);
        drop(verification);
        match replayed {
            Ok(replayed) => {
                let verified = verified(&replayed, seen);
                handle.send(Message::Query(ReplyTo::new(move |answered| {
                    responder.respond(answered, move |stamp, _| {
                        Payload::json(&convert::reply(&swarm, &stamp, verified))
                    });
                })));
            }
            Err(error) => responder.reject(&error, handle.step()),
        }
    }
}

/// Where a swarm is now, and its hash.
fn present(handle: &Handle) -> Option<(Stamp, [u8; 32])> {
    let (sender, receiver) = sync_channel(1);
    handle.send(Message::Query(ReplyTo::new(move |answered| {
        // The receiver waits.
        let _ = sender.send(answered);
    })));
    match receiver.recv() {
        Ok(Ok((stamp, Outcome::State(frame)))) => Some((stamp, frame.hash?)),
        _ => None,
    }
}

/// Whether a replayed swarm has the hash of the swarm itself; `None` if that is elsewhere.
fn is_as_now(replayed: &Replayed, stamp: &Stamp, hash: [u8; 32]) -> Option<bool> {
    let simulation = &replayed.checkpoint.simulation;
    let reached = (simulation.epoch, simulation.state.step, simulation.seq);
    let is_there = reached == (stamp.epoch, stamp.step, stamp.seq);
    is_there.then(|| simulation.state.hash() == hash)
}

/// The result of a replay, compared with where the swarm was then and its hash.
fn verified(replayed: &Replayed, seen: Option<(Stamp, [u8; 32])>) -> Verified {
    let now = seen.and_then(|(stamp, hash)| is_as_now(replayed, &stamp, hash));
    let simulation = &replayed.checkpoint.simulation;
    let here = (simulation.epoch, simulation.state.step);
    let differs_at = replayed.differs_at.or((now == Some(false)).then_some(here));
    Verified {
        from_step: replayed.from,
        to_step: here.1,
        hashes: replayed.same + u64::from(replayed.differs_at.is_some()) + u64::from(now.is_some()),
        differs_at: differs_at.map(|(_, step)| step),
        differs_in_epoch: differs_at.map(|(epoch, _)| epoch),
    }
}
