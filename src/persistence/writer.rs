//! Writes the journals, checkpoints and ends of swarms to the store.

use std::sync::Arc;

use jostle_physics::simulation::Spec;
use jostle_proto as proto;
use serde::{Deserialize, Serialize};

use crate::convert::digest::RequestIdentity;
use crate::convert::{self, Payload, durable};
use crate::store::{self, Store, StoreFault, Write};
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::error::WriteFault;
use crate::swarm::frame::{Frame, Stamp};
use crate::swarm::journal::{Entry, JournalWriter, Reached};
use crate::swarm::outcome::Outcome;
use crate::swarm::runner::{JournalFactory, PersistNew};

/// The stored metadata of a swarm.
#[derive(Serialize, Deserialize)]
pub(crate) struct SwarmMetadata {
    /// The spec from which it was created.
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

impl JournalFactory for Store {
    fn open(&self, swarm: &str) -> Arc<dyn JournalWriter> {
        Arc::new(StoreWriter {
            store: self.clone(),
            swarm: swarm.to_owned(),
        })
    }
}

/// Persists a new swarm, and the reply to the request that created it if that has an id.
pub struct NewSwarm {
    /// Where it is persisted.
    pub store: Store,
    /// Its name.
    pub name: String,
    /// Its spec.
    pub spec: Spec,
    /// The identity of the request.
    pub identity: Option<RequestIdentity>,
}

impl PersistNew for NewSwarm {
    fn persist(
        self: Box<Self>,
        checkpoint: &Checkpoint,
        stamp: &Stamp,
        frame: &Arc<Frame>,
    ) -> Result<(), WriteFault> {
        let new = *self;
        let metadata = SwarmMetadata {
            spec: jostle_convert::spec::to_proto(&new.spec, new.spec.seed),
        };
        let mut writes = vec![Write::Create {
            swarm: new.name.clone(),
            about: proto::to_cbor(&metadata),
            first: stored_checkpoint(&new.name, checkpoint),
        }];
        if let Some(identity) = new.identity {
            let payload = convert::created(&new.name, stamp, &new.spec, frame, true);
            writes.push(stored_reply(&new.name, identity, payload));
        }
        new.store.commit(writes).map_err(fault)
    }
}

/// The writes to the store for an entry.
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
            let checkpoint = stored_checkpoint(&swarm, &checkpoint);
            vec![Write::Keep { swarm, checkpoint }]
        }
        Entry::End(stamp, sender) => {
            let reply = sender.request_id.clone().zip(sender.digest);
            let reply = reply.map(|(request_id, digest)| {
                let identity = RequestIdentity {
                    client: sender.client.clone(),
                    request_id,
                    digest,
                };
                let payload = convert::outcome(&swarm, &stamp, Outcome::Done, None);
                stored_reply(&swarm, identity, payload)
            });
            let end = Write::Delete { swarm };
            std::iter::once(end).chain(reply).collect()
        }
    }
}

fn stored_reply(swarm: &str, identity: RequestIdentity, payload: Payload) -> Write {
    Write::Answer(store::Answer {
        client: identity.client,
        request_id: identity.request_id,
        digest: identity.digest,
        swarm: swarm.to_owned(),
        number: 0,
        is_ok: true,
        encoding: payload.encoding.to_owned(),
        body: payload.bytes,
    })
}

fn stored_checkpoint(swarm: &str, checkpoint: &Checkpoint) -> store::Checkpoint {
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
