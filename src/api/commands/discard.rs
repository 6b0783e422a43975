//! `discard`: deletes this daemon's swarm of a name that other daemons may also hold.

use jostle_proto::verbs::DiscardArgs;
use jostle_proto::{Request, keys};

use crate::api::context::Context;
use crate::api::responder::Responder;
use crate::convert::commands::{self, CommandError, DEFAULT_TIMEOUT, check_name};

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
        let delete = Request {
            request_id: request.request_id.clone(),
            client: request.client.clone(),
            ..Request::default()
        };
        let (message, _) = commands::read("delete", &delete)?;
        let timeout = commands::timeout(request)?;
        super::send(responder, &self.find(&name)?, timeout, message, false);
        Ok(())
    }
}
