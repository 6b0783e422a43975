//! Recovery: makes a whole file of one without an end, whose recorder was killed or had no disk
//! space left.

use std::fs::{self, File};
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use super::error::{self, io_error};
use super::mcap::{ATTACHMENT, CHANNELS, McapPart, STATE};
use super::parquet::ParquetPart;
use super::reading::{self, Message, Unfinished, read_unfinished};
use super::temp_file::{self, PARTIAL, TempFile};
use super::{About, Decode, Format, RecordingError, extent};
use crate::table::parquet;

/// The metadata key that marks a recovered recording.
const RECOVERED: &str = "recovered";

/// The first and the last bytes of every Parquet file.
const PARQUET: [u8; 4] = *b"PAR1";

/// The outcome of a recovery.
#[derive(Clone, Debug, PartialEq)]
pub enum Recovery {
    /// The file is whole already.
    Whole(PathBuf),
    /// A whole file was made.
    Recovered(Recovered),
}

/// A recovered file.
#[derive(Clone, Debug, PartialEq)]
pub struct Recovered {
    /// The file.
    pub path: PathBuf,
    /// The number of states that it holds.
    pub frames: u64,
    /// The step of the first state.
    pub first_step: u64,
    /// The step of the last state.
    pub last_step: u64,
    /// The length of the file.
    pub bytes: u64,
    /// The number of damaged places of the partial file, which are skipped. If it is not 0, the
    /// partial file is kept.
    pub damaged: u64,
    /// The number of bytes at the end of the partial file that hold no whole record.
    pub unread: u64,
}

/// Makes a whole file of a recording that has no end. `path` names either the recording's final
/// file or its partial file. The partial file is removed only after the whole file is on the disk,
/// and not if it is damaged.
///
/// # Errors
///
/// [`RecordingError`]. No file has changed then, unless the error is that the partial file could
/// not be removed.
pub fn recover(path: &Path, replace: bool, decode: Decode) -> Result<Recovery, RecordingError> {
    let is_partial = path.extension().is_some_and(|it| it == PARTIAL);
    let target = if is_partial {
        path.with_extension("")
    } else {
        path.to_owned()
    };
    let format = Format::of(&target)?;
    let partial = temp_file::partial(&target);
    let is_there = |path: &Path| fs::symlink_metadata(path).is_ok();
    let source = if is_partial || is_there(&partial) {
        partial
    } else {
        target.clone()
    };
    let metadata = fs::metadata(&source).map_err(|error| io_error(&source, error))?;
    if !metadata.is_file() {
        return Err(unreadable(&source, "it is no regular file"));
    }
    if source == target {
        if is_whole(&target, format)? {
            return Ok(Recovery::Whole(target));
        }
        if format == Format::Parquet {
            let reason = match begins_with(&target, &PARQUET)? {
                true => "a Parquet file whose end is missing cannot be read",
                false => "it is no Parquet file",
            };
            return Err(unreadable(&target, reason));
        }
    } else if !replace && is_there(&target) {
        return Err(RecordingError::Exists { path: target });
    }
    let locked = temp_file::lock(&source).map_err(|error| io_error(&source, error))?;
    let Some(_lock) = locked else {
        return Err(RecordingError::BeingWritten { path: source });
    };
    if begins_with(&source, &PARQUET)? {
        let reason = "an earlier version recorded it as Parquet without an end: it cannot be read";
        return Err(unreadable(&source, reason));
    }
    let about = About::from([(RECOVERED.to_owned(), true.to_string())]);
    let replace = replace || source == target;
    let recovered = rebuild(&source, &target, format, replace, &about, decode)?;
    // If the source is damaged, keep it: only it contains the damaged bytes.
    if source != target && recovered.damaged == 0 {
        fs::remove_file(&source).map_err(|error| io_error(&source, error))?;
    }
    Ok(Recovery::Recovered(recovered))
}

/// Makes a whole file from the whole chunks of `source`, with `about` added to its metadata.
pub fn rebuild(
    source: &Path,
    target: &Path,
    format: Format,
    replace: bool,
    about: &About,
    decode: Decode,
) -> Result<Recovered, RecordingError> {
    let mut temp_file = TempFile::rebuild(target)?;
    let mut rebuilding = Rebuilding {
        source,
        decode,
        frames: 0,
        steps: None,
    };
    let rebuilt = match format {
        Format::Mcap => rebuilding.mcap(&mut temp_file, about),
        Format::Parquet => rebuilding.parquet(&mut temp_file, about),
    };
    let published = rebuilt.and_then(|read| Ok((temp_file.publish(replace)?, read)));
    let (bytes, read) = match published {
        Ok(published) => published,
        Err(error) => {
            temp_file.discard();
            return Err(error);
        }
    };
    let (first_step, last_step) = rebuilding.steps.unwrap_or_default();
    Ok(Recovered {
        path: target.to_owned(),
        frames: rebuilding.frames,
        first_step,
        last_step,
        bytes,
        damaged: read.damaged,
        unread: read.unread,
    })
}

struct Rebuilding<'a> {
    source: &'a Path,
    decode: Decode,
    frames: u64,
    /// The first and the last step.
    steps: Option<(u64, u64)>,
}

