//! `create`: a new swarm.

use jostle_proto::verbs::CreateArgs;
use jostle_proto::{Request, keys};

use super::created;
use crate::api::context::Context;
use crate::api::responder::Responder;
use crate::convert::commands::{CommandError, DEFAULT_TIMEOUT, create};
use crate::convert::digest::RequestIdentity;
use crate::persistence::writer::NewSwarm;
use crate::swarm::handle::{Message, Rejection, ReplyTo};
use crate::swarm::registry::Created;

impl Context {
    pub(super) fn create(
        &self,
        responder: &Responder,
        request: &Request,
    ) -> Result<(), CommandError> {
        let key = keys::node_cmd(&self.prefix, &self.node, "create");
        let begun = self.begin("create", &key, request, DEFAULT_TIMEOUT, responder)?;
        let Some(args) = begun else {
            return Ok(());
        };
        let spec = create::spec(&args, self.host.limits())?;
        let CreateArgs { name, exist_ok, .. } = args;
        let answer = |is_new: bool| {
            let (responder, name, spec) = (responder.clone(), name.clone(), spec.clone());
            ReplyTo::new(move |answered| match answered {
                Err(Rejection { step, error }) => responder.reject(&create::explain(error), step),
                answered => responder.respond(answered, move |stamp, outcome| {
                    created(&name, &stamp, &spec, outcome, is_new)
                }),
            })
        };
        let persist = Box::new(NewSwarm {
            store: self.store.clone(),
            name: name.clone(),
            spec: spec.clone(),
            identity: RequestIdentity::of(&key, request),
        });
        let created = self
            .host
            .create(&name, spec.clone(), exist_ok, persist, || answer(true))?;
        if let Created::Existing(handle) = created {
            handle.send(Message::Query(answer(false)));
        }
        Ok(())
    }
}
