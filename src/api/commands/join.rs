//! `join`: a controller joins once it holds its liveliness token, since the daemon removes a controller when
//! its token ends.

use std::time::Duration;

use jostle_proto::keys;

use crate::api::context::Context;
use crate::api::incoming::Incoming;
use crate::api::responder::Responder;
use crate::convert;
use crate::convert::commands::CommandError;
use crate::swarm::handle::{CommandMessage, Handle, Message};

impl Context {
    /// Sends a `join` to its swarm, or keeps it until the token is declared. No thread waits meanwhile.
    pub(super) fn join(
        &self,
        incoming: &Incoming,
        responder: &Responder,
        (handle, controller): (Handle, &str),
        timeout: Duration,
        message: CommandMessage,
    ) -> Result<(), CommandError> {
        let swarm = handle.output.name.clone();
        let permit = match self.tokens.is_held(&swarm, controller) {
            true => None,
            false => {
                // It must not take the places of requests that need not wait.
                let (admission, waiting) = &self.token_waits;
                let user = self.counted_as(&incoming.token);
                let permit = admission.admit(incoming.payload.len(), &user, waiting);
                responder.release_places();
                Some(permit.ok_or(CommandError::Busy)?)
            }
        };
        responder.set_deadline(timeout, CommandError::deadline, Some(handle.last_step()));
        let missing = CommandError::NoToken {
            controller: controller.to_owned(),
            key: keys::ctl_alive(&self.prefix, &swarm, controller),
        };
        let (responder, name) = (responder.clone(), swarm.clone());
        let then = Box::new(move |is_held: bool| {
            // As long as it waits, also after its deadline.
            let _permit = permit;
            if !is_held {
                return responder.reject(&missing, handle.step());
            }
            responder.pass_to_swarm(
                &handle,
                |reply_to| {
                    Message::Command(CommandMessage {
                        reply_to,
                        ..message
                    })
                },
                move |stamp, outcome| convert::outcome(&name, &stamp, outcome, None),
            );
        });
        self.tokens.await_token(&swarm, controller, then);
        Ok(())
    }
}
