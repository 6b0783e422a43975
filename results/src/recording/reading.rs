//! Reading MCAP back: every message in the order it was written, and where it lies.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use mcap::parse_record;
use mcap::records::{Record, op};

use super::mcap::METADATA;
use super::{About, RecordingError};

/// What a file begins and ends with.
const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";

/// The length of what stands before a record: what it is, and how long.
const AROUND_RECORD: usize = 9;

/// The length of what stands before a message's data.
const AROUND_MESSAGE: u64 = 22;

/// The longest record that is read.
const MOST_BYTES: u64 = 256 * 1024 * 1024;

/// A message of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Message<'a> {
    /// What it is about: `state`, `order` or `event`.
    pub topic: &'a str,
    /// Where its bytes begin in the file.
    pub offset: u64,
    /// Its bytes, as they were published.
    pub bytes: &'a [u8],
}

/// Reads a whole file: hands every message to `each` in the order in which they were written, and
/// returns what the recording says of itself.
///
/// # Errors
///
/// [`RecordingError::Unreadable`] for what is no MCAP, cut short, damaged or compressed, and with
/// whatever `each` returns.
pub fn read(
    path: &Path,
    each: impl FnMut(Message<'_>) -> Result<(), String>,
) -> Result<About, RecordingError> {
    let mut reading = Reading {
        each,
        about: About::new(),
        topics: HashMap::new(),
    };
    let done = reading.file(path);
    done.map(|()| reading.about)
        .map_err(|reason| RecordingError::Unreadable {
            path: path.to_owned(),
            reason,
        })
}

/// The bytes of a message, from where they lie.
///
/// # Errors
///
/// What the system says.
pub fn bytes_at(file: &mut File, offset: u64, length: usize) -> io::Result<Vec<u8>> {
    file.seek(SeekFrom::Start(offset))?;
    let mut bytes = vec![0; length];
    file.read_exact(&mut bytes)?;
    Ok(bytes)
}

struct Reading<E> {
    each: E,
    about: About,
    topics: HashMap<u16, String>,
}

impl<E: FnMut(Message<'_>) -> Result<(), String>> Reading<E> {
    fn file(&mut self, path: &Path) -> Result<(), String> {
        let file = File::open(path).map_err(|error| error.to_string())?;
        let length = file.metadata().map_err(|error| error.to_string())?.len();
        let mut file = BufReader::new(file);
        let mut magic = [0; MAGIC.len()];
        file.read_exact(&mut magic)
            .map_err(|error| explain(&error))?;
        if magic != MAGIC {
            return Err("it is no MCAP file".to_owned());
        }
        let (mut at, mut body) = (MAGIC.len() as u64, Vec::new());
        loop {
            let mut head = [0; AROUND_RECORD];
            file.read_exact(&mut head)
                .map_err(|error| explain(&error))?;
            at += AROUND_RECORD as u64;
            let [code, bytes @ ..] = head;
            let bytes = u64::from_le_bytes(bytes);
            if bytes > length.saturating_sub(at) || bytes > MOST_BYTES {
                return Err(cut_short());
            }
            match code {
                op::FOOTER => return Ok(()),
                op::CHUNK | op::MESSAGE | op::CHANNEL | op::METADATA => {
                    body.resize(usize::try_from(bytes).map_err(|_| cut_short())?, 0);
                    file.read_exact(&mut body)
                        .map_err(|error| explain(&error))?;
                    self.record(code, at, &body)?;
                }
                _ => {
                    let skipped = i64::try_from(bytes).unwrap_or(i64::MAX);
                    file.seek_relative(skipped)
                        .map_err(|error| explain(&error))?;
                }
            }
            at += bytes;
        }
    }

    /// Takes a record, whose body begins at `from` in the file.
    fn record(&mut self, code: u8, from: u64, body: &[u8]) -> Result<(), String> {
        match parse_record(code, body).map_err(|error| error.to_string())? {
            Record::Chunk { header, data } => {
                if !header.compression.is_empty() {
                    return Err(format!(
                        "another program has compressed it ({}): take the file as it was recorded",
                        header.compression
                    ));
                }
                if header.uncompressed_crc != 0 && crc32fast::hash(&data) != header.uncompressed_crc
                {
                    return Err("it is damaged: a checksum is wrong".to_owned());
                }
                self.chunk(from + (body.len() - data.len()) as u64, &data)?;
            }
            Record::Channel(channel) => {
                self.topics.insert(channel.id, channel.topic);
            }
            Record::Metadata(metadata) if metadata.name == METADATA => {
                self.about.extend(metadata.metadata);
            }
            Record::Message { header, data } => {
                if let Some(topic) = self.topics.get(&header.channel_id) {
                    (self.each)(Message {
                        topic,
                        offset: from + AROUND_MESSAGE,
                        bytes: &data,
                    })?;
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Takes the records of a chunk, which begins at `from` in the file.
    fn chunk(&mut self, from: u64, chunk: &[u8]) -> Result<(), String> {
        let mut at = 0;
        while at < chunk.len() {
            let begin = at + AROUND_RECORD;
            let head = chunk.get(at..begin).ok_or_else(cut_short)?;
            let bytes = head[1..]
                .iter()
                .rev()
                .fold(0, |bytes, byte| bytes << 8 | u64::from(*byte));
            let end = usize::try_from(bytes)
                .ok()
                .and_then(|bytes| begin.checked_add(bytes));
            let body = end.and_then(|end| chunk.get(begin..end));
            let body = body.ok_or_else(cut_short)?;
            if head[0] == op::CHUNK {
                return Err("it is damaged: a chunk lies in a chunk".to_owned());
            }
            self.record(head[0], from + begin as u64, body)?;
            at = begin + body.len();
        }
        Ok(())
    }
}

fn explain(error: &io::Error) -> String {
    match error.kind() {
        io::ErrorKind::UnexpectedEof => cut_short(),
        _ => error.to_string(),
    }
}

fn cut_short() -> String {
    "it is cut short: what recorded it was killed, or still records".to_owned()
}
