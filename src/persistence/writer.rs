//! Writes the journals, checkpoints and ends of swarms to the store.

use std::sync::Arc;

use jostle_convert::SnapshotError;
use jostle_physics::simulation::Spec;
use jostle_proto as proto;
use jostle_proto::snapshot::Sent;
use serde::{Deserialize, Serialize};

use crate::convert::digest::RequestIdentity;
use crate::convert::{self, Payload, durable};
use crate::store::{self, OnCommit, Store, StoreFault, Write};
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::command::ANNOTATE;
use crate::swarm::error::WriteFault;
use crate::swarm::frame::{Frame, Stamp};
use crate::swarm::handle::Outcome;
use crate::swarm::journal::{Entry, JournalWriter, PendingDurableStep, Record};
use crate::swarm::runner::{JournalFactory, PersistNew};
use crate::swarm::sender::{Creation, Sender};

#[derive(Serialize, Deserialize)]
pub(crate) struct SwarmMetadata {
    pub(crate) spec: proto::Spec,
    /// Unknown for swarms that earlier versions created.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) creation: Option<Creation>,
}

struct StoreWriter {
    store: Store,
    swarm: String,
}

impl JournalWriter for StoreWriter {
    fn commit(&self, entries: Vec<Entry>) -> Result<(), WriteFault> {
        self.store.commit(self.writes(entries)).map_err(fault)
    }

    fn append(&self, entries: Vec<Entry>, pending: Option<PendingDurableStep>) {
        let synced = pending.map(|pending| Box::new(pending) as Box<dyn OnCommit>);
        self.store.submit(self.writes(entries), synced);
    }
}

