//! The commands that a swarm executes.

use std::sync::Arc;

use crate::api::context::Context;
use crate::api::incoming::Incoming;
use crate::api::responder::Responder;
use crate::convert;
use crate::convert::commands::{self, CommandError, ParsedCommand};
use crate::convert::digest::RequestIdentity;
use crate::swarm::handle::{self, Message};

impl Context {
    pub(super) fn swarm_command(
        &self,
        swarm: &Arc<str>,
        verb: &str,
        incoming: &Incoming,
        responder: &Responder,
    ) -> Result<(), CommandError> {
        let key = incoming.key();
        let request = self.request(incoming)?;
        let ParsedCommand {
            order,
            when,
            mut sender,
            timeout,
            returns_state,
        } = commands::read(verb, &request)?;
        if let Some(controller) = order.controller()
            && let rights = self.rights.current()
            && let Some(person) = rights.sender(incoming.token(), verb)?
        {
            person.permit_controller(controller)?;
        }
        if let Some(identity) = RequestIdentity::of(key, &request)
            && let Some(sender) = Arc::get_mut(&mut sender)
        {
            sender.digest = Some(identity.digest);
        }
        if !self.is_new(key, &request, responder)? {
            let step = self.host.find(swarm).map(|handle| handle.last_step());
            responder.set_deadline(timeout, CommandError::deadline, step);
            return Ok(());
        }
        let handle = self.find(swarm)?;
        let (name, output) = (swarm.clone(), handle.output.clone());
        self.send(
            swarm,
            responder,
            (timeout, CommandError::deadline),
            |answer| {
                Message::Command(handle::CommandMessage {
                    command: order,
                    when,
                    sender,
                    reply_to: answer,
                })
            },
            move |stamp, outcome| {
                let frame = returns_state.then(|| output.published());
                convert::outcome(&name, &stamp, outcome, frame)
            },
        );
        Ok(())
    }

    /// Replies to a retry of `delete` after its swarm is gone. Other daemons reply for their own
    /// swarms, so a first `delete` of an unknown swarm gets no reply.
    pub(crate) fn replay_deletion(&self, incoming: &Incoming) {
        if self.permit(incoming).is_ok()
            && let Ok(request) = self.request(incoming)
            && let Some(id) = &request.request_id
            && let Some(reply) = self.idempotency.find(incoming.key(), &request, id)
        {
            self.responder(incoming).send(move || reply);
        }
    }
}
