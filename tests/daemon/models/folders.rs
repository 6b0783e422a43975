//! Data folders and snapshots as an earlier version of the model would have written them.
//!
//! No earlier version can be executed here. A folder of this daemon is written again by the store as one
//! of version 1 would have written it: with that version in each checkpoint and its hashes of the same
//! states, and with other hashes in the journal, as of other steps.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use ciborium::Value as Cbor;
use jostle_convert::snapshot;
use jostle_physics::model::MODEL_VERSION;
use jostle_proto::{Snapshot, to_cbor};
use jostled::persistence::writer;
use jostled::store::{Checkpoint, Row, Settings, Store, Write};
use jostled::swarm::journal::Record;
use rusqlite::Connection;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::support::daemon_process::{self, DaemonProcess, copy_all};
use crate::support::{Client, TIMEOUT};

/// The version that is said to have written a folder.
pub const EARLIER: u32 = 1;

/// A copy of the folder of a daemon that does not run, as the earlier version would have written it, with
/// schema 3. `alter` changes what the lines of the journals record.
pub fn aged(folder: &Path, alter: fn(Record) -> Record) -> TempDir {
    let copy = tempfile::tempdir().unwrap();
    copy_all(folder, copy.path());
    for name in ["jostle.sqlite-shm", "lock", "log"] {
        let _ = fs::remove_file(copy.path().join(name));
    }
    let store = Store::open(copy.path(), Settings::default(), Box::new(|_| {})).unwrap();
    for (swarm, about) in store.swarms().unwrap() {
        let marks = store.checkpoints(&swarm).unwrap().into_iter();
        let read = |number| of_earlier_model(&store.checkpoint(&swarm, number).unwrap());
        let mut checkpoints: BTreeMap<u64, Checkpoint> =
            marks.map(|mark| (mark.number, read(mark.number))).collect();
        let (_, first) = checkpoints.pop_first().unwrap();
        let rows = store.rows(&swarm, first.number, usize::MAX >> 1).unwrap();
        assert_eq!(rows.damaged_at, None);
        let delete = Write::Delete {
            swarm: swarm.clone(),
        };
        let create = Write::Create {
            swarm: swarm.clone(),
            about,
            first,
        };
        let mut writes = vec![delete, create];
        for row in rows.rows {
            let checkpoint = checkpoints.remove(&row.number);
            writes.push(Write::Append {
                swarm: swarm.clone(),
                row: altered(row, alter),
            });
            writes.extend(checkpoint.map(|checkpoint| Write::SaveCheckpoint {
                swarm: swarm.clone(),
                checkpoint,
            }));
        }
        store.commit(writes).unwrap();
    }
    assert!(store.stop(TIMEOUT));
    let database = Connection::open(copy.path().join("jostle.sqlite")).unwrap();
    let schema = "DROP TABLE program; PRAGMA user_version = 3";
    database.execute_batch(schema).unwrap();
    for folder in fs::read_dir(copy.path().join("experiments"))
        .into_iter()
        .flatten()
    {
        age_experiment(&folder.unwrap().path());
    }
    copy
}

/// Writes the version into the list of finished runs and the checkpoints of the others.
pub fn age_experiment(folder: &Path) {
    let list = folder.join("runs.jsonl");
    if let Ok(text) = fs::read_to_string(&list) {
        let (header, lines) = text.split_once('\n').unwrap();
        let mut header: Value = serde_json::from_str(header).unwrap();
        assert_eq!(header["model_version"], MODEL_VERSION);
        header["model_version"] = json!(EARLIER);
        fs::write(&list, format!("{header}\n{lines}")).unwrap();
    }
    for path in fs::read_dir(folder.join("checkpoints"))
        .into_iter()
        .flatten()
    {
        let path = path.unwrap().path();
        let mut checkpoint: Cbor = ciborium::from_reader(&*fs::read(&path).unwrap()).unwrap();
        let fields = checkpoint.as_map_mut().unwrap();
        let (_, taken) = fields
            .iter_mut()
            .find(|(name, _)| name.as_text() == Some("snapshot"))
            .unwrap();
        let stored = earlier(Snapshot::from_cbor(&to_cbor(taken)).unwrap());
        *taken = ciborium::from_reader(&*to_cbor(&stored)).unwrap();
        fs::write(&path, to_cbor(&checkpoint)).unwrap();
    }
}

fn of_earlier_model(checkpoint: &Checkpoint) -> Checkpoint {
    let stored = earlier(Snapshot::from_cbor(&checkpoint.body).unwrap());
    Checkpoint {
        body: to_cbor(&stored),
        ..checkpoint.clone()
    }
}

/// A snapshot as the earlier version would have written it.
pub fn earlier(mut snapshot: Snapshot) -> Snapshot {
    assert_eq!(snapshot.model_version, MODEL_VERSION);
    let (_, state) = snapshot::state(&snapshot).unwrap();
    snapshot.model_version = EARLIER;
    snapshot.state_hash = snapshot::hexadecimal(&state.hash_under(EARLIER));
    snapshot
}

fn altered(mut row: Row, alter: fn(Record) -> Record) -> Row {
    let record = match writer::read_record(&row.body).unwrap() {
        Record::Hash(_) => Record::Hash([7; 32]),
        record => alter(record),
    };
    row.body = writer::record(&record).1;
    row
}

/// Starts a daemon, lets `fill` send it commands, and kills it.
pub async fn killed(fill: impl AsyncFnOnce(&Client)) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut process = DaemonProcess::start(&mut daemon_process::daemon(folder.path())).unwrap();
    let client = Client::open(&process.endpoint).await;
    fill(&client).await;
    process.kill();
    folder
}
