//! `get/experiment`: the commands of a swarm since its start, as the file of an experiment.

use std::sync::Arc;
use std::thread;

use jostle_convert::hexadecimal;
use jostle_experiment::{SwarmHistory, experiment_file};
use jostle_proto::ExperimentFile;

use super::verify::present;
use crate::api::responder::Responder;
use crate::convert::commands::{CommandError, DEFAULT_TIMEOUT};
use crate::convert::{self, Payload};
use crate::persistence::applied::changes_since_start;
use crate::store::Store;
use crate::swarm::error::SwarmError;
use crate::swarm::handle::{Handle, Message, ReplyTo};

/// An export of a swarm's commands.
struct Export {
    store: Store,
    swarm: Arc<str>,
    handle: Handle,
    responder: Responder,
}

/// Starts a thread that reads the journal of a swarm and replies.
///
/// # Errors
///
/// [`SwarmError::Recorded`] for a playback, and [`CommandError::Busy`] if there is no thread.
pub(super) fn begin(
    store: &Store,
    swarm: &Arc<str>,
    handle: Handle,
    responder: &Responder,
) -> Result<(), CommandError> {
    if handle.summary().is_some_and(|it| it.is_replay) {
        return Err(SwarmError::Recorded.into());
    }
    responder.set_deadline(DEFAULT_TIMEOUT, CommandError::deadline, None);
    let export = Export {
        store: store.clone(),
        swarm: swarm.clone(),
        handle,
        responder: responder.clone(),
    };
    let thread = thread::Builder::new().name("export".into());
    let spawned = thread.spawn(move || {
        if let Err(error) = export.reply() {
            export.responder.reject(&error, export.handle.step());
        }
    });
    spawned.map(drop).map_err(|_| CommandError::Busy)
}

impl Export {
    /// Reads the journal and replies, unless that fails.
    fn reply(&self) -> Result<(), CommandError> {
        let present = present(&self.handle)?;
        let changes = changes_since_start(&self.store, &self.swarm, &present)?;
        let state = &present.simulation.state;
        let history = SwarmHistory {
            name: self.swarm.to_string(),
            spec: jostle_convert::spec::to_proto(&present.simulation.spec, state.seed),
            steps: state.step,
            state_hash: hexadecimal(&state.hash()),
            changes,
        };
        let file =
            experiment_file(&history).map_err(|error| CommandError::History(error.to_string()))?;
        let result = ExperimentFile {
            file,
            steps: history.steps,
            state_hash: history.state_hash,
        };
        let (swarm, responder) = (self.swarm.clone(), self.responder.clone());
        self.handle
            .send(Message::Query(ReplyTo::new(move |answered| {
                responder.respond(answered, move |stamp, _| {
                    Payload::json(&convert::reply(&swarm, &stamp, result))
                });
            })));
        Ok(())
    }
}
