//! `create`: a new swarm.

use jostle_proto::verbs::CreateArgs;

use super::created;
use crate::api::context::{Context, Parsed};
use crate::convert::commands::{CommandError, create};
use crate::persistence::writer::NewSwarm;
use crate::swarm::handle::{Message, Rejection, ReplyTo};
use crate::swarm::registry::Created;

impl Context {
    pub(super) fn create(
        &self,
        command: &Parsed<'_>,
        args: CreateArgs,
    ) -> Result<(), CommandError> {
        let spec = create::spec(&args, self.registry.limits())?;
        let CreateArgs { name, exist_ok, .. } = args;
        let answer = |is_new: bool| {
            let (name, spec) = (name.clone(), spec.clone());
            let responder = command.responder.clone();
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
            identity: command.identity(),
        });
        let about = (spec.clone(), command.creation("create"));
        let created = self
            .registry
            .create(&name, about, exist_ok, persist, || answer(true))?;
        if let Created::Existing(handle) = created {
            handle.send(Message::Query(answer(false)));
        }
        Ok(())
    }
}
