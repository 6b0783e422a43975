//! `snapshot`: the complete state of a swarm in a file.

use std::io;
use std::path::Path;

use ciborium::Value;
use jostle_atomic_file as atomic_file;
use jostle_proto::{Reply, Snapshot, to_cbor};
use serde_json::json;

use crate::arguments::SnapshotArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::format;

pub async fn snapshot(context: &Context, arguments: &SnapshotArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    let SnapshotArguments { name, out, force } = arguments;
    if !force && out.exists() {
        return Err(exists(out));
    }
    let reply: Reply<Value> = client.get(name, "snapshot").await?.read()?;
    // Unchanged: a newer daemon may send fields that this version does not know.
    let bytes = to_cbor(&reply.result);
    let snapshot = Snapshot::from_file(&bytes).map_err(Failure::unreadable)?;
    write(out, &bytes, *force).map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => exists(out),
        _ => Failure::file(out.display(), error),
    })?;
    let document = json!({
        "swarm": snapshot.swarm,
        "epoch": snapshot.epoch,
        "step": snapshot.step,
        "seq": snapshot.seq,
        "n": snapshot.id.len(),
        "state_hash": snapshot.state_hash,
        "model_version": snapshot.model_version,
        "file": out.display().to_string(),
        "bytes": bytes.len(),
    });
    let text = format!(
        "wrote {} of {}, {}, to {}\nstate hash {}",
        format::bytes(bytes.len() as u64),
        format::count(snapshot.id.len() as u64, "individual"),
        format::position(&reply),
        out.display(),
        snapshot.state_hash
    );
    output.print(&document, &text)
}

/// The file exists.
pub fn exists(path: &Path) -> Failure {
    Failure::argument(path.display(), "already exists: --force replaces it")
}

/// Writes a file atomically. Without `force` an existing file stays.
pub fn write(path: &Path, bytes: &[u8], force: bool) -> io::Result<()> {
    match force {
        true => atomic_file::write(path, bytes),
        false => atomic_file::write_new(path, bytes),
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::fs;

    use super::*;

    #[test]
    fn a_file_that_is_there_stays_unless_forced_and_no_draft_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("demo.snapshot");
        write(&path, b"one", false).unwrap();
        let error = write(&path, b"two", false).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::AlreadyExists);
        assert_eq!(fs::read(&path).unwrap(), b"one");
        write(&path, b"two", true).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
