//! `get/wait`: replies with the status once a condition holds.

use std::sync::Arc;

use super::swarm::status;
use crate::api::context::Context;
use crate::api::incoming::Incoming;
use crate::api::responder::Responder;
use crate::convert;
use crate::convert::commands::{CommandError, wait};
use crate::swarm::handle::{Message, Outcome, Waiter};

impl Context {
    pub(super) fn wait(
        &self,
        swarm: &Arc<str>,
        incoming: &Incoming,
        responder: &Responder,
    ) -> Result<(), CommandError> {
        let (awaited, timeout) = wait::read(incoming.parameters())?;
        let (name, store) = (swarm.clone(), self.store.clone());
        let verifications = self.verifications.clone();
        let is_abandoned = Box::new(responder.is_abandoned());
        responder.send_to_swarm(
            &self.find(swarm)?,
            (timeout, CommandError::not_yet),
            |answer| {
                Message::Wait(Waiter {
                    condition: awaited,
                    is_abandoned,
                    reply_to: answer,
                })
            },
            move |stamp, outcome| match outcome {
                Outcome::State(frame) => {
                    let verifying = verifications.share(&name);
                    status(&store, verifying, &name, &stamp, &frame)
                }
                other => convert::outcome(&name, &stamp, other, None),
            },
        );
        Ok(())
    }
}
