//! Reads checkpoints and snapshots.

use jostle_proto as proto;

use crate::convert::durable;
use crate::persistence::journal_reader;
use crate::swarm::checkpoint::Checkpoint;

/// Reads the file of a snapshot.
pub fn read_snapshot(file: &[u8]) -> Result<Checkpoint, String> {
    let snapshot = proto::Snapshot::from_file(file)?;
    durable::checkpoint(&snapshot, &journal_reader::parse_command)
        .map_err(|error| error.to_string())
}

/// Reads a stored checkpoint, whose checksum the store has verified.
pub(super) fn read_checkpoint(body: &[u8]) -> Result<Checkpoint, String> {
    let snapshot = proto::Snapshot::from_cbor(body)?;
    durable::checkpoint(&snapshot, &journal_reader::parse_command)
        .map_err(|error| error.to_string())
}
