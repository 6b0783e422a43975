//! A swarm that is to be recorded.

use std::sync::Arc;

use jostle_results::recording::About;

use super::intake::Intake;
use super::shelf::Standing;
use crate::swarm::frame::Frame;
use crate::swarm::handle::Handle;
use crate::swarm::order::Recipe;
use crate::swarm::outlet::Tap;
use crate::wire::{self, Payload};

/// A swarm that is to be recorded, from where it was on.
pub struct Source {
    /// Its name.
    pub swarm: String,
    /// What waits to be written.
    pub intake: Arc<Intake>,
    /// Has that filled until it is dropped.
    pub tap: Arc<Tap>,
    recipe: Arc<Recipe>,
    now: Arc<Frame>,
}

impl Source {
    /// Takes what a swarm shows from now on: where it is, and all that comes. To be called between
    /// two steps; `missed` are missed already.
    pub fn tap(handle: &Handle, now: &Arc<Frame>, every: Option<u64>, missed: u64) -> Self {
        let intake = Arc::new(Intake::new(every, missed));
        let tap = intake.tap(&handle.outlet, now);
        Source {
            swarm: handle.outlet.name.clone(),
            recipe: handle.recipe.clone(),
            now: now.clone(),
            intake,
            tap,
        }
    }

    /// What a recording of it says of itself.
    pub fn about(&self, standing: &Standing) -> About {
        let json = |Payload { bytes, .. }| String::from_utf8_lossy(&bytes).into_owned();
        let spec = Payload::json(&wire::spec(&self.recipe, self.now.seed));
        let parameters = Payload::json(&wire::status(&self.now, None).parameters);
        let began = standing.began_unix_secs.to_string();
        let mut about = About::from([
            ("swarm".to_owned(), self.swarm.clone()),
            ("spec".to_owned(), json(spec)),
            ("parameters".to_owned(), json(parameters)),
            ("rate".to_owned(), json(Payload::json(&self.now.rate))),
            ("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            ("began_unix_secs".to_owned(), began),
        ]);
        if let Some(every) = standing.every {
            about.insert("every".to_owned(), every.to_string());
        }
        about
    }
}
