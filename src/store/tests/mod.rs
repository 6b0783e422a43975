//! The store against real files.

mod damage;
mod failing;
mod keeping;
mod writing;

use std::path::Path;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use tempfile::TempDir;

use super::*;

/// Longer than anything here takes.
const PATIENCE: Duration = Duration::from_secs(20);

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn open(folder: &Path) -> Store {
    open_with(folder, u64::MAX)
}

fn open_with(folder: &Path, quota_bytes: u64) -> Store {
    Store::open(folder, Settings { quota_bytes }, Box::new(|_| {})).unwrap()
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

fn keep(swarm: &str, number: u64, bytes: usize) -> Write {
    Write::Keep {
        swarm: swarm.to_string(),
        checkpoint: state(number, bytes),
    }
}

fn answer(number: u64) -> Answer {
    Answer {
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
    store.submit(
        writes,
        Some(Box::new(move |outcome| sender.send(outcome).unwrap())),
    );
    receiver
}

fn durable(store: &Store, writes: Vec<Write>) -> Result<(), StoreFault> {
    pending(store, writes).recv_timeout(PATIENCE).unwrap()
}

fn numbers(store: &Store, swarm: &str) -> Vec<u64> {
    let read = store.rows(swarm, 0, usize::MAX).unwrap();
    assert_eq!(read.damaged_at, None);
    read.rows.iter().map(|row| row.number).collect()
}

/// Waits until `is_so`, and fails if it never is.
fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let until = Instant::now() + PATIENCE;
    while !is_so() {
        assert!(Instant::now() < until, "never: {what}");
        thread::sleep(Duration::from_millis(2));
    }
}