impl Rebuilding<'_> {
    fn mcap(
        &mut self,
        temp_file: &mut TempFile,
        about: &About,
    ) -> Result<Unfinished, RecordingError> {
        let mut part = McapPart::begin(temp_file, &About::new())?;
        let read = read_unfinished(self.source, |message| {
            let mut channels = CHANNELS.iter();
            let Some(channel) = channels.position(|(topic, _)| *topic == message.topic) else {
                return Ok(());
            };
            if channel == STATE {
                self.state(&message, |_| Ok(()))?;
            }
            if let Some(attachment) = message.attachment {
                part.copy(temp_file, ATTACHMENT, &message.header, attachment)?;
            }
            part.copy(temp_file, channel, &message.header, message.bytes)
        })?;
        part.finish(temp_file, &self.closing(&read, about)?)?;
        Ok(read)
    }

    fn parquet(
        &mut self,
        temp_file: &mut TempFile,
        about: &About,
    ) -> Result<Unfinished, RecordingError> {
        let mut part = ParquetPart::begin(temp_file, &About::new())?;
        let read = read_unfinished(self.source, |message| {
            if message.topic != CHANNELS[STATE].0 {
                return Ok(());
            }
            self.state(&message, |frame| part.frame(temp_file, frame))
        })?;
        part.finish(temp_file, &self.closing(&read, about)?)?;
        Ok(read)
    }

    fn state(
        &mut self,
        message: &Message<'_>,
        mut take: impl FnMut(&super::Frame<'_>) -> Result<(), RecordingError>,
    ) -> Result<(), RecordingError> {
        let mut taken = Ok(());
        let attachment = message.attachment;
        let decoded = (self.decode)(message.bytes, &mut |frame| {
            let (first, _) = self.steps.unwrap_or((frame.step, 0));
            self.steps = Some((first, frame.step));
            self.frames += 1;
            taken = take(&super::Frame {
                attachment,
                ..*frame
            });
        });
        decoded.map_err(|reason| {
            let state = self.frames + 1;
            unreadable(self.source, &format!("state {state}: {reason}"))
        })?;
        taken
    }

    /// Returns the metadata of the whole file.
    fn closing(&self, read: &Unfinished, about: &About) -> Result<About, RecordingError> {
        if self.frames == 0 && read.damaged > 0 {
            let reason = format!(
                "it holds no readable state and is damaged in {} places",
                read.damaged
            );
            return Err(unreadable(self.source, &reason));
        }
        if self.frames == 0 && read.cut.is_some() {
            let reason = "it holds no state to recover: it ends before the first whole one";
            return Err(unreadable(self.source, reason));
        }
        if read.about.is_empty() {
            return Err(unreadable(self.source, "jostle did not record it"));
        }
        let mut closing = read.about.clone();
        closing.insert(extent::FRAMES.to_owned(), self.frames.to_string());
        closing.extend(about.clone());
        Ok(closing)
    }
}

/// Returns whether a file under its final name has an end.
fn is_whole(path: &Path, format: Format) -> Result<bool, RecordingError> {
    match format {
        Format::Mcap => {
            let read = read_unfinished(path, |_| Ok(()))?;
            match read.damaged {
                0 => Ok(read.cut.is_none()),
                // Replacing the file would destroy its damaged chunks.
                damaged => Err(unreadable(
                    path,
                    &format!(
                        "{damaged} of its chunks or its index are damaged: rename it to end in \
                         .mcap.partial and recover the others"
                    ),
                )),
            }
        }
        Format::Parquet => {
            let Err(error) = parquet::check(path) else {
                return Ok(true);
            };
            match ends_with(path, &PARQUET)? {
                true => Err(error::unreadable(error)),
                false => Ok(false),
            }
        }
    }
}

/// Returns whether a file is an MCAP file without an end: its recorder was killed or is running.
///
/// # Errors
///
/// The system's error if the file cannot be read.
pub fn is_unfinished(path: &Path) -> io::Result<bool> {
    let mut file = File::open(path)?;
    let mut first = [0; reading::MAGIC.len()];
    match file.read_exact(&mut first) {
        Ok(()) => {}
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(false),
        Err(error) => return Err(error),
    }
    let length = file.metadata()?.len();
    let end = length.saturating_sub(reading::MAGIC.len() as u64);
    let last = super::bytes_at(&mut file, end, reading::MAGIC.len())?;
    Ok(first == reading::MAGIC && last != reading::MAGIC)
}

fn begins_with(path: &Path, magic: &[u8]) -> Result<bool, RecordingError> {
    let read = File::open(path).and_then(|file| {
        let mut first = Vec::new();
        file.take(magic.len() as u64).read_to_end(&mut first)?;
        Ok(first == magic)
    });
    read.map_err(|error| io_error(path, error))
}

fn ends_with(path: &Path, magic: &[u8]) -> Result<bool, RecordingError> {
    let read = File::open(path).and_then(|mut file| {
        let end = file.metadata()?.len().checked_sub(magic.len() as u64);
        let last = end.map(|end| super::bytes_at(&mut file, end, magic.len()));
        Ok(last.transpose()?.is_some_and(|last| last == magic))
    });
    read.map_err(|error| io_error(path, error))
}

fn unreadable(path: &Path, reason: &str) -> RecordingError {
    RecordingError::Unreadable {
        path: path.to_owned(),
        reason: reason.to_owned(),
    }
}
