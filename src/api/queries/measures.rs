//! `get/measures`: measures of the newest state of a swarm.

use std::sync::Arc;

use crate::api::context::{Context, Executor};
use crate::api::incoming::Incoming;
use crate::api::responder::Responder;
use crate::convert::commands::{CommandError, DEFAULT_TIMEOUT, measures};
use crate::convert::{self, Payload};
use crate::swarm::handle::{Message, Outcome, Rejection, ReplyTo};

/// The niceness of the thread that evaluates measures: lower priority than the swarms, whose steps it
/// must not delay.
const NICENESS: i32 = 10;

/// Starts the thread that evaluates measures.
pub fn start_evaluations() -> std::io::Result<Executor<()>> {
    let evaluations = Executor::start("measures", ())?;
    evaluations.submit(|()| {
        // Without permission the thread has the priority of the daemon, and works all the same.
        let _ = rustix::process::setpriority_process(None, NICENESS);
    });
    Ok(evaluations)
}

impl Context {
    /// Replies with measures. The swarm's thread only copies the state: the thread `measures`
    /// evaluates them, so that a large group delays neither its steps nor other replies.
    pub(super) fn measures(
        &self,
        swarm: &Arc<str>,
        incoming: &Incoming,
        responder: &Responder,
    ) -> Result<(), CommandError> {
        let requested = measures::read(incoming.parameters())?;
        let handle = self.find(swarm)?;
        let last_step = Some(handle.last_step());
        responder.set_deadline(DEFAULT_TIMEOUT, CommandError::deadline, last_step);
        let (name, responder) = (swarm.clone(), responder.clone());
        let evaluations = self.evaluations.clone();
        handle.send(Message::Query(ReplyTo::new(
            move |answered| match answered {
                Ok((stamp, Outcome::State(frame))) => evaluations.submit(move |()| {
                    // The deadline may have passed while it was queued.
                    if responder.is_done() {
                        return;
                    }
                    match convert::measures(&frame, requested) {
                        Ok(values) => responder.complete(move || {
                            Ok(Payload::json(&convert::reply(&name, &stamp, values)))
                        }),
                        Err(error) => responder.reject(&error.into(), Some(stamp.step)),
                    }
                }),
                Ok((stamp, other)) => {
                    responder.complete(move || Ok(convert::outcome(&name, &stamp, other, None)));
                }
                Err(Rejection { step, error }) => responder.reject(&error.into(), step),
            },
        )));
        Ok(())
    }
}
