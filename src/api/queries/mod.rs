//! Queries: one file for each noun, or for several that are alike.

mod audit;
mod experiment;
mod export;
mod journal;
mod measures;
mod node;
mod recording;
mod snapshot;
mod swarm;
mod verify;
mod wait;

pub use node::schemas;

use crate::api::context::Context;
use crate::api::incoming::Incoming;
use crate::convert::commands::{CommandError, truncate};

impl Context {
    /// Rejects a query of a noun that does not exist.
    fn reject_noun(&self, incoming: &Incoming, known: &'static [&'static str]) {
        let key = incoming.key.as_str();
        let noun = key.split_once("/get/").map_or(key, |(_, noun)| noun);
        let error = CommandError::UnknownNoun {
            noun: truncate(noun),
            known,
        };
        self.reject(incoming, &error);
    }
}
