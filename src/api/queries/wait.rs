//! `get/wait`: replies with the status once a condition holds.

use std::sync::Arc;

use super::swarm::status;
use crate::api::context::Context;
use crate::api::incoming::Incoming;
use crate::api::responder::Responder;
use crate::convert;
use crate::convert::commands::CommandError;
use crate::convert::commands::wait::{self, Awaited};
use crate::swarm::awaited;
use crate::swarm::handle::{ConditionWait, Message, Outcome, ReplyTo, Waiter};

impl Context {
    pub(super) fn wait(
        &self,
        swarm: &Arc<str>,
        incoming: &Incoming,
        responder: &Responder,
    ) -> Result<(), CommandError> {
        let (awaited, timeout) = wait::read(incoming.parameters())?;
        let handle = self.find(swarm)?;
        let (name, store) = (swarm.clone(), self.store.clone());
        let verifications = self.verifications.clone();
        let is_abandoned = Box::new(responder.is_abandoned());
        let message: Box<dyn FnOnce(ReplyTo) -> Message> = match awaited {
            Awaited::Of(condition) => Box::new(move |reply_to| {
                Message::Wait(Waiter {
                    condition,
                    is_abandoned,
                    reply_to,
                })
            }),
            Awaited::Holds(condition, id) => {
                let (id, holder) = match (incoming.peer.connection(), id) {
                    (Some((connection, _)), Some(id)) => (id, connection),
                    (Some((connection, name)), None) => (name, connection),
                    (None, Some(id)) => {
                        let holder = self.peers.holder_of_wait(swarm, &id);
                        (id, holder)
                    }
                    (None, None) => {
                        let problem =
                            "is missing: give the wait an id, and hold its liveliness token";
                        return Err(CommandError::field("id", problem));
                    }
                };
                let awaited = awaited::Awaited {
                    id: id.into(),
                    user: self.counted_as(&incoming.token),
                    is_operator: self.is_operator(incoming),
                    condition: *condition,
                    holder,
                };
                Box::new(move |reply_to| {
                    Message::WaitFor(Box::new(ConditionWait {
                        awaited,
                        is_abandoned,
                        reply_to,
                    }))
                })
            }
        };
        let record = handle.record.clone();
        responder.send_to_swarm(
            &handle,
            (timeout, CommandError::not_yet),
            message,
            move |stamp, outcome| match outcome {
                Outcome::State(frame) => {
                    let verifying = verifications.share(&name);
                    status(&store, (&record, verifying), &name, &stamp, &frame)
                }
                other => convert::outcome(&name, &stamp, other, None),
            },
        );
        Ok(())
    }
}
