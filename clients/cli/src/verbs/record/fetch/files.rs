//! The file of a fetched recording, and the folder with its parts next to it.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use jostle_proto::{Event, OrderSample, State};
use jostle_results::recording::{self, Format, Frame, Message, Moment, Recorder, RecordingError};

use super::super::{explain, frame};
use crate::failure::Failure;

/// Before the recording starts, rejects a file that could not be written at its end.
pub fn check_writable(out: &Path, force: bool) -> Result<(), Failure> {
    Format::of(out).map_err(|error| explain(out, error))?;
    if !force && fs::symlink_metadata(out).is_ok() {
        let path = out.to_owned();
        return Err(explain(out, RecordingError::Exists { path }));
    }
    let partial = with_suffix(out, recording::PARTIAL);
    if fs::symlink_metadata(&partial).is_ok() {
        let path = out.to_owned();
        let error = match recording::is_being_written(&partial) {
            true => RecordingError::BeingWritten { path: partial },
            false => RecordingError::Unfinished { path, partial },
        };
        return Err(explain(out, error));
    }
    // The folder must exist and be writable. A client that was killed here has left its probe.
    let probe = with_suffix(out, "parts");
    let made = match fs::create_dir(&probe) {
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(()),
        made => made,
    };
    let made = made.and_then(|()| fs::remove_dir(&probe));
    made.map_err(|error| Failure::file(out.display(), error))
}

/// The error for a file that does not exist because its recording is still to be fetched from the
/// daemon: its parts are next to it.
pub fn check_fetched(out: &Path) -> Result<(), Failure> {
    if out.exists() {
        return Ok(());
    }
    let Some(recording) = recording_of_parts(out) else {
        return Ok(());
    };
    let argument = out.display().to_string();
    Err(Failure::argument(
        &argument,
        format!(
            "does not exist, but the daemon has the recording: run `jostle record --fetch \
             {recording} -o {argument}`"
        ),
    ))
}

/// The recording whose parts are next to `out`.
fn recording_of_parts(out: &Path) -> Option<String> {
    let start = with_suffix(out, "");
    let start = start.file_name()?.to_str()?;
    let folder = out.parent().filter(|it| !it.as_os_str().is_empty());
    let entries = fs::read_dir(folder.unwrap_or(Path::new("."))).ok()?;
    let mut names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    names.find_map(|name| {
        let of_recording = name.strip_prefix(start)?.strip_suffix(".parts")?;
        let (recording, _) = of_recording.rsplit_once('-')?;
        Some(recording.to_owned())
    })
}

/// The file's name with another extension appended.
pub fn with_suffix(out: &Path, ending: &str) -> PathBuf {
    let mut name = out.file_name().unwrap_or_default().to_owned();
    name.push(".");
    name.push(ending);
    out.with_file_name(name)
}

/// Copies a message of a part. The outer error is one of reading, the inner one of writing.
pub fn copy(
    recorder: &mut Recorder,
    message: &Message<'_>,
) -> Result<Result<(), RecordingError>, String> {
    let taken = SystemTime::UNIX_EPOCH + Duration::from_nanos(message.header.publish_time);
    let at = |epoch, number, time| Moment {
        epoch,
        number,
        time,
        taken,
    };
    let text = |error: serde_json::Error| error.to_string();
    let bytes = message.bytes;
    Ok(match message.topic {
        "state" => {
            let state = State::from_cbor(bytes).map_err(|error| error.to_string())?;
            recorder.frame(&Frame {
                moment: at(state.epoch, state.frame, state.time),
                attachment: message.attachment,
                ..frame(&state, bytes)
            })
        }
        "order" => {
            let order: OrderSample = serde_json::from_slice(bytes).map_err(text)?;
            recorder.order(&at(order.epoch, order.frame, order.time), bytes)
        }
        "event" => {
            let event: Event = serde_json::from_slice(bytes).map_err(text)?;
            recorder.event(&at(event.epoch, event.number, event.time), bytes)
        }
        _ => Ok(()),
    })
}
