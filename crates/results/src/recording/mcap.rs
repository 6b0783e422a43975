//! MCAP: what was published, byte for byte, with an index by time.

use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;
use std::time::SystemTime;

use mcap::records::{MessageHeader, Metadata};
use mcap::{McapError, WriteOptions, Writer};

use super::temp_file::Draft;
use super::{About, Moment, RecordingError, io_error};

/// The channels, in their order: topics, and how their messages are encoded.
pub const CHANNELS: [(&str, &str); 3] = [("state", "cbor"), ("order", "json"), ("event", "json")];

/// The id that the MCAP writer assigns to the first channel.
pub const FIRST_CHANNEL: u16 = 1;

/// The channel of states, in CBOR as they are published.
pub const STATE: usize = 0;
/// The channel of orders, in JSON as they are published.
pub const ORDER: usize = 1;
/// The channel of events, in JSON as they are published.
pub const EVENT: usize = 2;

/// The metadata records that say what was recorded; what a later one says adds to an earlier.
pub const METADATA: &str = "jostle";

/// What stands around a message at most: its header, its entries in the indexes and, if it fills a
/// chunk of its own, that chunk's.
const AROUND_MESSAGE: u64 = 512;

/// What stands at the beginning and at the end at most, besides what the recording says of itself.
const AROUND_FILE: u64 = 64 * 1024;

/// A file that is being written.
pub struct McapPart {
    path: PathBuf,
    writer: Writer<BufWriter<File>>,
    channels: Vec<u16>,
    /// How long the file is at most, ended now.
    bytes: u64,
    /// The bytes of all messages.
    data_bytes: u64,
    /// Whether the chunk in hand holds a message.
    is_dirty: bool,
    /// The metadata that the last [`McapPart::flush`] wrote.
    flushed_about: About,
}

impl McapPart {
    /// Begins the file with what the recording says of itself, which thus is in a partial file too.
    pub fn begin(draft: &Draft, about: &About) -> Result<Self, RecordingError> {
        let failed = |error| failed(draft, error);
        let mut writer = WriteOptions::new()
            // Doubles of moving bodies hardly compress, and so no reader needs a library for it.
            .compression(None)
            .profile("jostle")
            .library(concat!("jostle-results ", env!("CARGO_PKG_VERSION")))
            .create(BufWriter::new(draft.file()?))
            .map_err(failed)?;
        if !about.is_empty() {
            writer.write_metadata(&metadata(about)).map_err(failed)?;
        }
        // A partial file says what it is from the beginning.
        writer.flush().map_err(failed)?;
        let channels = CHANNELS
            .iter()
            .map(|(topic, encoding)| writer.add_channel(0, topic, encoding, &About::new()))
            .collect::<Result<_, _>>()
            .map_err(failed)?;
        Ok(McapPart {
            path: draft.path.clone(),
            writer,
            channels,
            bytes: AROUND_FILE + 2 * length(about),
            data_bytes: 0,
            is_dirty: false,
            flushed_about: About::new(),
        })
    }

    /// Writes a message if there is room for it.
    pub fn message(
        &mut self,
        draft: &mut Draft,
        channel: usize,
        moment: &Moment,
        log_time: u64,
        data: &[u8],
    ) -> Result<(), RecordingError> {
        let taken = moment.taken.duration_since(SystemTime::UNIX_EPOCH);
        let taken = taken.unwrap_or_default().as_nanos();
        #[expect(clippy::cast_possible_truncation, reason = "MCAP counts in 32 bits")]
        let sequence = moment.number as u32;
        let header = MessageHeader {
            channel_id: self.channels[channel],
            sequence,
            log_time,
            publish_time: u64::try_from(taken).unwrap_or(u64::MAX),
        };
        self.write(draft, &header, data)
    }

    /// Writes a message of another file as it is, if there is room for it.
    pub fn copy(
        &mut self,
        draft: &mut Draft,
        channel: usize,
        header: &MessageHeader,
        data: &[u8],
    ) -> Result<(), RecordingError> {
        let channel_id = self.channels[channel];
        let header = MessageHeader {
            channel_id,
            ..*header
        };
        self.write(draft, &header, data)
    }

    fn write(
        &mut self,
        draft: &mut Draft,
        header: &MessageHeader,
        data: &[u8],
    ) -> Result<(), RecordingError> {
        let bytes = self.bytes + data.len() as u64 + AROUND_MESSAGE;
        draft.reserve(bytes)?;
        self.is_dirty = true;
        self.writer
            .write_to_known_channel(header, data)
            .map_err(|error| failed(draft, error))?;
        self.bytes = bytes;
        self.data_bytes += data.len() as u64;
        Ok(())
    }

    /// Ends the chunk in hand and flushes the file to the operating system, with the metadata
    /// `so_far` if it has changed. Returns whether anything was written.
    pub fn flush(&mut self, draft: &mut Draft, so_far: &About) -> Result<bool, RecordingError> {
        let has_changed = !so_far.is_empty() && self.flushed_about != *so_far;
        if !self.is_dirty && !has_changed {
            return Ok(false);
        }
        if has_changed {
            let bytes = self.bytes + 2 * length(so_far) + AROUND_MESSAGE;
            draft.reserve(bytes)?;
            self.bytes = bytes;
            self.writer
                .write_metadata(&metadata(so_far))
                .map_err(|error| failed(draft, error))?;
            self.flushed_about.clone_from(so_far);
        }
        self.writer.flush().map_err(|error| failed(draft, error))?;
        self.is_dirty = false;
        Ok(true)
    }

    /// Ends the file.
    pub fn finish(mut self, draft: &Draft, closing: &About) -> Result<(), RecordingError> {
        let failed = |error| failed(draft, error);
        if !closing.is_empty() {
            let closing = metadata(closing);
            self.writer.write_metadata(&closing).map_err(failed)?;
        }
        self.writer.finish().map_err(failed)?;
        self.writer
            .into_inner()
            .into_inner()
            .map_err(|error| io_error(&self.path, error.into_error()))?;
        Ok(())
    }

    /// How long the file is at most, ended now.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The bytes of all messages that were taken.
    pub fn data_bytes(&self) -> u64 {
        self.data_bytes
    }
}

fn metadata(about: &About) -> Metadata {
    Metadata {
        name: METADATA.to_owned(),
        metadata: about.clone(),
    }
}

/// The bytes of what a recording says of itself, at most.
pub fn length(about: &About) -> u64 {
    let of = |(key, value): (&String, &String)| (key.len() + value.len() + 64) as u64;
    about.iter().map(of).sum()
}

fn failed(draft: &Draft, error: McapError) -> RecordingError {
    match error {
        McapError::Io(source) => io_error(&draft.path, source),
        error => RecordingError::Mcap {
            path: draft.path.clone(),
            reason: error.to_string(),
        },
    }
}
