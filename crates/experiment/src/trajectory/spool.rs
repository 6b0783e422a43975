//! The frames of a run that is executed, one after the other: the step, the number of individuals, and
//! their columns, little-endian.

use std::fs::{File, OpenOptions};
use std::io::{self, BufReader, BufWriter, Read, Seek as _, SeekFrom, Write as _};
use std::path::Path;

use jostle_physics::model::{CELL, State};
use jostle_results::table::trajectory::About;
use jostle_results::table::{Trajectory, TrajectoryWriter};

use crate::folder::FolderError;
use crate::folder::error::io_error;
use crate::spool_hash::SpoolHash;

/// The bytes that are written at once.
const BUFFER: usize = 1 << 16;

/// The file of a run's frames, which grows.
pub struct Spool {
    file: BufWriter<File>,
    length: u64,
    hash: SpoolHash,
}

impl Spool {
    /// Opens a spool, or creates it. It has no frames until [`Self::keep`] keeps some.
    pub fn open(path: &Path) -> io::Result<Self> {
        let mut options = OpenOptions::new();
        let options = options.create(true).truncate(false).write(true);
        Ok(Self {
            file: BufWriter::with_capacity(BUFFER, options.open(path)?),
            length: 0,
            hash: SpoolHash::default(),
        })
    }

    /// Keeps the first `length` bytes; returns whether there are so many, with the hash of a checkpoint.
    pub fn keep(&mut self, path: &Path, length: u64, hash: Option<&String>) -> io::Result<bool> {
        match SpoolHash::of(path, length)? {
            Some(read) if read.is(hash) => {
                self.truncate(length)?;
                self.hash = read;
                Ok(true)
            }
            _ => Ok(false),
        }
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        let file = self.file.get_mut();
        file.set_len(length)?;
        file.seek(SeekFrom::Start(length))?;
        self.length = length;
        Ok(())
    }

    /// Appends the frame of a state. That of step 0 replaces all others: the run starts again.
    pub fn add(&mut self, state: &State) -> io::Result<()> {
        if state.step == 0 {
            self.file.flush()?;
            self.truncate(0)?;
            self.hash = SpoolHash::default();
        }
        let bytes = encode(state);
        self.hash.add(&bytes);
        self.length += bytes.len() as u64;
        self.file.write_all(&bytes)
    }

    /// Returns the hash of its frames.
    pub fn hash(&self) -> &SpoolHash {
        &self.hash
    }

    /// Returns the bytes of its frames.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Passes the buffered frames to the system.
    pub fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }

    /// Makes the frames durable and returns the length.
    pub fn sync(&mut self) -> io::Result<u64> {
        self.file.flush()?;
        self.file.get_ref().sync_data()?;
        Ok(self.length)
    }
}

/// Returns the bytes of a frame of `n` individuals.
fn frame_bytes(n: usize) -> u64 {
    24 + 29 * n as u64
}

/// Encodes a frame, with absolute positions.
fn encode(state: &State) -> Vec<u8> {
    let configuration = &state.configuration;
    let n = configuration.n();
    let capacity = usize::try_from(frame_bytes(n)).unwrap_or(0);
    let mut bytes = Vec::with_capacity(capacity);
    bytes.extend(state.step.to_le_bytes());
    bytes.extend(state.time().to_le_bytes());
    bytes.extend((n as u64).to_le_bytes());
    let [x, y] = configuration.origin.map(|origin| CELL * origin as f64);
    configuration
        .id
        .iter()
        .for_each(|id| bytes.extend(id.to_le_bytes()));
    let mut numbers = |column: &[f64], shift: f64| {
        let values = column.iter();
        values.for_each(|value| bytes.extend((value + shift).to_le_bytes()));
    };
    numbers(&configuration.x, x);
    numbers(&configuration.y, y);
    numbers(&configuration.alpha, 0.0);
    let weights = configuration.weight.iter();
    bytes.extend(weights.map(|weight| u8::from(*weight > 0.0)));
    bytes
}

/// Returns the rows of a frame, as a trajectory has them.
pub fn frame(state: &State) -> Trajectory {
    let configuration = &state.configuration;
    let n = configuration.n();
    let [x, y] = configuration.origin.map(|origin| CELL * origin as f64);
    let shifted = |column: &[f64], shift: f64| column.iter().map(|value| value + shift).collect();
    let weights = configuration.weight.iter();
    Trajectory {
        step: vec![state.step; n],
        time: vec![state.time(); n],
        id: configuration.id.clone(),
        x: shifted(&configuration.x, x),
        y: shifted(&configuration.y, y),
        alpha: shifted(&configuration.alpha, 0.0),
        informed: weights.map(|weight| *weight > 0.0).collect(),
    }
}

/// Writes the frames of a spool as a trajectory. Calls `has_room` with the bytes of each frame; if it
/// returns false, there is no trajectory and the result is false.
///
/// # Errors
///
/// [`FolderError`].
pub fn convert(
    spool: &Path,
    target: &Path,
    about: &About,
    mut has_room: impl FnMut(u64) -> bool,
) -> Result<bool, FolderError> {
    let fail = |source| io_error(spool, source);
    let file = File::open(spool).map_err(fail)?;
    let mut reader = BufReader::with_capacity(BUFFER, file);
    let mut writer = TrajectoryWriter::begin(target, about)?;
    while let Some(frame) = decode(&mut reader).map_err(fail)? {
        if !has_room(frame_bytes(frame.len())) {
            return Ok(false);
        }
        writer.append(&frame)?;
    }
    writer.finish()?;
    Ok(true)
}

/// Reads a frame; none at the end.
fn decode(reader: &mut BufReader<File>) -> io::Result<Option<Trajectory>> {
    use std::io::BufRead as _;
    if reader.fill_buf()?.is_empty() {
        return Ok(None);
    }
    let step = u64::from_le_bytes(array(reader)?);
    let time = f64::from_le_bytes(array(reader)?);
    let n = u64::from_le_bytes(array(reader)?);
    let n = usize::try_from(n).map_err(io::Error::other)?;
    let ids = (0..n).map(|_| array(reader).map(u32::from_le_bytes));
    let id = ids.collect::<io::Result<_>>()?;
    let mut numbers = || -> io::Result<Vec<f64>> {
        let values = (0..n).map(|_| array(reader).map(f64::from_le_bytes));
        values.collect()
    };
    let (x, y, alpha) = (numbers()?, numbers()?, numbers()?);
    let flags = (0..n).map(|_| array(reader).map(|[flag]: [u8; 1]| flag != 0));
    Ok(Some(Trajectory {
        step: vec![step; n],
        time: vec![time; n],
        id,
        x,
        y,
        alpha,
        informed: flags.collect::<io::Result<_>>()?,
    }))
}

fn array<const N: usize>(reader: &mut impl Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    reader.read_exact(&mut bytes)?;
    Ok(bytes)
}
