//! Reading MCAP back: every message in the order it was written, and where it lies.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use mcap::parse_record;
use mcap::records::{MessageHeader, Record, op};

use super::mcap::{CHANNELS, FIRST_CHANNEL, METADATA};
use super::{About, RecordingError};

/// What a file begins and ends with.
pub const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";

/// The length of what stands before a record: what it is, and how long.
const AROUND_RECORD: usize = 9;

/// The length of what stands before a message's data.
const AROUND_MESSAGE: u64 = 22;

/// The longest record that is read.
const MOST_BYTES: u64 = 256 * 1024 * 1024;

/// The bytes of a chunk's record before its data, if it is not compressed: code, length, two times,
/// uncompressed size, checksum, the empty name of the compression, and the size of the data.
const CHUNK_HEAD: usize = AROUND_RECORD + 8 + 8 + 8 + 4 + 4 + 8;

/// Bytes that are searched for a chunk at once.
const WINDOW_BYTES: u64 = 1024 * 1024;

/// A message of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Message<'a> {
    /// What it is about: `state`, `order` or `event`.
    pub topic: &'a str,
    /// Where its bytes begin in the file.
    pub offset: u64,
    /// Its bytes, as they were published.
    pub bytes: &'a [u8],
    /// Its number and its times, as they were written.
    pub header: MessageHeader,
}

/// What could be read of a file that may have no end.
#[derive(Debug)]
pub struct Unfinished {
    /// What the recording says of itself.
    pub about: About,
    /// Why the file ends where it does; nothing if it is whole.
    pub cut: Option<String>,
    /// Places that are damaged: chunks of which nothing was read, and bytes between records.
    pub damaged: u64,
    /// Bytes at the end of the file that hold no whole record.
    pub unread: u64,
}

/// Why a file is not read on.
enum Stop<E> {
    /// Nothing can be read from here on.
    Cut(String),
    /// The chunk or the record in hand is damaged.
    Damaged(String),
    /// The caller has enough.
    Caller(E),
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
    let mut reading = Reading::new(each, false);
    match reading.file(path) {
        Ok(()) => Ok(reading.about),
        Err(Stop::Cut(reason) | Stop::Damaged(reason) | Stop::Caller(reason)) => {
            Err(unreadable(path, reason))
        }
    }
}

