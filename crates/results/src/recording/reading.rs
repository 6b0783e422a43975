//! Reading MCAP: every message in the order in which it was written, with its offset in the file.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use mcap::parse_record;
use mcap::records::{MessageHeader, Record, op};

use super::mcap::{ATTACHMENT, CHANNELS, FIRST_CHANNEL, METADATA, STATE};
use super::{About, RecordingError};

/// The bytes at the beginning and the end of an MCAP file.
pub const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";

/// The length of a record's header: its code and its length.
const RECORD_HEADER: usize = 9;

/// The length of a message's header, which precedes its data.
const MESSAGE_HEADER: u64 = 22;

/// The maximum length of a record. A longer one counts as damage.
const MAX_BYTES: u64 = 256 * 1024 * 1024;

/// The length of the fields before the data of an uncompressed chunk: code, length, two times,
/// uncompressed size, checksum, the empty name of the compression, and the size of the data.
const CHUNK_HEAD: usize = RECORD_HEADER + 8 + 8 + 8 + 4 + 4 + 8;

/// The length of the window in which a chunk is searched for.
const WINDOW_BYTES: u64 = 1024 * 1024;

/// A message of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Message<'a> {
    /// Its topic: `state`, `order` or `event`.
    pub topic: &'a str,
    /// The offset of its bytes in the file.
    pub offset: u64,
    /// The published bytes.
    pub bytes: &'a [u8],
    /// What is attached to a state, if its recorder received that. It is no message of its own.
    pub attachment: Option<&'a [u8]>,
    /// Its number and its times, as written.
    pub header: MessageHeader,
}

/// The result of reading a file that may have no end.
#[derive(Debug)]
pub struct Unfinished {
    /// The metadata of the recording.
    pub about: About,
    /// The reason why the file has no end; `None` if it is whole.
    pub cut: Option<String>,
    /// The number of damaged places: damaged records, and bytes between records.
    pub damaged: u64,
    /// The number of bytes at the end of the file that hold no whole record.
    pub unread: u64,
}

/// The reason why reading stops.
enum Stop<E> {
    /// The rest of the file is missing or cannot be read.
    Cut(String),
    /// The current chunk or record is damaged.
    Damaged(String),
    /// The callback returned an error.
    Caller(E),
}

/// Reads a whole file: calls `each` with every message in the order in which they were written, and
/// returns the metadata of the recording. If a checksum is wrong, the error may follow messages.
///
/// # Errors
///
/// [`RecordingError::Unreadable`] if the file is no MCAP file, cut short, damaged or compressed, or
/// if `each` fails, with its reason.
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

/// Reads every whole chunk of a file that may have no end, and skips damaged ones.
///
/// # Errors
///
/// [`RecordingError::Unreadable`] if the file is no MCAP file, and the errors of `each`.
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

/// Reads the bytes of a message at its offset in the file.
///
/// # Errors
///
/// The system's error.
pub fn bytes_at(file: &mut File, offset: u64, length: usize) -> io::Result<Vec<u8>> {
    file.seek(SeekFrom::Start(offset))?;
    let mut bytes = vec![0; length];
    file.read_exact(&mut bytes)?;
    Ok(bytes)
}

/// Returns a checksum of the bytes of a message, to compare with what [`bytes_at`] returns later.
#[must_use]
pub fn checksum(bytes: &[u8]) -> u32 {
    crc32fast::hash(bytes)
}

struct Reading<F> {
    each: F,
    about: About,
    topics: HashMap<u16, String>,
    /// The attachment of the next state, with its header.
    attachment: Option<(MessageHeader, Vec<u8>)>,
    /// Whether damaged chunks are skipped.
    skips_damage: bool,
    damaged: u64,
    unread: u64,
}

