//! The MCAP writer: the published bytes unchanged, with an index by time.

use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;
use std::time::SystemTime;

use mcap::records::{MessageHeader, Metadata};
use mcap::{McapError, WriteOptions, Writer};

use super::error::io_error;
use super::temp_file::TempFile;
use super::{About, Moment, RecordingError};

/// The channels in order: the topic and the encoding of its messages.
pub const CHANNELS: [(&str, &str); 4] = [
    ("state", "cbor"),
    ("order", "json"),
    ("event", "json"),
    ("attachment", "cbor"),
];

/// The id that the MCAP writer assigns to the first channel.
pub const FIRST_CHANNEL: u16 = 1;

/// The index of the channel of states, in CBOR as published.
pub const STATE: usize = 0;
/// The index of the channel of orders, in JSON as published.
pub const ORDER: usize = 1;
/// The index of the channel of events, in JSON as published.
pub const EVENT: usize = 2;
/// The index of the channel of what is attached to states, in CBOR as published. Each message precedes
/// its state, and has its header.
pub const ATTACHMENT: usize = 3;

/// The name of the metadata records of a recording; a later record adds to the earlier ones.
pub const METADATA: &str = "jostle";

/// The maximum overhead of a message in bytes: its header, its index entries and, if it fills a
/// chunk of its own, the overhead of that chunk.
const MESSAGE_OVERHEAD: u64 = 512;

/// The maximum overhead of an attachment in bytes; its chunk is that of a state.
const ATTACHMENT_OVERHEAD: u64 = 64;

/// The maximum overhead of a file's beginning and end in bytes, without the recording's metadata.
const FILE_OVERHEAD: u64 = 64 * 1024;

/// An MCAP file that is being written.
pub struct McapPart {
    path: PathBuf,
    writer: Writer<BufWriter<File>>,
    channels: Vec<u16>,
    /// An upper bound for the file's length if it ended now.
    bytes: u64,
    /// The length of all messages' data together.
    data_bytes: u64,
    /// Whether the current chunk holds a message.
    is_dirty: bool,
    /// The metadata that the last [`McapPart::flush`] wrote.
    flushed_about: About,
}

impl McapPart {
    /// Begins the file with the metadata `about`, so that a partial file has them too.
    pub fn begin(temp_file: &TempFile, about: &About) -> Result<Self, RecordingError> {
        let failed = |error| failed(temp_file, error);
        let mut writer = WriteOptions::new()
            // Doubles of moving bodies hardly compress, and readers need no decompression library.
            .compression(None)
            .profile("jostle")
            .library(concat!("jostle-results ", env!("CARGO_PKG_VERSION")))
            .create(BufWriter::new(temp_file.file()?))
            .map_err(failed)?;
        if !about.is_empty() {
            writer.write_metadata(&metadata(about)).map_err(failed)?;
        }
        // The metadata reach the partial file before the first message.
        writer.flush().map_err(failed)?;
        let channels = CHANNELS
            .iter()
            .map(|(topic, encoding)| writer.add_channel(0, topic, encoding, &About::new()))
            .collect::<Result<_, _>>()
            .map_err(failed)?;
        Ok(McapPart {
            path: temp_file.path.clone(),
            writer,
            channels,
            bytes: FILE_OVERHEAD + 2 * length(about),
            data_bytes: 0,
            is_dirty: false,
            flushed_about: About::new(),
        })
    }

    /// Writes a message if the disk has space for it.
    pub fn message(
        &mut self,
        temp_file: &mut TempFile,
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
        self.write(temp_file, channel, &header, data)
    }

    /// Copies a message of another file unchanged, if the disk has space for it.
    pub fn copy(
        &mut self,
        temp_file: &mut TempFile,
        channel: usize,
        header: &MessageHeader,
        data: &[u8],
    ) -> Result<(), RecordingError> {
        let channel_id = self.channels[channel];
        let header = MessageHeader {
            channel_id,
            ..*header
        };
        self.write(temp_file, channel, &header, data)
    }

    fn write(
        &mut self,
        temp_file: &mut TempFile,
        channel: usize,
        header: &MessageHeader,
        data: &[u8],
    ) -> Result<(), RecordingError> {
        let overhead = match channel {
            ATTACHMENT => ATTACHMENT_OVERHEAD,
            _ => MESSAGE_OVERHEAD,
        };
        let bytes = self.bytes + data.len() as u64 + overhead;
        temp_file.reserve(bytes)?;
        self.is_dirty = true;
        self.writer
            .write_to_known_channel(header, data)
            .map_err(|error| failed(temp_file, error))?;
        self.bytes = bytes;
        self.data_bytes += data.len() as u64;
        Ok(())
    }

    /// Ends the current chunk and flushes the file to the operating system, with the metadata
    /// `so_far` if it has changed. Returns whether anything was written.
    pub fn flush(
        &mut self,
        temp_file: &mut TempFile,
        so_far: &About,
    ) -> Result<bool, RecordingError> {
        let has_changed = !so_far.is_empty() && self.flushed_about != *so_far;
        if !self.is_dirty && !has_changed {
            return Ok(false);
        }
        if has_changed {
            let bytes = self.bytes + 2 * length(so_far) + MESSAGE_OVERHEAD;
            temp_file.reserve(bytes)?;
            self.bytes = bytes;
            self.writer
                .write_metadata(&metadata(so_far))
                .map_err(|error| failed(temp_file, error))?;
            self.flushed_about.clone_from(so_far);
        }
        self.writer
            .flush()
            .map_err(|error| failed(temp_file, error))?;
        self.is_dirty = false;
        Ok(true)
    }

    /// Adds the metadata `closing` and ends the file.
    pub fn finish(mut self, temp_file: &TempFile, closing: &About) -> Result<(), RecordingError> {
        let failed = |error| failed(temp_file, error);
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

    /// Returns an upper bound for the file's length if it ended now.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Returns the length of all written messages' data together.
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

/// Returns an upper bound for the encoded length of `about`.
pub fn length(about: &About) -> u64 {
    let of = |(key, value): (&String, &String)| (key.len() + value.len() + 64) as u64;
    about.iter().map(of).sum()
}

fn failed(temp_file: &TempFile, error: McapError) -> RecordingError {
    match error {
        McapError::Io(source) => io_error(&temp_file.path, source),
        error => RecordingError::Mcap {
            path: temp_file.path.clone(),
            reason: error.to_string(),
        },
    }
}
