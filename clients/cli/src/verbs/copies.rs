//! `fork`, `snapshot` and `restore`: swarms made as others were.

use std::fs;
use std::io;
use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use ciborium::Value;
use jostle_atomic_file as atomic_file;
use jostle_proto::verbs::{CreateResult, ForkArgs, RestoreArgs};
use jostle_proto::{Reply, Snapshot, to_cbor};
use serde_json::json;

use crate::arguments::{ForkArguments, RestoreArguments, SendingArguments, SnapshotArguments};
use crate::bus::Bus;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::verbs::{place, print};

/// Makes another swarm as one is or was.
///
/// # Errors
///
/// Why it was not made, or that it is not done yet.
pub async fn fork(bus: &Bus, output: Output, arguments: &ForkArguments) -> Result<(), Failure> {
    let args = ForkArgs {
        name: arguments.copy.clone(),
        step: arguments.at_step,
    };
    let sending = SendingArguments {
        sender: arguments.sender.clone(),
        ..SendingArguments::default()
    };
    let answer = bus
        .command(&arguments.name, "fork", &args, &sending)
        .await?;
    print(output, &answer, |reply: &Reply<CreateResult>| {
        made("forked", &format!(" from {}", arguments.name), reply)
    })
}

/// Writes a swarm to a file.
///
/// # Errors
///
/// Why there is no such file now; one that was there before is as it was.
pub async fn snapshot(
    bus: &Bus,
    output: Output,
    arguments: &SnapshotArguments,
) -> Result<(), Failure> {
    let SnapshotArguments { name, out, force } = arguments;
    if !force && out.exists() {
        return Err(is_there(out));
    }
    let reply: Reply<Value> = bus.get(name, "snapshot").await?.read()?;
    // As it came: a newer daemon may have told more than is known here.
    let bytes = to_cbor(&reply.result);
    let snapshot = Snapshot::from_file(&bytes).map_err(Failure::unreadable)?;
    put(out, &bytes, *force).map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => is_there(out),
        _ => Failure::File {
            path: out.display().to_string(),
            error,
        },
    })?;
    if output.json {
        return output.data(
            &json!({
                "swarm": snapshot.swarm,
                "epoch": snapshot.epoch,
                "step": snapshot.step,
                "seq": snapshot.seq,
                "n": snapshot.id.len(),
                "state_hash": snapshot.state_hash,
                "model_version": snapshot.model_version,
                "file": out.display().to_string(),
                "bytes": bytes.len(),
            })
            .to_string(),
        );
    }
    output.data(&format!(
        "wrote {} of {}, {}, to {}\nstate hash {}",
        format::bytes(bytes.len() as u64),
        format::count(snapshot.id.len() as u64, "individual"),
        place(&reply),
        out.display(),
        snapshot.state_hash
    ))
}

/// Makes a swarm from a file.
///
/// # Errors
///
/// Why it was not made.
pub async fn restore(
    bus: &Bus,
    output: Output,
    arguments: &RestoreArguments,
) -> Result<(), Failure> {
    let RestoreArguments { file, name, sender } = arguments;
    let wrong = |problem: String| Failure::Argument {
        argument: file.display().to_string(),
        problem,
    };
    let bytes = fs::read(file).map_err(|error| wrong(error.to_string()))?;
    let snapshot = Snapshot::from_file(&bytes).map_err(|error| {
        wrong(format!(
            "not a snapshot, or not all of one ({error}): `jostle snapshot` writes one"
        ))
    })?;
    let args = RestoreArgs {
        name: name.clone().unwrap_or(snapshot.swarm),
        snapshot: STANDARD.encode(&bytes),
    };
    let answer = bus.command_node("restore", &args, sender).await?;
    print(output, &answer, |reply: &Reply<CreateResult>| {
        made("restored", "", reply)
    })
}

/// What people are told of a copy.
fn made(verb: &str, from: &str, reply: &Reply<CreateResult>) -> String {
    format!(
        "{verb} {}{from}, {}\nstate hash {}",
        reply.swarm,
        place(reply),
        reply.result.state_hash
    )
}

fn is_there(path: &Path) -> Failure {
    Failure::Argument {
        argument: path.display().to_string(),
        problem: "is there already: --force replaces it".into(),
    }
}

/// Writes a whole file, or none. Without `force` a file that exists stays.
fn put(path: &Path, bytes: &[u8], force: bool) -> io::Result<()> {
    match force {
        true => atomic_file::write(path, bytes),
        false => atomic_file::write_new(path, bytes),
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn a_file_that_is_there_stays_unless_forced_and_no_draft_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("demo.snapshot");
        put(&path, b"one", false).unwrap();
        let error = put(&path, b"two", false).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::AlreadyExists);
        assert_eq!(fs::read(&path).unwrap(), b"one");
        put(&path, b"two", true).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
