//! `get/verify`: replays the history of a swarm and compares the hashes.

use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::Duration;

use jostle_proto::Verified;
use jostle_proto::contract::selectors;

use crate::api::context::Context;
use crate::api::incoming::Incoming;
use crate::api::responder::Responder;
use crate::api::verifications::Verification;
use crate::convert::commands::{CommandError, check_timeout, selector};
use crate::convert::{self, Payload};
use crate::lanes::{Lane, Rank, Task, Ticket};
use crate::persistence::replay;
use crate::store::Store;
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::error::SwarmError;
use crate::swarm::handle::{Handle, Message, Outcome, Rejection, ReplyTo};
use crate::swarm::journal::Replayed;

/// The default timeout, after which nobody may be waiting: zenoh does not report a client that is gone.
const TIMEOUT: Duration = Duration::from_secs(60);

/// A verification of a swarm.
struct Verify {
    store: Store,
    swarm: Arc<str>,
    handle: Handle,
    responder: Responder,
}

impl Context {
    /// Queues the verification of a swarm. That of an operator has the CPU time that swarms leave, that of
    /// another user a share of it.
    pub(super) fn verify(
        &self,
        swarm: &Arc<str>,
        incoming: &Incoming,
        responder: &Responder,
    ) -> Result<(), CommandError> {
        let handle = self.find(swarm)?;
        if handle.summary().is_some_and(|it| it.is_replay) {
            responder.reject(&SwarmError::Recorded.into(), handle.step());
            return Ok(());
        }
        responder.set_deadline(timeout(incoming)?, CommandError::verify_deadline, None);
        let rank = match self.is_operator(incoming) {
            true => Rank::Second,
            false => Rank::Metered,
        };
        let verify = Verify {
            store: self.store.clone(),
            swarm: swarm.clone(),
            handle,
            responder: responder.clone(),
        };
        let own = self.verifications.begin(swarm);
        let work = move |ticket| {
            if let Err(error) = verify.reply(own, ticket) {
                verify.responder.reject(&error, verify.handle.step());
            }
        };
        let task = Task::new(&self.turn(incoming, swarm), work);
        let task = task.while_wanted(responder.is_wanted());
        Ok(self
            .lanes
            .submit(Lane::Replays, task.alone_on(swarm, rank))?)
    }
}

/// Reads the parameter of the query.
fn timeout(incoming: &Incoming) -> Result<Duration, CommandError> {
    let parameters = selector(incoming.parameters(), selectors::VERIFY)?;
    let Some((name, value)) = parameters.first() else {
        return Ok(TIMEOUT);
    };
    let secs = value.parse();
    check_timeout(secs.map_err(|_| CommandError::field(name, "is not a number"))?)
}

impl Verify {
    /// Replays the history, and replies unless that fails or nobody waits any more.
    fn reply(&self, own: Verification, ticket: Ticket) -> Result<(), CommandError> {
        let present = present(&self.handle)?;
        let on_progress = move |share| own.advance(share);
        let goes_on = Box::new(move || ticket.goes_on());
        let replayed =
            replay::replay_all(&self.store, &self.swarm, &present, on_progress, goes_on)?;
        let Some((from, end, replayed)) = replayed else {
            return Ok(());
        };
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::api::incoming::fixture::request;

    #[test]
    fn a_verify_without_a_timeout_ends_after_a_minute() {
        let (incoming, _replies) = request(false);
        let timeout = timeout(&incoming).ok();
        assert_eq!(timeout, Some(Duration::from_secs(60)));
    }
}
