//! Recordings: the states that a swarm published, frame by frame, as Parquet or as MCAP.
//!
//! Parquet is for analysis: tidy, one row for each individual and frame, absolute positions. MCAP
//! is for playback: it holds the published bytes unchanged. Both are written under a name that ends
//! in `.partial` and are renamed when they are whole, so a crash leaves whole files and at most one
//! partial file. A frame is accepted only if the disk has space for the frame and for the end of
//! the file: a full disk ends a recording and damages none.
//!
//! Parquet cannot be read without its footer. A recording to one file is therefore MCAP until it is
//! finished, even if it is converted to Parquet then, and [`recover`] makes a whole file of the
//! chunks that were flushed before the process was killed. The parts of a folder are written in
//! their final format.

mod error;
pub(crate) mod extent;
mod folder;
mod mcap;
mod parquet;
mod reading;
mod recorder;
mod recovery;
mod temp_file;
mod timeline;

use std::collections::BTreeMap;
use std::path::Path;
use std::time::SystemTime;

use serde::{Deserialize, Serialize};

pub use self::error::RecordingError;
pub use self::extent::{Extent, FRAMES, metadata};
pub use self::folder::{number_of, part_name, parts, sweep};
pub use self::reading::{Message, bytes_at, checksum, read};
pub use self::recorder::Recorder;
pub use self::recovery::{Recovered, Recovery, is_unfinished, recover};
pub use self::temp_file::{PARTIAL, is_being_written, partial};

/// The metadata of a recording, such as `swarm` and `version`.
pub type About = BTreeMap<String, String>;

/// The metadata key for the source of a recording's states.
pub const SOURCE: &str = "source";

/// The source of a recording by the daemon: the states whose step is a multiple of `every`.
pub const FROM_STEPS: &str = "steps";

/// The source of a recording of published states: those that `max_hz` let through and that arrived.
pub const FROM_PUBLISHED: &str = "published";

/// The file format of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Format {
    /// Columns, for data frames.
    Parquet,
    /// Messages, for players.
    #[default]
    Mcap,
}

/// The time at which a state, an order or an event occurred.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Increases whenever `step` does not continue the previous count.
    pub epoch: u64,
    /// The number of the published message; states and events are counted separately.
    pub number: u64,
    /// The simulated time, `step · dt`.
    pub time: f64,
    /// The wall-clock time: of a published state that of its publication, if that is known.
    pub taken: SystemTime,
}

/// A state to record: columns of one length n, ordered by id. Lengths are in body sizes.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// The swarm's name.
    pub swarm: &'a str,
    /// Its time; the number is that of the published state.
    pub moment: Moment,
    /// The swarm's phase, as spelled on the wire.
    pub phase: &'a str,
    /// The number of steps since the start.
    pub step: u64,
    /// The origin of `x` and `y`, in units of 1024 body sizes.
    pub origin: [i64; 2],
    /// Ids.
    pub id: &'a [u32],
    /// Positions along x relative to the origin.
    pub x: &'a [f64],
    /// Positions along y relative to the origin.
    pub y: &'a [f64],
    /// Headings in radians.
    pub alpha: &'a [f64],
    /// Weights of the preferred directions; 0 for the uninformed.
    pub weight: &'a [f64],
    /// Preferred directions in radians; tables omit those of the uninformed.
    pub direction: &'a [f64],
    /// The polar order parameter.
    pub order: f64,
    /// The drift along the informed individuals' common direction; `None` without such a direction.
    pub drift: Option<f64>,
    /// The smallest gap between two bodies.
    pub worst_gap: Option<f64>,
    /// The residual of the step that produced this state.
    pub residual: f64,
    /// The number of contacts that constrained this step.
    pub contacts: u64,
    /// The published state in CBOR.
    pub published: &'a [u8],
    /// The [`Attachment`](jostle_proto::Attachment) of the published state in CBOR, if there is one.
    pub attachment: Option<&'a [u8]>,
}

/// The size of a recording so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// The number of frames.
    pub frames: u64,
    /// The number of whole files.
    pub parts: u64,
    /// The length of the whole files together.
    pub bytes: u64,
}

/// Decodes a published state from CBOR and passes it to the callback as a frame. The error is the
/// reason why the state cannot be decoded.
pub type Decode = fn(&[u8], &mut dyn FnMut(&Frame<'_>)) -> Result<(), String>;

impl Format {
    /// Returns the format of a file from its extension.
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

    /// The extension of files in this format, without a dot.
    #[must_use]
    pub fn extension(self) -> &'static str {
        match self {
            Format::Parquet => "parquet",
            Format::Mcap => "mcap",
        }
    }
}

#[cfg(test)]
mod tests;
