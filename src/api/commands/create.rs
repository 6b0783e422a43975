//! `create`: a new swarm.

use jostle_proto::verbs::CreateArgs;
use jostle_proto::{Request, keys};

use super::created;
use crate::api::context::Context;
use crate::api::responder::Responder;
use crate::convert;
use crate::convert::commands::{CommandError, DEFAULT_TIMEOUT, create};
use crate::convert::digest::RequestIdentity;
use crate::persistence::writer::{self, MakePayload};
use crate::swarm::handle::Ticket;
use crate::swarm::outcome::{Answer, Refusal};
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
        let spec = create::recipe(&args, self.host.limits())?;
        let CreateArgs { name, exist_ok, .. } = args;
        let answer = |is_new: bool| {
            let (responder, name, spec) = (responder.clone(), name.clone(), spec.clone());
            Answer::new(move |answered| match answered {
                Err(Refusal { step, error }) => responder.reject(&create::explain(error), step),
                answered => responder.respond(answered, move |place, outcome| {
                    created(&name, &place, &spec, outcome, is_new)
                }),
            })
        };
        let named = RequestIdentity::of(&key, request).map(|identity| {
            let (name, spec) = (name.clone(), spec.clone());
            let payload: MakePayload =
                Box::new(move |place, frame| convert::created(&name, place, &spec, frame, true));
            (identity, payload)
        });
        let register = writer::register(&self.store, &name, &spec, named);
        let created = self
            .host
            .create(&name, spec.clone(), exist_ok, register, || answer(true))?;
        if let Created::Existing(handle) = created {
            handle.send(Ticket::Look(answer(false)));
        }
        Ok(())
    }
}
