//! `discard`: deletes this daemon's swarm of a name that other daemons may also hold.

use jostle_proto::verbs::DiscardArgs;
use jostle_proto::{Request, keys};

use crate::api::context::Context;
use crate::api::responder::Responder;
use crate::convert;
use crate::convert::commands::{self, CommandError, DEFAULT_TIMEOUT, ParsedCommand, check_name};
use crate::swarm::handle::{self, Message};

impl Context {
    pub(super) fn discard(
        &self,
        responder: &Responder,
        request: &Request,
    ) -> Result<(), CommandError> {
        let key = keys::node_cmd(&self.prefix, &self.node, "discard");
        let begun = self.begin("discard", &key, request, DEFAULT_TIMEOUT, responder)?;
        let Some(DiscardArgs { name }) = begun else {
            return Ok(());
        };
        check_name("name", &name)?;
        // The journal records it as the `delete` that it is.
        let request = Request {
            request_id: request.request_id.clone(),
            client: request.client.clone(),
            timeout_secs: request.timeout_secs,
            ..Request::default()
        };
        let ParsedCommand {
            order,
            when,
            sender,
            timeout,
            ..
        } = commands::read("delete", &request)?;
        let swarm = name.clone();
        self.send(
            &swarm,
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
            move |stamp, outcome| convert::outcome(&name, &stamp, outcome, None),
        );
        Ok(())
    }
}
