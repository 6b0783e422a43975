//! `get/verify`: replays the history of a swarm and compares the hashes.

use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::Duration;

use jostle_proto::Verified;

use crate::api::responder::Responder;
use crate::api::verifications::{Verification, Verifications, Work};
use crate::convert::commands::CommandError;
use crate::convert::{self, Payload};
use crate::persistence::replay;
use crate::store::Store;
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::error::SwarmError;
use crate::swarm::handle::{Handle, Message, Outcome, Rejection, ReplyTo};
use crate::swarm::journal::Replayed;

/// The longest verification that the client waits for.
const TIMEOUT: Duration = Duration::from_secs(3600);

/// A verification of a swarm.
pub struct Verify {
    store: Store,
    swarm: Arc<str>,
    handle: Handle,
    responder: Responder,
}

/// Begins the verification of a swarm, or queues it.
pub(super) fn begin(
    verifications: &Arc<Verifications<Verify>>,
    store: &Store,
    swarm: &Arc<str>,
    handle: Handle,
    responder: &Responder,
) {
    if handle.summary().is_some_and(|it| it.is_replay) {
        return responder.reject(&SwarmError::Recorded.into(), handle.step());
    }
    responder.set_deadline(TIMEOUT, CommandError::deadline, None);
    let step = handle.step();
    let verify = Verify {
        store: store.clone(),
        swarm: swarm.clone(),
        handle,
        responder: responder.clone(),
    };
    if let Err(error) = verifications.begin(swarm, verify) {
        responder.reject(&error, step);
    }
}

impl Work for Verify {
    const THREAD: &'static str = "verify";

    fn run(self, own: Verification<Self>) {
        // The deadline may have passed while it was queued.
        if !self.responder.is_done()
            && let Err(error) = self.reply(own)
        {
            self.responder.reject(&error, self.handle.step());
        }
    }
}

impl Verify {
    /// Replays the history, and replies unless that fails.
    fn reply(&self, own: Verification<Self>) -> Result<(), CommandError> {
        let present = present(&self.handle)?;
        let on_progress = move |share| own.advance(share);
        let (from, end, replayed) =
            replay::replay_all(&self.store, &self.swarm, &present, on_progress)?;
        let verified = verified(from, &end, &replayed, &present);
        let (swarm, responder) = (self.swarm.clone(), self.responder.clone());
        self.handle
            .send(Message::Query(ReplyTo::new(move |answered| {
                responder.respond(answered, move |stamp, _| {
                    Payload::json(&convert::reply(&swarm, &stamp, verified))
                });
            })));
        Ok(())
    }
}

/// The present state of a swarm.
pub(super) fn present(handle: &Handle) -> Result<Checkpoint, CommandError> {
    let (sender, receiver) = sync_channel(1);
    handle.send(Message::TakeCheckpoint(ReplyTo::new(move |answered| {
        // The receiver waits.
        let _ = sender.send(answered);
    })));
    match receiver.recv() {
        Ok(Ok((_, Outcome::Checkpoint(checkpoint)))) => Ok(*checkpoint),
        Ok(Err(Rejection { error, .. })) => Err(error.into()),
        _ => Err(CommandError::Internal),
    }
}

/// The result of a replay from a step, compared with the present state.
fn verified(
    from_step: u64,
    end: &Checkpoint,
    replayed: &Replayed,
    present: &Checkpoint,
) -> Verified {
    let (simulation, now) = (&end.simulation, &present.simulation);
    let hash = now.state.hash();
    let here = (simulation.epoch, simulation.state.step);
    let is_there = (here, end.seq()) == ((now.epoch, now.state.step), present.seq());
    // A swarm that has moved on is not compared.
    let now = is_there.then(|| simulation.state.hash() == hash);
    let differs_at = replayed.differs_at.or((now == Some(false)).then_some(here));
    Verified {
        from_step,
        to_step: here.1,
        hashes: replayed.same + u64::from(replayed.differs_at.is_some()) + u64::from(now.is_some()),
        differs_at: differs_at.map(|(_, step)| step),
        differs_in_epoch: differs_at.map(|(epoch, _)| epoch),
    }
}
