//! `get/measures`: measures of the newest state of a swarm.

use std::sync::Arc;

use crate::api::context::Context;
use crate::api::incoming::Incoming;
use crate::api::responder::Responder;
use crate::convert::commands::{CommandError, DEFAULT_TIMEOUT, measures};
use crate::convert::{self, Payload};
use crate::lanes::{Lane, Task};
use crate::swarm::handle::{Message, Outcome, Rejection, ReplyTo};

impl Context {
    /// Replies with measures. The swarm's thread only copies the state: the lane `measures`
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
        responder.set_deadline(DEFAULT_TIMEOUT, CommandError::read_deadline, last_step);
        let (name, responder) = (swarm.clone(), responder.clone());
        let (lanes, turn) = (self.lanes.clone(), self.turn(incoming, swarm));
        handle.send(Message::Query(ReplyTo::new(
            move |answered| match answered {
                Ok((stamp, Outcome::State(frame))) => {
                    let step = stamp.step;
                    let evaluated = responder.clone();
                    let task =
                        Task::new(&turn, move |_| match convert::measures(&frame, requested) {
                            Ok(values) => evaluated.complete(move || {
                                Ok(Payload::json(&convert::reply(&name, &stamp, values)))
                            }),
                            Err(error) => evaluated.reject(&error.into(), Some(stamp.step)),
                        });
                    let task = task.while_wanted(responder.is_wanted());
                    if lanes.submit(Lane::Measures, task).is_err() {
                        responder.reject(&CommandError::Busy, Some(step));
                    }
                }
                Ok((stamp, other)) => {
                    responder.complete(move || Ok(convert::outcome(&name, &stamp, other, None)));
                }
                Err(Rejection { step, error }) => responder.reject(&error.into(), step),
            },
        )));
        Ok(())
    }
}