impl<E, F: FnMut(Message<'_>) -> Result<(), E>> Reading<F> {
    fn new(each: F, skips_damage: bool) -> Self {
        Reading {
            each,
            about: About::new(),
            // The first chunk maps channel ids to topics. It may be damaged, so start with the ids
            // that jostle assigns: a file without jostle's metadata is not recovered.
            topics: match skips_damage {
                true => known_topics(),
                false => HashMap::new(),
            },
            attachment: None,
            skips_damage,
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
        // The data section, then the summary. A checksum over each covers what is outside chunks.
        let mut section = crc32fast::Hasher::new();
        section.update(&magic);
        let mut has_data_end = false;
        loop {
            self.unread = length.saturating_sub(at);
            let mut head = [0; RECORD_HEADER];
            file.read_exact(&mut head)
                .map_err(|error| explain(&error))?;
            at += RECORD_HEADER as u64;
            let [code, bytes @ ..] = head;
            let bytes = u64::from_le_bytes(bytes);
            let is_known = (op::HEADER..=op::DATA_END).contains(&code);
            if bytes > length.saturating_sub(at) || bytes > MAX_BYTES || !is_known {
                if !self.skips_damage {
                    return Err(cut_short());
                }
                // Either a record whose write was interrupted, or damage.
                at -= RECORD_HEADER as u64;
                let found = next_chunk(&mut file, at).map_err(|error| explain(&error))?;
                let is_torn = match code {
                    // The length of a chunk that is still being written.
                    op::CHUNK => bytes == u64::MAX || may_be_chunk(&mut file, at)?,
                    _ => is_known && bytes <= MAX_BYTES,
                };
                if found.is_some() || !is_torn {
                    self.damaged += 1;
                }
                at = found.ok_or_else(cut_short)?;
                file.seek(SeekFrom::Start(at))
                    .map_err(|error| explain(&error))?;
                continue;
            }
            body.resize(usize::try_from(bytes).map_err(|_| cut_short())?, 0);
            file.read_exact(&mut body)
                .map_err(|error| explain(&error))?;
            match code {
                op::DATA_END => {
                    self.end(section, &body)?;
                    section = crc32fast::Hasher::new();
                    has_data_end = true;
                }
                op::FOOTER => {
                    let checked = body.len().saturating_sub(4);
                    section.update(&head);
                    section.update(&body[..checked]);
                    self.end(section, &body[checked..])?;
                    self.unread = length - at - bytes;
                    file.read_exact(&mut magic)
                        .map_err(|error| explain(&error))?;
                    self.unread = 0;
                    return self.expect(has_data_end && magic == MAGIC);
                }
                _ => {
                    section.update(&head);
                    section.update(&body);
                    match self.record(code, at, &body) {
                        Err(Stop::Damaged(_)) if self.skips_damage => self.damaged += 1,
                        taken => taken?,
                    }
                }
            }
            at += bytes;
        }
    }

    /// Compares the checksum of a section with the one that is stored; 0 is none.
    fn end(&mut self, section: crc32fast::Hasher, stored: &[u8]) -> Result<(), Stop<E>> {
        let stored = <[u8; 4]>::try_from(stored).map(u32::from_le_bytes);
        let computed = section.finalize();
        self.expect(stored.is_ok_and(|stored| stored == 0 || stored == computed))
    }

    /// Counts damage outside chunks, if there is any, or returns it as an error. A damaged chunk, which
    /// is counted already, changes the checksum of its section.
    fn expect(&mut self, is_intact: bool) -> Result<(), Stop<E>> {
        match (is_intact, self.skips_damage) {
            (true, _) => Ok(()),
            (false, true) => {
                self.damaged = self.damaged.max(1);
                Ok(())
            }
            (false, false) => Err(wrong_checksum()),
        }
    }

    /// Processes a record, whose body begins at `from` in the file.
    fn record(&mut self, code: u8, from: u64, body: &[u8]) -> Result<(), Stop<E>> {
        let parsed = parse_record(code, body);
        match parsed.map_err(|error| Stop::Damaged(error.to_string()))? {
            Record::Chunk { header, data } => {
                if !header.compression.is_empty() {
                    return Err(Stop::Damaged(format!(
                        "another program compressed it ({}): use the original file",
                        header.compression
                    )));
                }
                if header.uncompressed_crc != 0 && crc32fast::hash(&data) != header.uncompressed_crc
                {
                    return Err(wrong_checksum());
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
                let Some(topic) = self.topics.get(&header.channel_id) else {
                    return Ok(());
                };
                if topic == CHANNELS[ATTACHMENT].0 {
                    self.attachment = Some((header, data.into_owned()));
                    return Ok(());
                }
                let is_state = topic == CHANNELS[STATE].0;
                let attachment = self.attachment.take_if(|_| is_state);
                // The chunk with the state of an attachment may be damaged.
                let attachment = attachment.filter(|(it, _)| {
                    (it.sequence, it.log_time) == (header.sequence, header.log_time)
                });
                (self.each)(Message {
                    topic,
                    offset: from + MESSAGE_HEADER,
                    bytes: &data,
                    attachment: attachment.as_ref().map(|(_, bytes)| &**bytes),
                    header,
                })
                .map_err(Stop::Caller)?;
            }
            _ => {}
        }
        Ok(())
    }

    /// Processes the records of a chunk, which begins at `from` in the file.
    fn chunk(&mut self, from: u64, chunk: &[u8]) -> Result<(), Stop<E>> {
        let mut at = 0;
        while at < chunk.len() {
            let begin = at + RECORD_HEADER;
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
                let reason = "it is damaged: a chunk contains a chunk".to_owned();
                return Err(Stop::Damaged(reason));
            }
            self.record(head[0], from + begin as u64, body)?;
            at = begin + body.len();
        }
        Ok(())
    }
}

/// Returns the offset of the first whole chunk that begins after `at`.
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
        if bytes <= length - begin - RECORD_HEADER as u64 {
            return Ok(Some(begin));
        }
        from = begin + 1;
    }
    Ok(None)
}

