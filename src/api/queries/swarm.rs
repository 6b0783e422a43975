//! `state`, and the nouns of a swarm that are read from its newest state and its history.

use std::sync::Arc;

use jostle_proto::{HistoryFrom, Status, keys};

use crate::api::context::Context;
use crate::api::incoming::{Incoming, page};
use crate::api::queries::export::{self, Export};
use crate::api::responder::Responder;
use crate::convert::commands::{CommandError, DEFAULT_TIMEOUT};
use crate::convert::{self, Payload};
use crate::store::Store;
use crate::swarm::frame::{Frame, Stamp};
use crate::swarm::handle::{Handle, Message, Outcome, Record};

/// Nouns that a wildcard does not match: `wait` blocks, the others are expensive.
const CONCRETE_ONLY: [&str; 4] = ["wait", "verify", "snapshot", "experiment"];

impl Context {
    /// Replies with the newest state.
    pub(crate) fn state(&self, swarm: &Arc<str>, incoming: &Incoming) {
        let key = keys::state(&self.prefix, swarm);
        let responder = self.replies.responder(incoming, key);
        let is_json = match incoming.wants_json() {
            Ok(is_json) => is_json,
            Err(error) => return responder.reject(&error, None),
        };
        let handle = match self.find(swarm) {
            Ok(handle) => handle,
            Err(error) => return responder.reject(&error, None),
        };
        let output = handle.output.clone();
        // Counted before the state is taken: later states have greater numbers.
        let published = output.published();
        query_frame(&handle, &responder, move |_, frame| {
            let state = convert::state(&output.name, frame, published);
            if is_json {
                Payload::json(&state)
            } else {
                Payload::cbor(&state)
            }
        });
    }

    /// Replies to each noun that the key expression matches.
    pub(crate) fn get(&self, swarm: &Arc<str>, incoming: &Incoming) {
        let is_concrete = !incoming.is_wild;
        let mut is_known = false;
        for noun in keys::SWARM_GETS {
            let key = keys::get(&self.prefix, swarm, noun);
            if !incoming.peer.matches(&key) || (CONCRETE_ONLY.contains(&noun) && !is_concrete) {
                continue;
            }
            is_known = true;
            let responder = match noun {
                "wait" | "verify" | "experiment" => {
                    self.replies.responder(&incoming.without_places(), key)
                }
                _ => self.replies.responder(incoming, key),
            };
            let done = match noun {
                "measures" => self.measures(swarm, incoming, &responder),
                "journal" => self.journal(swarm, incoming, &responder),
                "wait" => self.wait(swarm, incoming, &responder),
                "experiment" => export::options(incoming).and_then(|options| {
                    let export = Export {
                        store: self.store.clone(),
                        swarm: swarm.clone(),
                        handle: self.find(swarm)?,
                        responder: responder.clone(),
                        options,
                        max_request_bytes: self.max_request_bytes(),
                    };
                    export.begin(self, incoming)
                }),
                "verify" => self.verify(swarm, incoming, &responder),
                "snapshot" => incoming.no_parameters().and_then(|()| {
                    self.snapshot(swarm, &self.find(swarm)?, &responder);
                    Ok(())
                }),
                noun => self.get_noun(swarm, noun, incoming, &responder),
            };
            if let Err(error) = done {
                responder.reject(&error, None);
            }
        }
        if is_known {
            return;
        }
        if is_concrete {
            return self.reject_noun(incoming, &keys::SWARM_GETS);
        }
        let key = incoming.key.as_str();
        let noun = key.rsplit_once('/').map_or(key, |(_, noun)| noun);
        if CONCRETE_ONLY.contains(&noun) {
            let error = CommandError::Field {
                field: "swarm",
                problem: "is a wildcard: wait, verify, snapshot and experiment are of one swarm, by its own \
                          key",
            };
            self.reject(incoming, &error);
        }
    }

    fn get_noun(
        &self,
        swarm: &Arc<str>,
        noun: &'static str,
        incoming: &Incoming,
        responder: &Responder,
    ) -> Result<(), CommandError> {
        let (after, limit) = match noun {
            "events" => page(incoming.parameters())?,
            _ => incoming.no_parameters().map(|()| (0, 0))?,
        };
        let (name, handle) = (swarm.clone(), self.find(swarm)?);
        let (limits, store) = (self.registry.limits(), self.store.clone());
        let verifying = self.verifications.share(swarm);
        let record = handle.record.clone();
        query_frame(&handle.clone(), responder, move |stamp, seen| match noun {
            "spec" => {
                let spec = jostle_convert::spec::to_proto(&handle.spec, seen.seed);
                Payload::json(&convert::reply(&name, stamp, spec))
            }
            "controllers" => {
                let controllers = convert::controllers(seen);
                Payload::json(&convert::reply(&name, stamp, controllers))
            }
            "parameters" => {
                let parameters = convert::parameters(seen, limits);
                Payload::json(&convert::reply(&name, stamp, parameters))
            }
            "events" => {
                let events = convert::events(&name, handle.history.events(after, limit));
                Payload::json(&convert::reply(&name, stamp, events))
            }
            _ => status(&store, (&record, verifying), &name, stamp, seen),
        });
        Ok(())
    }
}

/// Replies with what `payload` makes of the newest state.
fn query_frame(
    handle: &Handle,
    responder: &Responder,
    payload: impl FnOnce(&Stamp, &Frame) -> Payload + Send + 'static,
) {
    let output = handle.output.clone();
    responder.send_to_swarm(
        handle,
        (DEFAULT_TIMEOUT, CommandError::read_deadline),
        Message::Query,
        move |stamp, outcome| match outcome {
            Outcome::State(frame) => payload(&stamp, &frame),
            other => convert::outcome(&output.name, &stamp, other, None),
        },
    );
}

/// The status of a swarm.
pub(super) fn status(
    store: &Store,
    (record, verifying): (&Record, Option<f64>),
    swarm: &str,
    stamp: &Stamp,
    frame: &Frame,
) -> Payload {
    // A store that cannot be read writes to the log; the field is then omitted.
    let oldest = store.history_from(swarm).ok().flatten();
    let history_from = oldest.map(|checkpoint| HistoryFrom {
        epoch: checkpoint.epoch,
        step: checkpoint.step,
    });
    let status = Status {
        verifying,
        swarm_id: record.swarm_id.get().copied(),
        origin: convert::origin(record),
        ..convert::status(frame, history_from)
    };
    Payload::json(&convert::reply(swarm, stamp, status))
}
