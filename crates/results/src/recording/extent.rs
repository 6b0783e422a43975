//! The extent of a whole part, read from its footer or summary alone.

use std::fs::File;
use std::io;
use std::io::{Read as _, Seek as _};
use std::path::Path;

use ::parquet::file::reader::FileReader as _;
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader};

use super::error::{self, io_error};
use super::reading::read;
use super::{About, Format, RecordingError, bytes_at, mcap as written};
use crate::table::parquet;

/// The metadata key for the number of frames of a part.
pub const FRAMES: &str = "frames";

/// The length of a footer of MCAP with the magic after it: code, length, two offsets at 9 and 17, and at 25
/// a checksum over the summary and the bytes of the footer before the checksum.
const FOOTER_BYTES: u64 = 37;

/// The extent of a whole part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    /// The number of frames.
    pub frames: u64,
    /// The log time of the last message, in nanoseconds; 0 for Parquet, which stores no log time.
    pub last: u64,
    /// The length of the file.
    pub bytes: u64,
}

impl Extent {
    /// Reads the extent from the end of a part.
    ///
    /// # Errors
    ///
    /// [`RecordingError`] with the part, also if it is cut short.
    pub fn of(part: &Path) -> Result<Self, RecordingError> {
        let file = File::open(part).map_err(|source| io_error(part, source))?;
        let bytes = file.metadata().map_err(|source| io_error(part, source))?;
        let bytes = bytes.len();
        let (frames, last) = match Format::of(part)? {
            Format::Parquet => (frames_of_parquet(part)?, 0),
            Format::Mcap => of_mcap(part, file, bytes)?,
        };
        Ok(Extent {
            frames,
            last,
            bytes,
        })
    }
}

fn frames_of_parquet(part: &Path) -> Result<u64, RecordingError> {
    let about = of_parquet(part)?;
    let frames = about.get(FRAMES).and_then(|it| it.parse().ok());
    frames.ok_or_else(|| unreadable(part, "its metadata have no number of frames"))
}

/// Reads the metadata of a whole file. In MCAP this reads and checks all of it.
///
/// # Errors
///
/// [`RecordingError::Unreadable`], [`RecordingError::Io`], [`RecordingError::UnknownKind`].
pub fn metadata(path: &Path) -> Result<About, RecordingError> {
    match Format::of(path)? {
        Format::Mcap => read(path, |_| Ok(())),
        Format::Parquet => of_parquet(path),
    }
}

fn of_parquet(part: &Path) -> Result<About, RecordingError> {
    let reader = parquet::open(part).map_err(error::unreadable)?;
    let pairs = reader.metadata().file_metadata().key_value_metadata();
    let pairs = pairs.into_iter().flatten();
    let about = pairs.filter_map(|pair| Some((pair.key.clone(), pair.value.clone()?)));
    Ok(about.collect())
}

fn of_mcap(part: &Path, mut file: File, length: u64) -> Result<(u64, u64), RecordingError> {
    check_summary(part, &mut file, length)?;
    file.rewind().map_err(|source| io_error(part, source))?;
    let mut reader = SummaryReader::new();
    while let Some(event) = reader.next_event() {
        match event.map_err(|error| unreadable(part, &error.to_string()))? {
            SummaryReadEvent::ReadRequest(bytes) => {
                let read = file.read(reader.insert(bytes));
                reader.notify_read(read.map_err(|source| io_error(part, source))?);
            }
            SummaryReadEvent::SeekRequest(to) => {
                // The file is shorter than an MCAP ending.
                let at = file.seek(to).map_err(|source| match source.kind() {
                    io::ErrorKind::InvalidInput => unreadable(part, "it is cut short"),
                    _ => io_error(part, source),
                })?;
                reader.notify_seeked(at);
            }
        }
    }
    let statistics = reader.finish().and_then(|summary| {
        let states = summary.channels.values();
        let mut states = states.filter(|it| it.topic == written::CHANNELS[written::STATE].0);
        Some((summary.stats?, states.next().map(|it| it.id)))
    });
    let Some((statistics, channel)) = statistics else {
        return Err(unreadable(part, "it has no summary"));
    };
    let frames = channel.and_then(|id| statistics.channel_message_counts.get(&id));
    Ok((frames.copied().unwrap_or(0), statistics.message_end_time))
}

/// Compares the checksum of the summary, which [`SummaryReader`] does not.
fn check_summary(part: &Path, file: &mut File, length: u64) -> Result<(), RecordingError> {
    let cut = || unreadable(part, "it is cut short");
    let footer = length.checked_sub(FOOTER_BYTES).ok_or_else(cut)?;
    let mut read = |from, to: u64| {
        let bytes = usize::try_from(to - from).map_err(|_| cut())?;
        bytes_at(file, from, bytes).map_err(|source| io_error(part, source))
    };
    let last = read(footer, length)?;
    let start = last[9..]
        .first_chunk()
        .map_or(0, |it| u64::from_le_bytes(*it));
    let stored = last[25..]
        .first_chunk()
        .map_or(0, |it| u32::from_le_bytes(*it));
    let start = if start == 0 { footer } else { start };
    if start > footer {
        return Err(unreadable(
            part,
            "it is damaged: its summary has no beginning",
        ));
    }
    let summary = read(start, footer + 25)?;
    match stored == 0 || stored == crc32fast::hash(&summary) {
        true => Ok(()),
        false => Err(unreadable(part, "it is damaged: a checksum is wrong")),
    }
}

fn unreadable(part: &Path, reason: &str) -> RecordingError {
    RecordingError::Unreadable {
        path: part.to_owned(),
        reason: reason.to_owned(),
    }
}
