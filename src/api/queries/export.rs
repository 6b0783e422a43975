//! `get/experiment`: the commands of a swarm since its start, as the file of an experiment.

use std::sync::Arc;

use jostle_convert::hexadecimal;
use jostle_experiment::{ExportOptions, MAX_RUNS, SwarmHistory, experiment_file};
use jostle_proto::ExperimentFile;
use jostle_proto::contract::selectors;

use super::verify::present;
use crate::api::context::Context;
use crate::api::incoming::Incoming;
use crate::api::responder::Responder;
use crate::convert::commands::{CommandError, DEFAULT_TIMEOUT, selector};
use crate::convert::{self, Payload};
use crate::lanes::Lane;
use crate::persistence::applied::{ChangesSinceStart, changes_since_start};
use crate::store::Store;
use crate::swarm::error::SwarmError;
use crate::swarm::handle::{Handle, Message, ReplyTo};

/// The bytes around a file in a request that submits it.
const SUBMIT_BYTES: usize = 4096;

/// The longest name of a CSV of set-points.
const MAX_NAME_BYTES: usize = 200;

/// An export of a swarm's commands.
pub struct Export {
    pub(super) store: Store,
    pub(super) swarm: Arc<str>,
    pub(super) handle: Handle,
    pub(super) responder: Responder,
    pub(super) options: ExportOptions,
    /// The longest request of a client.
    pub(super) max_request_bytes: usize,
}

/// Reads the parameters of the query.
pub(super) fn options(incoming: &Incoming) -> Result<ExportOptions, CommandError> {
    let mut options = ExportOptions::default();
    for (name, value) in selector(incoming.parameters(), selectors::EXPORT)? {
        match name {
            "replicates" => {
                let number = value.parse().ok();
                let number = number.filter(|number| (1..=MAX_RUNS).contains(number));
                options.replicates = Some(number.ok_or(CommandError::Unreadable {
                    field: "replicates",
                    expected: selectors::REPLICATES,
                })?);
            }
            _ if is_file_name(value) => options.setpoints = Some(value.to_owned()),
            _ => {
                return Err(CommandError::Field {
                    field: "setpoints",
                    problem: "is no name of a file: use letters, digits, '.', '-' and '_', the \
                              first not '.'",
                });
            }
        }
    }
    Ok(options)
}

/// Whether a text is the name of a file on every system and needs no escape in a file or a selector.
fn is_file_name(name: &str) -> bool {
    let is_plain = |it: char| it.is_alphanumeric() || matches!(it, '.' | '-' | '_');
    (1..=MAX_NAME_BYTES).contains(&name.len())
        && !name.starts_with('.')
        && name.chars().all(is_plain)
}

/// Returns the length of a text in a JSON message, where a newline and a quote take two bytes.
fn json_bytes(text: &str) -> usize {
    serde_json::Value::from(text).to_string().len()
}

impl Export {
    /// Queues it.
    ///
    /// # Errors
    ///
    /// [`SwarmError::Recorded`] for a playback, and [`CommandError::Busy`] if the queue is full.
    pub(super) fn begin(self, context: &Context, incoming: &Incoming) -> Result<(), CommandError> {
        if self.handle.summary().is_some_and(|it| it.is_replay) {
            return Err(SwarmError::Recorded.into());
        }
        let responder = self.responder.clone();
        responder.set_deadline(DEFAULT_TIMEOUT, CommandError::read_deadline, None);
        let turn = context.turn(incoming, &self.swarm);
        context.queue_read(Lane::Exports, &turn, &responder, move || {
            if let Err(error) = self.reply() {
                self.responder.reject(&error, self.handle.step());
            }
        })
    }

    /// Reads the journal and replies, unless that fails.
    fn reply(&self) -> Result<(), CommandError> {
        let present = present(&self.handle)?;
        let ChangesSinceStart {
            changes,
            omitted,
            set_points,
        } = changes_since_start(&self.store, &self.swarm, &present)?;
        let state = &present.simulation.state;
        let history = SwarmHistory {
            name: self.swarm.to_string(),
            spec: jostle_convert::spec::to_proto(&present.simulation.spec, state.seed),
            steps: state.step,
            state_hash: hexadecimal(&state.hash()),
            changes,
            omitted,
            set_points,
        };
        let files = experiment_file(&history, &self.options)
            .map_err(|error| CommandError::History(error.to_string()))?;
        let bytes = json_bytes(&files.toml) + files.setpoints.as_deref().map_or(0, json_bytes);
        // A daemon with the same limits must accept it.
        let max_bytes = self.max_request_bytes - SUBMIT_BYTES;
        if bytes > max_bytes {
            return Err(CommandError::ExportTooLong { bytes, max_bytes });
        }
        let result = ExperimentFile {
            file: files.toml,
            setpoints: files.setpoints,
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
