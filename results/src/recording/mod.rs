//! Recordings: what a swarm published, frame by frame, as Parquet or as MCAP.
//!
//! Parquet is for looking at: tidy, a row for each individual and frame, positions absolute. MCAP
//! is for telling it again: it holds the very bytes that were published. Both are written under a
//! name that ends in `.partial` and get their own when they are whole, so a crash leaves whole
//! files and at most one partial one. A frame is taken only if the disk has room for it, and for
//! what ends the file: a full disk ends a recording and damages none.

mod draft;
mod extent;
mod mcap;
mod parquet;
mod reading;
mod timeline;

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde::{Deserialize, Serialize};

use self::draft::Draft;
use self::extent::Extent;
use self::mcap::McapPart;
use self::parquet::ParquetPart;
use self::timeline::Timeline;
use crate::table::TableError;

pub use self::draft::PARTIAL;
pub use self::reading::{Message, bytes_at, read};

/// What a recording says of itself, such as `swarm` and `version`.
pub type About = BTreeMap<String, String>;

/// How long a part of a recording in parts becomes, about.
const PART_BYTES: u64 = 64 * 1024 * 1024;

/// What parts are called before their number.
const PART: &str = "part-";

/// Why a recording cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// A name that does not say how to write the file.
    #[error("record to {}: its name ends in neither .parquet nor .mcap", path.display())]
    UnknownKind {
        /// The file.
        path: PathBuf,
    },
    /// There is something of that name.
    #[error("record to {}: it is there already", path.display())]
    Exists {
        /// The file or folder.
        path: PathBuf,
    },
    /// Another recording of that name goes on, or never ended.
    #[error(
        "record: {} is there: it is being written, or what a crash left of an earlier recording, \
         and then to be removed", partial.display()
    )]
    Unfinished {
        /// The partial file.
        partial: PathBuf,
    },
    /// The disk is full. What was taken is safe, the frame that met this is not.
    #[error("record on to {}: the disk is full; what was recorded before is kept", path.display())]
    Full {
        /// The file.
        path: PathBuf,
    },
    /// The system refused.
    #[error("record to {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The writer of MCAP refused.
    #[error("record to {}: {reason}", path.display())]
    Mcap {
        /// The file.
        path: PathBuf,
        /// What it says.
        reason: String,
    },
    /// What is no recording, or not a whole one.
    #[error("{}: {reason}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The writer of Parquet refused.
    #[error(transparent)]
    Table(#[from] TableError),
}

/// How a recording is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Format {
    /// Columns, for data frames.
    Parquet,
    /// Messages, for players.
    Mcap,
}

/// Where in a swarm's life something belongs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Grows whenever `step` does not continue what was before.
    pub epoch: u64,
    /// The number of what was published, states and events counted apart.
    pub number: u64,
    /// `step · dt`.
    pub time: f64,
    /// When it was taken, by the wall clock.
    pub taken: SystemTime,
}

/// A state to be recorded: columns of one length, ordered by id.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// Where it belongs; its number is that of the published state.
    pub moment: Moment,
    /// The number of steps since the start.
    pub step: u64,
    /// Where `x` and `y` are counted from, in units of 1024 body sizes.
    pub origin: [i64; 2],
    /// Ids.
    pub id: &'a [u32],
    /// Positions relative to the origin.
    pub x: &'a [f64],
    /// Positions relative to the origin.
    pub y: &'a [f64],
    /// Headings in radians.
    pub alpha: &'a [f64],
    /// Weights of the preferred directions.
    pub weight: &'a [f64],
    /// Preferred directions in radians.
    pub direction: &'a [f64],
    /// The polar order parameter.
    pub order: f64,
    /// The smallest gap between two bodies.
    pub worst_gap: Option<f64>,
    /// The residual of the step that led here.
    pub residual: f64,
    /// How many contacts constrained it.
    pub contacts: u64,
    /// The state as it was published, in CBOR.
    pub published: &'a [u8],
}

/// What has been written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// How many frames.
    pub frames: u64,
    /// Whole files.
    pub parts: u64,
    /// Their bytes.
    pub bytes: u64,
}

/// Writes a recording: one file, or the parts of a folder.
pub struct Recorder {
    place: Place,
    format: Format,
    about: About,
    timeline: Timeline,
    part: Option<Part>,
    /// The number of the next part of a folder.
    next: u64,
    /// The frames of whole parts.
    frames_before: u64,
    written: Written,
}

enum Place {
    File { path: PathBuf, replace: bool },
    Folder(PathBuf),
}

enum Part {
    Parquet(Draft, Box<ParquetPart>),
    Mcap(Draft, Box<McapPart>),
}

