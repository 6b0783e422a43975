//! The writer of recordings.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use super::error::io_error;
use super::extent::{self, Extent};
use super::folder::{number_of, part_name, parts};
use super::mcap::{self, McapPart};
use super::parquet::ParquetPart;
use super::temp_file::TempFile;
use super::timeline::Timeline;
use super::{About, Decode, Format, Frame, Moment, RecordingError, Written, recovery};

/// A part of a folder is full once it has this length.
const PART_BYTES: u64 = 64 * 1024 * 1024;

/// Writes a recording: one file, or the parts of a folder.
pub struct Recorder {
    destination: Destination,
    /// The format of the part being written; a single file is converted when it is finished.
    format: Format,
    about: About,
    timeline: Timeline,
    /// The part being written.
    pub(super) part: Option<Part>,
    /// The number of the next part of a folder.
    next: u64,
    /// The number of frames in whole parts.
    frames_before: u64,
    written: Written,
}

/// The destination of a recording.
enum Destination {
    File {
        path: PathBuf,
        replace: bool,
        decode: Decode,
    },
    Folder(PathBuf),
}

/// A part being written.
pub(super) enum Part {
    Parquet(TempFile, Box<ParquetPart>),
    Mcap(TempFile, Box<McapPart>),
}

impl Recorder {
    /// Begins a recording in one file, whose extension determines the format. An existing file is
    /// an error unless `replace` is set; then it is replaced when the recording is whole. Frames
    /// recorded before a [`Recorder::flush`] can be recovered after this process was killed.
    /// `decode` reads frames back for the conversion to Parquet.
    ///
    /// # Errors
    ///
    /// [`RecordingError`] with the file; if its name is invalid or taken, no file is created.
    pub fn to_file(
        path: &Path,
        replace: bool,
        about: About,
        decode: Decode,
    ) -> Result<Self, RecordingError> {
        Format::of(path)?;
        let destination = Destination::File {
            path: path.to_owned(),
            replace,
            decode,
        };
        let mut recorder = Recorder::new(destination, Format::Mcap, about);
        recorder.begin_part()?;
        Ok(recorder)
    }

