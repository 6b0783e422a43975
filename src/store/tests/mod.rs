//! Tests of the store on real files.

mod audit;
mod damage;
mod failing;
mod retention;
mod writing;

use std::ops::RangeInclusive;
use std::path::Path;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use tempfile::TempDir;

use super::*;

/// Longer than any step of these tests.
const TIMEOUT: Duration = Duration::from_secs(20);

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

const UNLIMITED: Settings = Settings {
    quota_bytes: u64::MAX,
    audit_bytes: u64::MAX,
    audit_ms: u64::MAX,
};

fn open(folder: &Path) -> Store {
    open_with(folder, u64::MAX)
}

/// A store in a new folder, with these writes.
fn stored(writes: Vec<Write>) -> (TempDir, Store) {
    let folder = folder();
    let store = open(folder.path());
    durable(&store, writes).unwrap();
    (folder, store)
}

fn open_with(folder: &Path, quota_bytes: u64) -> Store {
    let settings = Settings {
        quota_bytes,
        ..UNLIMITED
    };
    Store::open(folder, settings, Box::new(|_| {})).unwrap()
}

fn row(number: u64) -> Row {
    let body = format!("row {number} ")
        .repeat(1 + number as usize % 7)
        .into_bytes();
    Row {
        number,
        epoch: 1,
        step: 10 * number,
        kind: (number % 5) as u8,
        body,
    }
}

fn append(swarm: &str, number: u64) -> Write {
    Write::Append {
        swarm: swarm.to_string(),
        row: row(number),
    }
}

/// Rows with these numbers.
fn appends(swarm: &str, numbers: RangeInclusive<u64>) -> Vec<Write> {
    numbers.map(|number| append(swarm, number)).collect()
}

/// A row with a body of so many bytes.
fn append_large(swarm: &str, number: u64, bytes: usize) -> Write {
    let body = vec![number as u8; bytes];
    Write::Append {
        swarm: swarm.to_string(),
        row: Row {
            body,
            ..row(number)
        },
    }
}

fn state(number: u64, bytes: usize) -> Checkpoint {
    let body = (0..bytes)
        .map(|place| (place as u64 * 31 + number) as u8)
        .collect();
    Checkpoint {
        number,
        epoch: 1,
        step: 10 * number,
        body,
    }
}

fn create(swarm: &str) -> Write {
    let about = format!("about {swarm}").into_bytes();
    Write::Create {
        swarm: swarm.to_string(),
        about,
        first: state(0, 300),
    }
}

fn delete(swarm: &str) -> Write {
    Write::Delete {
        swarm: swarm.to_string(),
    }
}

fn save_checkpoint(swarm: &str, number: u64, bytes: usize) -> Write {
    Write::SaveCheckpoint {
        swarm: swarm.to_string(),
        checkpoint: state(number, bytes),
    }
}

fn reply(number: u64) -> StoredReply {
    StoredReply {
        client: number.is_multiple_of(2).then(|| "someone".to_string()),
        request_id: format!("request {number}"),
        digest: [number as u8; 32],
        swarm: "a".to_string(),
        number,
        is_ok: number != 3,
        encoding: "application/json".to_string(),
        body: format!("{{\"seq\":{number}}}").into_bytes(),
    }
}

fn pending(store: &Store, writes: Vec<Write>) -> Receiver<Result<(), StoreFault>> {
    let (sender, receiver) = channel();
    submit_sync(store, writes, move |outcome| sender.send(outcome).unwrap());
    receiver
}

impl<F: FnOnce(Result<(), StoreFault>) + Send> OnCommit for F {
    fn committed(self: Box<Self>, outcome: Result<(), StoreFault>) {
        self(outcome);
    }
}

fn submit_sync(
    store: &Store,
    writes: Vec<Write>,
    done: impl FnOnce(Result<(), StoreFault>) + Send + 'static,
) {
    store.push(writes, Durability::Sync(Box::new(done)));
}

fn durable(store: &Store, writes: Vec<Write>) -> Result<(), StoreFault> {
    pending(store, writes).recv_timeout(TIMEOUT).unwrap()
}

/// The names of the swarms.
fn names(store: &Store) -> Vec<String> {
    let swarms = store.swarms().unwrap().into_iter();
    swarms.map(|(name, _)| name).collect()
}

fn is_rejected(store: &Store, writes: Vec<Write>) -> bool {
    matches!(durable(store, writes), Err(StoreFault::Refused(_)))
}

fn numbers(store: &Store, swarm: &str) -> Vec<u64> {
    let read = store.rows(swarm, 0, usize::MAX).unwrap();
    assert_eq!(read.damaged_at, None);
    read.rows.iter().map(|row| row.number).collect()
}

/// The numbers of the intact checkpoints, newest first.
fn checkpoints(store: &Store, swarm: &str) -> Vec<u64> {
    let infos = store.checkpoints(swarm).unwrap();
    infos.iter().map(|info| info.number).collect()
}

/// Executes SQL on the database of a folder.
fn alter(folder: &Path, sql: &str) {
    let database = Connection::open(folder.join(FILE)).unwrap();
    database.execute_batch(sql).unwrap();
}

/// Stops the store, alters its file, and opens it again.
fn altered(store: &Store, folder: &TempDir, sql: &str) -> Store {
    assert!(store.stop(TIMEOUT));
    alter(folder.path(), sql);
    open(folder.path())
}

fn count(store: &Store, sql: &str) -> i64 {
    let read = |connection: &Connection| Ok(connection.query_row(sql, [], |row| row.get(0))?);
    store.read(read).unwrap()
}

/// Waits until `condition` holds.
fn wait_until(what: &str, mut condition: impl FnMut() -> bool) {
    let until = Instant::now() + TIMEOUT;
    while !condition() {
        assert!(Instant::now() < until, "timeout: {what}");
        thread::sleep(Duration::from_millis(2));
    }
}