impl Format {
    /// The format that a file's name tells.
    ///
    /// # Errors
    ///
    /// [`RecordingError::UnknownKind`].
    pub fn of(path: &Path) -> Result<Self, RecordingError> {
        match path.extension().and_then(|extension| extension.to_str()) {
            Some("parquet") => Ok(Format::Parquet),
            Some("mcap") => Ok(Format::Mcap),
            _ => Err(RecordingError::UnknownKind {
                path: path.to_owned(),
            }),
        }
    }

    /// What names of such files end in.
    #[must_use]
    pub fn extension(self) -> &'static str {
        match self {
            Format::Parquet => "parquet",
            Format::Mcap => "mcap",
        }
    }
}

impl Recorder {
    /// Begins a recording in one file, whose name tells the format. What is there already stays,
    /// unless it is to be replaced, and then until the recording is whole.
    ///
    /// # Errors
    ///
    /// [`RecordingError`] with the file; nothing is left behind.
    pub fn to_file(path: &Path, replace: bool, about: About) -> Result<Self, RecordingError> {
        let place = Place::File {
            path: path.to_owned(),
            replace,
        };
        let mut recorder = Recorder::new(place, Format::of(path)?, about);
        recorder.begin_part()?;
        Ok(recorder)
    }

    /// Begins a recording in a new folder, a part after the other.
    ///
    /// # Errors
    ///
    /// [`RecordingError::Exists`], [`RecordingError::Io`].
    pub fn to_folder(folder: &Path, format: Format, about: About) -> Result<Self, RecordingError> {
        fs::create_dir(folder).map_err(|source| match source.kind() {
            io::ErrorKind::AlreadyExists => RecordingError::Exists {
                path: folder.to_owned(),
            },
            _ => io_error(folder, source),
        })?;
        let place = Place::Folder(folder.to_owned());
        Ok(Recorder::new(place, format, about))
    }

    /// Goes on in the folder of a recording that came to no end, with a part of its own. What a
    /// crash left there is to be swept before.
    ///
    /// # Errors
    ///
    /// [`RecordingError`] with the part that cannot be read.
    pub fn go_on(folder: &Path, format: Format, about: About) -> Result<Self, RecordingError> {
        let mut recorder = Recorder::new(Place::Folder(folder.to_owned()), format, about);
        for part in parts(folder)? {
            let Extent {
                frames,
                last,
                bytes,
            } = Extent::of(&part)?;
            recorder.written.frames += frames;
            recorder.written.parts += 1;
            recorder.written.bytes += bytes;
            recorder.timeline.go_on(last);
            recorder.next = recorder.next.max(number_of(&part).map_or(0, |it| it + 1));
        }
        recorder.frames_before = recorder.written.frames;
        Ok(recorder)
    }

    fn new(place: Place, format: Format, about: About) -> Self {
        Recorder {
            place,
            format,
            about,
            timeline: Timeline::default(),
            part: None,
            next: 0,
            frames_before: 0,
            written: Written::default(),
        }
    }

    /// Records a state.
    ///
    /// # Errors
    ///
    /// [`RecordingError::Full`]: it was not taken, and [`Recorder::finish`] will keep the others.
    /// Any other: what was written of this file is lost or, as MCAP, to be recovered.
    ///
    /// # Panics
    ///
    /// If the columns are not of one length.
    pub fn frame(&mut self, frame: &Frame<'_>) -> Result<(), RecordingError> {
        let log_time = self.timeline.at(&frame.moment);
        match self.begin_part()? {
            Part::Parquet(draft, part) => part.frame(draft, frame)?,
            Part::Mcap(draft, part) => {
                part.message(draft, mcap::STATE, &frame.moment, log_time, frame.published)?;
            }
        }
        self.written.frames += 1;
        if matches!(self.place, Place::Folder(_)) && self.bytes_of_part() >= PART_BYTES {
            self.end_part(&About::new())?;
        }
        Ok(())
    }

    /// Records an order as it was published, in JSON; only MCAP holds it.
    ///
    /// # Errors
    ///
    /// As with [`Recorder::frame`].
    pub fn order(&mut self, moment: &Moment, json: &[u8]) -> Result<(), RecordingError> {
        self.message(mcap::ORDER, moment, json)
    }

    /// Records an event as it was published, in JSON; only MCAP holds it.
    ///
    /// # Errors
    ///
    /// As with [`Recorder::frame`].
    pub fn event(&mut self, moment: &Moment, json: &[u8]) -> Result<(), RecordingError> {
        self.message(mcap::EVENT, moment, json)
    }

    fn message(
        &mut self,
        channel: usize,
        moment: &Moment,
        json: &[u8],
    ) -> Result<(), RecordingError> {
        if self.format == Format::Parquet {
            return Ok(());
        }
        let log_time = self.timeline.at(moment);
        match self.begin_part()? {
            Part::Parquet(..) => Ok(()),
            Part::Mcap(draft, part) => part.message(draft, channel, moment, log_time, json),
        }
    }