/// Reads every whole chunk of a file, as [`read`] does of one that is whole.
///
/// # Errors
///
/// [`RecordingError::Unreadable`] for what is no MCAP, and whatever `each` returns.
pub fn read_unfinished(
    path: &Path,
    each: impl FnMut(Message<'_>) -> Result<(), RecordingError>,
) -> Result<Unfinished, RecordingError> {
    let mut reading = Reading::new(each, true);
    let cut = match reading.file(path) {
        Ok(()) => None,
        Err(Stop::Cut(reason)) => Some(reason),
        Err(Stop::Damaged(reason)) => return Err(unreadable(path, reason)),
        Err(Stop::Caller(error)) => return Err(error),
    };
    Ok(Unfinished {
        about: reading.about,
        cut,
        damaged: reading.damaged,
        unread: reading.unread,
    })
}

fn unreadable(path: &Path, reason: String) -> RecordingError {
    let path = path.to_owned();
    RecordingError::Unreadable { path, reason }
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

struct Reading<F> {
    each: F,
    about: About,
    topics: HashMap<u16, String>,
    /// Whether a damaged chunk is passed over.
    passes_over: bool,
    damaged: u64,
    unread: u64,
}

impl<E, F: FnMut(Message<'_>) -> Result<(), E>> Reading<F> {
    fn new(each: F, passes_over: bool) -> Self {
        Reading {
            each,
            about: About::new(),
            // The first chunk maps channel ids to topics. It may be damaged, so start with the ids
            // that jostle assigns: a file without jostle's metadata is not recovered.
            topics: match passes_over {
                true => known_topics(),
                false => HashMap::new(),
            },
            passes_over,
            damaged: 0,
            unread: 0,
        }
    }

    fn file(&mut self, path: &Path) -> Result<(), Stop<E>> {
        let opened = File::open(path).and_then(|file| Ok((file.metadata()?.len(), file)));
        let (length, file) = opened.map_err(|error| Stop::Damaged(error.to_string()))?;
        let mut file = BufReader::new(file);
        let mut magic = [0; MAGIC.len()];
        file.read_exact(&mut magic)
            .map_err(|error| explain(&error))?;
        if magic != MAGIC {
            return Err(Stop::Damaged("it is no MCAP file".to_owned()));
        }
        let (mut at, mut body) = (MAGIC.len() as u64, Vec::new());
        loop {
            self.unread = length.saturating_sub(at);
            let mut head = [0; AROUND_RECORD];
            file.read_exact(&mut head)
                .map_err(|error| explain(&error))?;
            at += AROUND_RECORD as u64;
            let [code, bytes @ ..] = head;
            let bytes = u64::from_le_bytes(bytes);
            let is_known = (op::HEADER..=op::DATA_END).contains(&code);
            if bytes > length.saturating_sub(at) || bytes > MOST_BYTES || !is_known {
                if !self.passes_over {
                    return Err(cut_short());
                }
                // Either a record whose write was interrupted, or damage.
                at -= AROUND_RECORD as u64;
                let found = next_chunk(&mut file, at).map_err(|error| explain(&error))?;
                let is_torn = match code {
                    // The length of a chunk that is still being written.
                    op::CHUNK => bytes == u64::MAX || may_be_chunk(&mut file, at)?,
                    _ => is_known && bytes <= MOST_BYTES,
                };
                if found.is_some() || !is_torn {
                    self.damaged += 1;
                }
                at = found.ok_or_else(cut_short)?;
                file.seek(SeekFrom::Start(at))
                    .map_err(|error| explain(&error))?;
                continue;
            }
            match code {
                op::FOOTER => {
                    self.unread = 0;
                    return Ok(());
                }
                op::CHUNK | op::MESSAGE | op::CHANNEL | op::METADATA => {
                    body.resize(usize::try_from(bytes).map_err(|_| cut_short())?, 0);
                    file.read_exact(&mut body)
                        .map_err(|error| explain(&error))?;
                    match self.record(code, at, &body) {
                        Err(Stop::Damaged(_)) if self.passes_over => self.damaged += 1,
                        taken => taken?,
                    }
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
    fn record(&mut self, code: u8, from: u64, body: &[u8]) -> Result<(), Stop<E>> {
        let parsed = parse_record(code, body);
        match parsed.map_err(|error| Stop::Damaged(error.to_string()))? {
            Record::Chunk { header, data } => {
                if !header.compression.is_empty() {
                    return Err(Stop::Damaged(format!(
                        "another program has compressed it ({}): take the file as it was recorded",
                        header.compression
                    )));
                }
                if header.uncompressed_crc != 0 && crc32fast::hash(&data) != header.uncompressed_crc
                {
                    let reason = "it is damaged: a checksum is wrong".to_owned();
                    return Err(Stop::Damaged(reason));
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
                        header,
                    })
                    .map_err(Stop::Caller)?;
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Takes the records of a chunk, which begins at `from` in the file.
    fn chunk(&mut self, from: u64, chunk: &[u8]) -> Result<(), Stop<E>> {
        let mut at = 0;
        while at < chunk.len() {
            let begin = at + AROUND_RECORD;
            let head = chunk.get(at..begin).ok_or_else(overrun)?;
            let bytes = head[1..]
                .iter()
                .rev()
                .fold(0, |bytes, byte| bytes << 8 | u64::from(*byte));
            let end = usize::try_from(bytes)
                .ok()
                .and_then(|bytes| begin.checked_add(bytes));
            let body = end.and_then(|end| chunk.get(begin..end));
            let body = body.ok_or_else(overrun)?;
            if head[0] == op::CHUNK {
                let reason = "it is damaged: a chunk lies in a chunk".to_owned();
                return Err(Stop::Damaged(reason));
            }
            self.record(head[0], from + begin as u64, body)?;
            at = begin + body.len();
        }
        Ok(())
    }
}

/// The first whole chunk that begins behind `at`.
fn next_chunk(file: &mut BufReader<File>, at: u64) -> io::Result<Option<u64>> {
    let length = file.get_ref().metadata()?.len();
    let mut window = Vec::new();
    let mut from = at + 1;
    while from + CHUNK_HEAD as u64 <= length {
        file.seek(SeekFrom::Start(from))?;
        window.clear();
        file.by_ref().take(WINDOW_BYTES).read_to_end(&mut window)?;
        let mut heads = window.windows(CHUNK_HEAD);
        let found = heads.position(|head| chunk_bytes(head).is_some());
        let Some(offset) = found else {
            from += (window.len() + 1).saturating_sub(CHUNK_HEAD) as u64;
            continue;
        };
        let begin = from + offset as u64;
        let bytes = chunk_bytes(&window[offset..offset + CHUNK_HEAD]).unwrap_or_default();
        if bytes <= length - begin - AROUND_RECORD as u64 {
            return Ok(Some(begin));
        }
        from = begin + 1;
    }
    Ok(None)
}

/// The length field of a chunk's record, if `head` can be the start of an uncompressed chunk: all
/// of its lengths agree.
fn chunk_bytes(head: &[u8]) -> Option<u64> {
    let number = |at: usize| {
        let bytes = head.get(at..at + 8)?;
        Some(u64::from_le_bytes(bytes.try_into().ok()?))
    };
    let bytes = number(1)?;
    let data = bytes.checked_sub((CHUNK_HEAD - AROUND_RECORD) as u64)?;
    let agrees = number(25)? == data && number(41)? == data && head.get(37..41)? == [0; 4];
    (head.first() == Some(&op::CHUNK) && agrees && bytes <= MOST_BYTES).then_some(bytes)
}

/// Whether the chunk at `at` was cut short while it was written, and is not damaged.
fn may_be_chunk<E>(file: &mut BufReader<File>, at: u64) -> Result<bool, Stop<E>> {
    let mut head = Vec::new();
    let read = file
        .seek(SeekFrom::Start(at))
        .and_then(|_| file.by_ref().take(CHUNK_HEAD as u64).read_to_end(&mut head));
    read.map_err(|error| explain(&error))?;
    Ok(head.len() < CHUNK_HEAD || chunk_bytes(&head).is_some())
}

/// The topics by the channel ids that jostle assigns.
fn known_topics() -> HashMap<u16, String> {
    let topics = CHANNELS.iter().map(|(topic, _)| (*topic).to_owned());
    (FIRST_CHANNEL..).zip(topics).collect()
}

fn explain<E>(error: &io::Error) -> Stop<E> {
    match error.kind() {
        io::ErrorKind::UnexpectedEof => cut_short(),
        _ => Stop::Damaged(error.to_string()),
    }
}

fn cut_short<E>() -> Stop<E> {
    let reason = "it is cut short: what recorded it was killed, or still records; if it was \
                  killed, `jostle record --recover FILE` makes a whole file of it";
    Stop::Cut(reason.to_owned())
}

fn overrun<E>() -> Stop<E> {
    let reason = "it is damaged: a record is longer than the chunk that holds it";
    Stop::Damaged(reason.to_owned())
}