    /// Begins a recording in a new folder, as consecutive parts.
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
        let destination = Destination::Folder(folder.to_owned());
        Ok(Recorder::new(destination, format, about))
    }

    /// Resumes an unfinished recording in its folder with a new part. The caller calls
    /// [`sweep`](super::sweep) first to remove the partial files of a crash.
    ///
    /// # Errors
    ///
    /// [`RecordingError`] with the part that cannot be read.
    pub fn resume(folder: &Path, format: Format, about: About) -> Result<Self, RecordingError> {
        let mut recorder = Recorder::new(Destination::Folder(folder.to_owned()), format, about);
        for part in parts(folder)? {
            let Extent {
                frames,
                last,
                bytes,
            } = Extent::of(&part)?;
            recorder.written.frames += frames;
            recorder.written.parts += 1;
            recorder.written.bytes += bytes;
            recorder.timeline.resume(last);
            recorder.next = recorder.next.max(number_of(&part).map_or(0, |it| it + 1));
        }
        recorder.frames_before = recorder.written.frames;
        Ok(recorder)
    }

    fn new(destination: Destination, format: Format, about: About) -> Self {
        Recorder {
            destination,
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
    /// [`RecordingError::Full`]: the frame was not recorded; [`Recorder::finish`] keeps the others.
    /// Any other error: the part being written is lost or, if it is MCAP, can be recovered.
    ///
    /// # Panics
    ///
    /// If the columns of a frame that is written as Parquet differ in length.
    pub fn frame(&mut self, frame: &Frame<'_>) -> Result<(), RecordingError> {
        let log_time = self.timeline.at(&frame.moment);
        match self.begin_part()? {
            Part::Parquet(temp_file, part) => part.frame(temp_file, frame)?,
            Part::Mcap(temp_file, part) => {
                let attached = frame.attachment.map(|bytes| (mcap::ATTACHMENT, bytes));
                let messages = attached.into_iter().chain([(mcap::STATE, frame.published)]);
                for (channel, bytes) in messages {
                    part.message(temp_file, channel, &frame.moment, log_time, bytes)?;
                }
            }
        }
        self.written.frames += 1;
        Ok(())
    }

    /// Whether the current part is so long that the caller should end it, if it is one of a folder.
    #[must_use]
    pub fn is_part_full(&self) -> bool {
        self.bytes_of_part() >= PART_BYTES
    }

    /// Flushes all recorded frames to the operating system, with the metadata `so_far`, so that
    /// they survive a kill of this process. Returns the file if anything was written; the caller
    /// may sync it, so that they survive a power failure too. Parquet parts cannot be flushed.
    ///
    /// # Errors
    ///
    /// As with [`Recorder::frame`].
    pub fn flush(&mut self, so_far: &About) -> Result<Option<File>, RecordingError> {
        match &mut self.part {
            Some(Part::Mcap(temp_file, part)) => match part.flush(temp_file, so_far)? {
                true => temp_file.file().map(Some),
                false => Ok(None),
            },
            Some(Part::Parquet(..)) | None => Ok(None),
        }
    }

    /// Records an order, the published JSON. Parquet parts omit it.
    ///
    /// # Errors
    ///
    /// As with [`Recorder::frame`].
    pub fn order(&mut self, moment: &Moment, json: &[u8]) -> Result<(), RecordingError> {
        self.message(mcap::ORDER, moment, json)
    }

    /// Records an event, the published JSON. Parquet parts omit it.
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
            Part::Mcap(temp_file, part) => part.message(temp_file, channel, moment, log_time, json),
        }
    }

    /// Ends the current part, if any: the frames recorded so far then survive a crash. The next
    /// frame begins another part. `closing` is added to the metadata of this part; a part of a
    /// folder also gets its number of frames.
    ///
    /// # Errors
    ///
    /// [`RecordingError`] with the file.
    pub fn end_part(&mut self, closing: &About) -> Result<(), RecordingError> {
        let Some(part) = self.part.take() else {
            return Ok(());
        };
        let mut closing = closing.clone();
        if matches!(self.destination, Destination::Folder(_)) {
            let frames = self.written.frames - self.frames_before;
            closing.insert(extent::FRAMES.to_owned(), frames.to_string());
        }
        let temp_file = match part {
            Part::Parquet(temp_file, part) => {
                part.finish(&temp_file, &closing)?;
                temp_file
            }
            Part::Mcap(temp_file, part) => {
                part.finish(&temp_file, &closing)?;
                temp_file
            }
        };
        self.written.bytes += match &self.destination {
            Destination::File {
                path,
                replace,
                decode,
            } => publish(&temp_file, path, *replace, *decode)?,
            Destination::Folder(_) => temp_file.publish(false)?,
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

    /// Returns the frames written so far, including the current part, and the files and bytes of
    /// whole parts.
    #[must_use]
    pub fn written(&self) -> Written {
        self.written
    }

    /// Returns how many numbers below that of the next part no whole part has: those of parts that were
    /// missing when the recording was resumed.
    #[must_use]
    pub fn skipped(&self) -> u64 {
        self.next - self.written.parts
    }

    /// As [`Recorder::written`], plus a lower bound for the bytes of the current part.
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

    /// An upper bound for the bytes of all files if the current part ended now.
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

    /// Returns the current part, or begins one.
    fn begin_part(&mut self) -> Result<&mut Part, RecordingError> {
        if self.part.is_none() {
            let temp_file = match &self.destination {
                Destination::File { path, replace, .. } => {
                    let temp_file = TempFile::begin(path, *replace, false)?;
                    match Format::of(path)? {
                        Format::Mcap => temp_file,
                        Format::Parquet => temp_file.reserving_twice(),
                    }
                }
                Destination::Folder(folder) => {
                    let name = part_name(self.next, self.format);
                    TempFile::begin(&folder.join(name), false, true)?
                }
            };
            self.part = Some(match self.format {
                Format::Parquet => {
                    let part = Box::new(ParquetPart::begin(&temp_file, &self.about)?);
                    Part::Parquet(temp_file, part)
                }
                Format::Mcap => {
                    let part = Box::new(McapPart::begin(&temp_file, &self.about)?);
                    Part::Mcap(temp_file, part)
                }
            });
        }
        Ok(self.part.as_mut().expect("a part was begun above"))
    }
}

/// Publishes a finished file under its name, converted to Parquet if the name requires it. Returns
/// its length in bytes.
fn publish(
    temp_file: &TempFile,
    path: &Path,
    replace: bool,
    decode: Decode,
) -> Result<u64, RecordingError> {
    let partial = temp_file.partial();
    let published = match Format::of(path)? {
        Format::Mcap => return temp_file.publish(replace),
        Format::Parquet => temp_file.sync().and_then(|_| {
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