    /// Ends the part in hand, if there is one: what was recorded so far outlives a crash. The next
    /// frame begins another. `closing` is said in this part, on top of what all say; a part of a
    /// folder says how many frames it has.
    ///
    /// # Errors
    ///
    /// [`RecordingError`] with the file.
    pub fn end_part(&mut self, closing: &About) -> Result<(), RecordingError> {
        let Some(part) = self.part.take() else {
            return Ok(());
        };
        let mut closing = closing.clone();
        if matches!(self.place, Place::Folder(_)) {
            let frames = self.written.frames - self.frames_before;
            closing.insert(extent::FRAMES.to_owned(), frames.to_string());
        }
        let draft = match part {
            Part::Parquet(draft, part) => {
                part.finish(&draft, &closing)?;
                draft
            }
            Part::Mcap(draft, part) => {
                part.finish(&draft, &closing)?;
                draft
            }
        };
        let replace = matches!(self.place, Place::File { replace: true, .. });
        self.written.bytes += draft.publish(replace)?;
        self.written.parts += 1;
        self.next += 1;
        self.frames_before = self.written.frames;
        Ok(())
    }

    /// Ends the recording.
    ///
    /// # Errors
    ///
    /// [`RecordingError`] with the file.
    pub fn finish(mut self, closing: &About) -> Result<Written, RecordingError> {
        self.end_part(closing)?;
        Ok(self.written)
    }

    /// What has been written: frames of the part in hand too, files and bytes of whole parts.
    #[must_use]
    pub fn written(&self) -> Written {
        self.written
    }

    fn bytes_of_part(&self) -> u64 {
        match &self.part {
            Some(Part::Parquet(_, part)) => part.bytes(),
            Some(Part::Mcap(_, part)) => part.bytes(),
            None => 0,
        }
    }

    /// The part in hand; a new one if there is none.
    fn begin_part(&mut self) -> Result<&mut Part, RecordingError> {
        if self.part.is_none() {
            let draft = match &self.place {
                Place::File { path, replace } => Draft::begin(path, *replace, false)?,
                Place::Folder(folder) => {
                    let number = self.next;
                    let name = format!("{PART}{number:05}.{}", self.format.extension());
                    Draft::begin(&folder.join(name), false, true)?
                }
            };
            self.part = Some(match self.format {
                Format::Parquet => {
                    let part = Box::new(ParquetPart::begin(&draft, &self.about)?);
                    Part::Parquet(draft, part)
                }
                Format::Mcap => {
                    let part = Box::new(McapPart::begin(&draft, &self.about)?);
                    Part::Mcap(draft, part)
                }
            });
        }
        Ok(self.part.as_mut().expect("it was just made"))
    }
}

/// The whole parts of a folder, in order.
///
/// # Errors
///
/// [`RecordingError::Io`].
pub fn parts(folder: &Path) -> Result<Vec<PathBuf>, RecordingError> {
    let entries = fs::read_dir(folder).map_err(|source| io_error(folder, source))?;
    let mut parts = Vec::new();
    for entry in entries {
        let path = entry.map_err(|source| io_error(folder, source))?.path();
        let name = path.file_name().and_then(|name| name.to_str());
        if name.is_some_and(|name| name.starts_with(PART)) && Format::of(&path).is_ok() {
            parts.push(path);
        }
    }
    parts.sort_by_key(|part| (number_of(part), part.clone()));
    Ok(parts)
}

/// The number in a part's name.
fn number_of(part: &Path) -> Option<u64> {
    let stem = part.file_stem()?.to_str()?;
    stem.strip_prefix(PART)?.parse().ok()
}

/// Removes what a crash left half-written in a folder, and says what that was.
///
/// # Errors
///
/// [`RecordingError::Io`].
pub fn sweep(folder: &Path) -> Result<Vec<PathBuf>, RecordingError> {
    let entries = fs::read_dir(folder).map_err(|source| io_error(folder, source))?;
    let mut removed = Vec::new();
    for entry in entries {
        let path = entry.map_err(|source| io_error(folder, source))?.path();
        if path
            .extension()
            .is_some_and(|extension| extension == PARTIAL)
        {
            fs::remove_file(&path).map_err(|source| io_error(&path, source))?;
            removed.push(path);
        }
    }
    Ok(removed)
}

fn io_error(path: &Path, source: io::Error) -> RecordingError {
    let path = path.to_owned();
    match source.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => RecordingError::Full { path },
        _ => RecordingError::Io { path, source },
    }
}

#[cfg(test)]
mod tests;