/// Returns the length field of a chunk's record if `head` can be the start of an uncompressed
/// chunk: all of its lengths agree.
fn chunk_bytes(head: &[u8]) -> Option<u64> {
    let number = |at: usize| {
        let bytes = head.get(at..at + 8)?;
        Some(u64::from_le_bytes(bytes.try_into().ok()?))
    };
    let bytes = number(1)?;
    let data = bytes.checked_sub((CHUNK_HEAD - RECORD_HEADER) as u64)?;
    let agrees = number(25)? == data && number(41)? == data && head.get(37..41)? == [0; 4];
    (head.first() == Some(&op::CHUNK) && agrees && bytes <= MAX_BYTES).then_some(bytes)
}

/// Returns whether the record at `at` can be a chunk whose write was interrupted, and not damage.
fn may_be_chunk<E>(file: &mut BufReader<File>, at: u64) -> Result<bool, Stop<E>> {
    let mut head = Vec::new();
    let read = file
        .seek(SeekFrom::Start(at))
        .and_then(|_| file.by_ref().take(CHUNK_HEAD as u64).read_to_end(&mut head));
    read.map_err(|error| explain(&error))?;
    Ok(head.len() < CHUNK_HEAD || chunk_bytes(&head).is_some())
}

/// Returns the topics by the channel ids that jostle assigns.
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
    let reason = "it is cut short: its recorder was killed or is still running; if it was killed, \
                  `jostle record --recover FILE` makes a whole file of it";
    Stop::Cut(reason.to_owned())
}

fn wrong_checksum<E>() -> Stop<E> {
    Stop::Damaged("it is damaged: a checksum is wrong".to_owned())
}

fn overrun<E>() -> Stop<E> {
    let reason = "it is damaged: a record is longer than its chunk";
    Stop::Damaged(reason.to_owned())
}