impl OnCommit for PendingDurableStep {
    fn committed(self: Box<Self>, outcome: Result<(), StoreFault>) {
        if outcome.is_ok() {
            self.mark_durable();
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
        creation: Option<&Creation>,
        checkpoint: &Checkpoint,
        stamp: &Stamp,
        frame: &Arc<Frame>,
    ) -> Result<Option<u64>, WriteFault> {
        let new = *self;
        let metadata = SwarmMetadata {
            spec: jostle_convert::spec::to_proto(&new.spec, new.spec.seed),
            creation: creation.cloned(),
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
        new.store.commit(writes).map_err(fault)?;
        Ok(new.store.swarm_id(&new.name).ok())
    }
}

pub(crate) fn writes(swarm: &str, entry: Entry) -> Vec<Write> {
    let swarm = swarm.to_owned();
    match entry {
        Entry::Line(line) => {
            let (kind, body) = record(&line.record);
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
            vec![Write::SaveCheckpoint { swarm, checkpoint }]
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
    Write::InsertReply(store::StoredReply {
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

#[derive(Serialize, Deserialize)]
#[serde(remote = "Record")]
enum Stored {
    #[serde(rename = "input")]
    Input {
        at_step: Option<u64>,
        #[serde(rename = "sent", with = "stored_sender")]
        sender: Arc<Sender>,
        seq: Option<u64>,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        unix_secs: Option<f64>,
    },
    #[serde(rename = "became")]
    Outcome {
        input: u64,
        seq: Option<u64>,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        unix_secs: Option<f64>,
    },
    #[serde(rename = "fault")]
    Fault(String),
    #[serde(rename = "hash")]
    Hash(#[serde(with = "serde_bytes")] [u8; 32]),
    #[serde(rename = "resumed")]
    Resumed(u64),
}

/// A command is stored as [`Sent`].
mod stored_sender {
    use serde::de::Error as _;
    use serde::{Deserializer, Serializer};

    use super::*;

    pub fn serialize<S: Serializer>(sender: &Arc<Sender>, to: S) -> Result<S::Ok, S::Error> {
        durable::sent(sender).serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Arc<Sender>, D::Error> {
        durable::sender(&Sent::deserialize(from)?).map_err(D::Error::custom)
    }
}

#[derive(Serialize, Deserialize)]
struct StoredRecord(#[serde(with = "Stored")] Record);

pub(super) const INPUT: u8 = 1;
const OUTCOME: u8 = 2;
pub(super) const RESUMED: u8 = 5;

/// The kinds of rows that are commands or their outcomes.
pub const COMMAND_KINDS: [u8; 3] = [INPUT, OUTCOME, store::NOTE];

/// Encodes a journal record: its kind, by which it is found, and its bytes.
pub fn record(record: &Record) -> (u8, Vec<u8>) {
    let kind = match record {
        Record::Input { sender, .. } if sender.verb == ANNOTATE => store::NOTE,
        Record::Input { .. } => INPUT,
        Record::Outcome { .. } => OUTCOME,
        Record::Fault(_) => 3,
        Record::Hash(_) => 4,
        Record::Resumed(_) => RESUMED,
    };
    (kind, proto::to_cbor(&StoredRecord(record.clone())))
}

/// Decodes a journal record.
pub fn read_record(bytes: &[u8]) -> Result<Record, SnapshotError> {
    let stored: Result<StoredRecord, _> = ciborium::from_reader(bytes);
    let stored = stored.map_err(|error| SnapshotError::Unreadable(error.to_string()))?;
    Ok(stored.0)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    /// A record of builds without wall-clock times.
    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    enum UntimedRecord {
        #[serde(rename = "input")]
        Input {
            at_step: Option<u64>,
            sent: Sent,
            seq: Option<u64>,
        },
        #[serde(rename = "became")]
        Outcome { input: u64, seq: Option<u64> },
    }

    /// The metadata of builds that did not store who created a swarm.
    #[derive(Serialize, Deserialize)]
    struct UnsignedMetadata {
        spec: proto::Spec,
    }

    #[test]
    fn older_builds_read_metadata_with_a_creation_and_theirs_is_read_without_one() {
        let spec: proto::Spec = serde_json::from_str(r#"{"n": 3, "seed": 7}"#).unwrap();
        let creation = Some(Creation {
            verb: "fork".to_owned(),
            client: Some("olga:notebook".to_owned()),
            owner: Some("olga".to_owned()),
            step: 9,
            ..Creation::default()
        });
        let metadata = SwarmMetadata { spec, creation };
        let bytes = proto::to_cbor(&metadata);
        let read: SwarmMetadata = ciborium::from_reader(&bytes[..]).unwrap();
        assert_eq!(read.creation, metadata.creation);
        let older: UnsignedMetadata = ciborium::from_reader(&bytes[..]).unwrap();
        assert_eq!(older.spec, metadata.spec);
        let bytes = proto::to_cbor(&older);
        let read: SwarmMetadata = ciborium::from_reader(&bytes[..]).unwrap();
        assert_eq!((read.spec, read.creation), (older.spec, None));
    }

    #[test]
    fn older_builds_read_records_with_a_time_and_theirs_are_read_without_one() {
        let sender = Arc::new(Sender {
            verb: "pause",
            args: "{}".to_owned(),
            ..Sender::default()
        });
        let records = |unix_secs| {
            let input = Record::Input {
                at_step: Some(7),
                sender: sender.clone(),
                seq: None,
                unix_secs,
            };
            let outcome = Record::Outcome {
                input: 3,
                seq: Some(5),
                unix_secs,
            };
            [input, outcome]
        };
        let known = records(Some(1_795_531_201.25));
        for (known, unknown) in known.into_iter().zip(records(None)) {
            let (kind, bytes) = record(&known);
            assert_eq!(read_record(&bytes).unwrap(), known);
            let before: UntimedRecord = ciborium::from_reader(&bytes[..]).unwrap();
            let bytes = proto::to_cbor(&before);
            assert_eq!(read_record(&bytes).unwrap(), unknown);
            // Without a time the bytes are those of before.
            assert_eq!(record(&unknown), (kind, bytes));
        }
    }
}
