//! Commands: one file for each verb that more than a swarm executes, and `swarm.rs` for all others.

mod create;
mod discard;
mod experiment;
mod fork;
mod record;
mod replay;
mod restore;
mod seek;
mod swarm;

use std::sync::Arc;

use jostle_physics::simulation::Spec;
use jostle_proto::keys;

pub use record::{count, resume};

use crate::api::context::Context;
use crate::api::incoming::Incoming;
use crate::api::responder::Responder;
use crate::convert::commands::{CommandError, truncate};
use crate::convert::{self, Payload};
use crate::swarm::frame::Stamp;
use crate::swarm::outcome::Outcome;

impl Context {
    /// Executes a command to a swarm.
    pub(crate) fn command(&self, swarm: &Arc<str>, incoming: &Incoming) {
        let responder = self.responder(incoming);
        let verb = incoming
            .key()
            .strip_prefix(&keys::cmd(&self.prefix, swarm, ""));
        let done = match verb {
            _ if incoming.is_wild() => Err(CommandError::Wildcard),
            Some("fork") => self.fork(swarm, incoming, &responder),
            Some("seek") => self.seek(swarm, incoming, &responder),
            verb => self.swarm_command(swarm, verb.unwrap_or_default(), incoming, &responder),
        };
        if let Err(error) = done {
            let step = self.host.find(swarm).and_then(|handle| handle.step());
            responder.reject(&error, step);
        }
    }

    /// Executes a command to the daemon.
    pub(crate) fn node_command(&self, incoming: &Incoming) {
        let responder = self.responder(incoming);
        if let Err(error) = self.execute_node_command(incoming, &responder) {
            responder.reject(&error, None);
        }
    }

    fn execute_node_command(
        &self,
        incoming: &Incoming,
        responder: &Responder,
    ) -> Result<(), CommandError> {
        if incoming.is_wild() {
            return Err(CommandError::Wildcard);
        }
        let prefix = keys::node_cmd(&self.prefix, &self.node, "");
        let execute = match incoming.key().strip_prefix(&prefix) {
            Some("create") => Self::create,
            Some("restore") => Self::restore,
            Some("discard") => Self::discard,
            Some("experiment") => Self::experiment,
            Some("replay") => Self::replay,
            Some("record") => Self::record,
            verb => {
                return Err(CommandError::UnknownVerb {
                    verb: truncate(verb.unwrap_or_default()),
                    known: &keys::NODE_VERBS,
                });
            }
        };
        execute(self, responder, &self.request(incoming)?)
    }
}

/// The reply to a command that creates a swarm.
fn created(name: &str, stamp: &Stamp, spec: &Spec, outcome: Outcome, is_new: bool) -> Payload {
    match outcome {
        Outcome::State(frame) => convert::created(name, stamp, spec, &frame, is_new),
        other => convert::outcome(name, stamp, other, None),
    }
}
