//! `discard`: deletes this daemon's swarm of a name that other daemons may also hold.

use jostle_proto::Request;
use jostle_proto::verbs::DiscardArgs;

use crate::api::context::{Context, Parsed};
use crate::convert::commands::{self, CommandError, check_name};

impl Context {
    pub(super) fn discard(
        &self,
        command: &Parsed<'_>,
        DiscardArgs { name }: DiscardArgs,
    ) -> Result<(), CommandError> {
        let Parsed {
            request, responder, ..
        } = *command;
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
