//! What swarms write down, on its way into the store.

use std::sync::Arc;

use jostle_physics::simulation::Spec;
use jostle_proto as proto;
use serde::{Deserialize, Serialize};

use crate::convert::digest::RequestIdentity;
use crate::convert::{self, Payload, durable};
use crate::store::{self, Store, StoreFault, Write};
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::error::WriteFault;
use crate::swarm::frame::{Frame, Place};
use crate::swarm::journal::{Entry, JournalWriter, Reached};
use crate::swarm::outcome::Outcome;
use crate::swarm::registry::{Archive, Register};

/// What is stored of a swarm beside its journal.
#[derive(Serialize, Deserialize)]
pub(crate) struct About {
    /// What it was created from.
    pub(crate) spec: proto::Spec,
}

/// Writes the journal of one swarm to the store.
struct StoreWriter {
    store: Store,
    swarm: String,
}

impl JournalWriter for StoreWriter {
    fn commit(&self, entries: Vec<Entry>) -> Result<(), WriteFault> {
        self.store.commit(self.writes(entries)).map_err(fault)
    }

    fn append(&self, entries: Vec<Entry>, reached: Option<Reached>) {
        let writes = self.writes(entries);
        match reached {
            None => self.store.submit(writes, None),
            Some(reached) => self
                .store
                .submit_then(writes, Box::new(move || reached.is_durable())),
        }
    }
}

impl StoreWriter {
    fn writes(&self, entries: Vec<Entry>) -> Vec<Write> {
        let entries = entries.into_iter();
        entries
            .flat_map(|entry| writes(&self.swarm, entry))
            .collect()
    }
}

/// Makes the writers of the journals of all swarms.
pub fn archive(store: &Store) -> Archive {
    let store = store.clone();
    Box::new(move |swarm| {
        Arc::new(StoreWriter {
            store: store.clone(),
            swarm: swarm.to_owned(),
        })
    })
}

/// Makes a new swarm safe, and with it the answer to whoever asked for it by name.
pub fn register(
    store: &Store,
    swarm: &str,
    recipe: &Spec,
    named: Option<(RequestIdentity, MakePayload)>,
) -> Register {
    let (store, swarm) = (store.clone(), swarm.to_owned());
    let spec = jostle_convert::spec::to_proto(recipe, recipe.seed);
    Box::new(move |checkpoint, place, frame| {
        let mut writes = vec![Write::Create {
            swarm: swarm.clone(),
            about: proto::to_cbor(&About { spec }),
            first: kept(&swarm, checkpoint),
        }];
        if let Some((named, payload)) = named {
            let payload = payload(place, frame);
            writes.push(Write::Answer(store::Answer {
                client: named.client,
                request_id: named.request_id,
                digest: named.digest,
                swarm,
                number: 0,
                is_ok: true,
                encoding: payload.encoding.to_owned(),
                body: payload.bytes,
            }));
        }
        store.commit(writes).map_err(fault)
    })
}

/// Makes the answer of a new swarm's place and frame.
pub type MakePayload = Box<dyn FnOnce(&Place, &Frame) -> Payload + Send>;

/// What is to be stored of what a swarm writes.
pub(crate) fn writes(swarm: &str, entry: Entry) -> Vec<Write> {
    let swarm = swarm.to_owned();
    match entry {
        Entry::Line(line) => {
            let (kind, body) = durable::record(&line.record);
            let row = store::Row {
                number: line.number,
                epoch: line.epoch,
                step: line.step,
                kind,
                body,
            };
            vec![Write::Append { swarm, row }]
        }
        Entry::Checkpoint(checkpoint) => {
            let checkpoint = kept(&swarm, &checkpoint);
            vec![Write::Keep { swarm, checkpoint }]
        }
        Entry::End(place, sender) => {
            let answer = sender.request_id.clone().zip(sender.digest);
            let answer = answer.map(|(request_id, digest)| {
                let payload = convert::outcome(&swarm, &place, Outcome::Done, None);
                Write::Answer(store::Answer {
                    client: sender.client.clone(),
                    request_id,
                    digest,
                    swarm: swarm.clone(),
                    number: 0,
                    is_ok: true,
                    encoding: payload.encoding.to_owned(),
                    body: payload.bytes,
                })
            });
            let end = Write::Delete { swarm };
            std::iter::once(end).chain(answer).collect()
        }
    }
}

fn kept(swarm: &str, checkpoint: &Checkpoint) -> store::Checkpoint {
    store::Checkpoint {
        number: checkpoint.lines,
        epoch: checkpoint.simulation.epoch,
        step: checkpoint.simulation.state.step,
        body: proto::to_cbor(&durable::snapshot(swarm, checkpoint)),
    }
}

fn fault(fault: StoreFault) -> WriteFault {
    match fault {
        StoreFault::Full => WriteFault::Full,
        other => WriteFault::Failed(other.to_string()),
    }
}
