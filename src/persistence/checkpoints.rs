//! Reads checkpoints and snapshots.

use jostle_proto as proto;

use crate::convert::durable;
use crate::persistence::journal_reader;
use crate::store::{CheckpointInfo, Store};
use crate::swarm::checkpoint::Checkpoint;

/// Reads the file of a snapshot.
pub fn read_snapshot(file: &[u8]) -> Result<(String, Checkpoint), String> {
    let snapshot = proto::Snapshot::from_file(file)?;
    let checkpoint = parse(&snapshot)?;
    Ok((snapshot.swarm, checkpoint))
}

/// Reads a stored checkpoint, whose checksum the store verifies.
pub(super) fn read_stored(store: &Store, swarm: &str, number: u64) -> Result<Checkpoint, String> {
    let stored = store.checkpoint(swarm, number);
    let body = stored.map_err(|error| error.to_string())?.body;
    parse(&proto::Snapshot::from_cbor(&body)?)
}

/// Reads checkpoints of a swarm in this order; `damaged` gets each that cannot be read, and why.
pub(super) fn readable<'a>(
    store: &'a Store,
    swarm: &'a str,
    stored: Vec<CheckpointInfo>,
    mut damaged: impl FnMut(&CheckpointInfo, String) + 'a,
) -> impl Iterator<Item = Checkpoint> + 'a {
    stored
        .into_iter()
        .filter_map(move |it| match read_stored(store, swarm, it.number) {
            Ok(checkpoint) => Some(checkpoint),
            Err(error) => {
                damaged(&it, error);
                None
            }
        })
}

fn parse(snapshot: &proto::Snapshot) -> Result<Checkpoint, String> {
    durable::checkpoint(snapshot, &journal_reader::parse_command).map_err(|error| error.to_string())
}
