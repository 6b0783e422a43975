//! Recordings: what a swarm published, frame by frame, as Parquet or as MCAP.
//!
//! Parquet is for looking at: tidy, a row for each individual and frame, positions absolute. MCAP
//! is for telling it again: it holds the very bytes that were published. Both are written under a
//! name that ends in `.partial` and get their own when they are whole, so a crash leaves whole
//! files and at most one partial one. A frame is taken only if the disk has room for it, and for
//! what ends the file: a full disk ends a recording and damages none.
//!
//! Parquet cannot be read without its end. A recording to one file is therefore MCAP until it is
//! finished, also if it becomes Parquet, and [`recover`] makes a whole file of what was flushed
//! before the process was killed. The parts of a folder are written as they are to be.

mod extent;
mod mcap;
mod parquet;
mod reading;
mod recovery;
mod temp_file;
mod timeline;

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde::{Deserialize, Serialize};

use self::extent::Extent;
use self::mcap::McapPart;
use self::parquet::ParquetPart;
use self::temp_file::Draft;
use self::timeline::Timeline;
use crate::table::TableError;

pub use self::reading::{Message, bytes_at, read};
pub use self::recovery::{Recovered, Recovery, is_unfinished, recover};
pub use self::temp_file::{PARTIAL, is_being_written, partial};

/// What a recording says of itself, such as `swarm` and `version`.
pub type About = BTreeMap<String, String>;

/// By what name a recording says where its states come from.
pub const SOURCE: &str = "source";

/// The source of a recording that the daemon made: every step that is a multiple of `every`.
pub const FROM_STEPS: &str = "steps";

/// The source of a recording of what was published: as many states as `max_hz` left, and as many of
/// them as arrived.
pub const FROM_PUBLISHED: &str = "published";

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
    /// A recording of that name was killed.
    #[error(
        "record to {}: {} is there, left by a recording that was killed: \
         `jostle record --recover {}` makes a whole file of it",
        path.display(), partial.display(), path.display()
    )]
    Unfinished {
        /// The file.
        path: PathBuf,
        /// The partial file.
        partial: PathBuf,
    },
    /// A process writes the file.
    #[error("{}: a recording that goes on writes this file", path.display())]
    BeingWritten {
        /// The partial file.
        path: PathBuf,
    },
    /// All was recorded, but the file that was asked for could not be made of it.
    #[error(
        "{source}; {} holds the whole recording: fix the cause, then `jostle record --recover {}` \
         creates the file", partial.display(), path.display()
    )]
    Unconverted {
        /// The file.
        path: PathBuf,
        /// The partial file.
        partial: PathBuf,
        /// Why.
        source: Box<RecordingError>,
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
    /// The swarm's name.
    pub swarm: &'a str,
    /// Where it belongs; its number is that of the published state.
    pub moment: Moment,
    /// What the swarm does, in the wire's word.
    pub phase: &'a str,
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
    /// Weights of the preferred directions; 0 for the uninformed.
    pub weight: &'a [f64],
    /// Preferred directions in radians; tables have none for the uninformed.
    pub direction: &'a [f64],
    /// The polar order parameter.
    pub order: f64,
    /// The drift along the informed individuals' common direction, if there is one.
    pub drift: Option<f64>,
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

/// Reads a published state, CBOR, and passes it to the callback as a frame. Fails with the reason if
/// it cannot be read.
pub type Decode = fn(&[u8], &mut dyn FnMut(&Frame<'_>)) -> Result<(), String>;

/// Writes a recording: one file, or the parts of a folder.
pub struct Recorder {
    place: Place,
    /// How it is written; a file becomes what its name says when it is finished.
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
    File {
        path: PathBuf,
        replace: bool,
        decode: Decode,
    },
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
    /// unless it is to be replaced, and then until the recording is whole. What was recorded before
    /// a [`Recorder::flush`] can be recovered after this process was killed; `decode` reads it back.
    ///
    /// # Errors
    ///
    /// [`RecordingError`] with the file; nothing is left behind.
    pub fn to_file(
        path: &Path,
        replace: bool,
        about: About,
        decode: Decode,
    ) -> Result<Self, RecordingError> {
        Format::of(path)?;
        let place = Place::File {
            path: path.to_owned(),
            replace,
            decode,
        };
        let mut recorder = Recorder::new(place, Format::Mcap, about);
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

    /// Flushes all that was recorded to the operating system, with the metadata `so_far`: a kill of
    /// this process does not lose it. Returns the file if anything was written; the caller may sync
    /// it so that a power failure does not lose it either. Parquet parts cannot be flushed.
    ///
    /// # Errors
    ///
    /// As with [`Recorder::frame`].
    pub fn flush(&mut self, so_far: &About) -> Result<Option<File>, RecordingError> {
        match &mut self.part {
            Some(Part::Mcap(draft, part)) => match part.flush(draft, so_far)? {
                true => draft.file().map(Some),
                false => Ok(None),
            },
            Some(Part::Parquet(..)) | None => Ok(None),
        }
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
        self.written.bytes += match &self.place {
            Place::File {
                path,
                replace,
                decode,
            } => publish(&draft, path, *replace, *decode)?,
            Place::Folder(_) => draft.publish(false)?,
        };
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

    /// What has been written, with a lower bound for the bytes of the part in hand.
    #[must_use]
    pub fn progress(&self) -> Written {
        let of_part = match &self.part {
            Some(Part::Parquet(_, part)) => part.data_bytes(),
            Some(Part::Mcap(_, part)) => part.data_bytes(),
            None => 0,
        };
        let bytes = self.written.bytes + of_part;
        Written {
            bytes,
            ..self.written
        }
    }

    /// The bytes of all files, with what the part in hand would have at most if it ended now.
    #[must_use]
    pub fn size(&self) -> u64 {
        self.written.bytes + self.bytes_of_part()
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
                Place::File { path, replace, .. } => {
                    let draft = Draft::begin(path, *replace, false)?;
                    match Format::of(path)? {
                        Format::Mcap => draft,
                        Format::Parquet => draft.doubled(),
                    }
                }
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

/// Gives a finished file its name, as Parquet if that says so; returns its bytes.
fn publish(
    draft: &Draft,
    path: &Path,
    replace: bool,
    decode: Decode,
) -> Result<u64, RecordingError> {
    let partial = draft.partial();
    let published = match Format::of(path)? {
        Format::Mcap => return draft.publish(replace),
        Format::Parquet => draft.sync().and_then(|_| {
            recovery::rebuild(
                partial,
                path,
                Format::Parquet,
                replace,
                &About::new(),
                decode,
            )
        }),
    };
    let recovered = published.map_err(|source| RecordingError::Unconverted {
        path: path.to_owned(),
        partial: partial.to_owned(),
        source: Box::new(source),
    })?;
    fs::remove_file(partial).map_err(|source| io_error(partial, source))?;
    Ok(recovered.bytes)
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
