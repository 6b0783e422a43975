//! Checksums of Parquet files. A flipped bit in a page or in the footer can decode as another value, and the
//! Parquet library writes no checksums of its own.
//!
//! The metadata key [`KEY`] has the text `footer:HASH END:HASH END:HASH ...`: a hash for each row group, whose
//! bytes go from the end of the one before it, or from the beginning of the file, to `END`; and one over the
//! bytes after the last row group, with its own digits as zeros. All are BLAKE3 in hexadecimal digits. The
//! offsets are in the text, so that a reader checks the footer before it parses it.

use std::fs::{File, OpenOptions};
use std::io::{self, BufReader, Read as _, Seek as _, SeekFrom, Write};
use std::ops::Range;
use std::path::Path;
use std::sync::Mutex;

use bytes::Bytes;
use parquet::errors::ParquetError;
use parquet::file::metadata::{KeyValue, RowGroupMetaData};
use parquet::file::reader::{ChunkReader, Length};
use parquet::file::writer::SerializedFileWriter;

/// The metadata key of the checksums.
pub const KEY: &str = "jostle.blake3";

/// The key in its encoding within the footer. Its control characters keep a text of a user, which is
/// stored as JSON, from being taken for the key.
const ENCODED_KEY: &[u8] = b"\x18\x0djostle.blake3\x18";

/// What the text begins with. It is found even if a bit of the key is flipped.
const FOOTER: &str = "footer:";

/// What the footer calls the writers of jostle, after the metadata.
const WRITERS: [&[u8]; 2] = [b"parquet-rs version ", b"jostle-results "];

/// The number of digits of a hash.
const DIGITS: usize = 64;

/// The number of bytes after the footer: its length and the magic.
const END_BYTES: u64 = 8;

const MAGIC: &[u8] = b"PAR1";

/// The checksums of a file.
#[derive(Default)]
struct Checksums {
    /// The offset of the digits of the footer's hash in the file.
    digits: u64,
    footer: String,
    /// The row groups, in order.
    groups: Vec<Group>,
}

/// A row group: the end of its bytes, and their hash.
struct Group {
    end: u64,
    hash: String,
    is_checked: bool,
}

/// Ends the file, which is at `path` until it gets its name, with its checksums.
///
/// # Errors
///
/// Those of the Parquet library and of the file system.
pub fn finish<W: Write + Send>(
    mut writer: SerializedFileWriter<W>,
    path: &Path,
) -> Result<W, ParquetError> {
    writer.flush()?;
    let mut file = OpenOptions::new().read(true).write(true).open(path)?;
    let mut text = format!("{FOOTER}{}", "0".repeat(DIGITS));
    let mut from = 0;
    for group in writer.flushed_row_groups() {
        let end = end_of(group);
        text.push_str(&format!(" {end}:{}", hash(&file, from..end, None)?));
        from = end;
    }
    // The last pair of the metadata, so that it is the last occurrence of the key in the footer.
    writer.append_key_value_metadata(KeyValue::new(KEY.to_owned(), text));
    let written = writer.into_inner()?;
    let length = file.metadata()?.len();
    let Some(checksums) = find(&file, length)? else {
        return Err(damaged("the footer was written without its checksums"));
    };
    let footer = hash(&file, from..length, Some(checksums.digits))?;
    file.seek(SeekFrom::Start(checksums.digits))?;
    file.write_all(footer.as_bytes())?;
    Ok(written)
}

/// Returns where the bytes of a row group end.
fn end_of(group: &RowGroupMetaData) -> u64 {
    let columns = group.columns().iter().map(|column| column.byte_range());
    columns
        .map(|(start, bytes)| start + bytes)
        .max()
        .unwrap_or(0)
}

/// A file whose bytes are checked before the Parquet library gets them: the footer when it is opened, a
/// row group before its first page is read. A file without checksums is not checked.
pub struct Checked {
    file: File,
    length: u64,
    groups: Mutex<Vec<Group>>,
}

impl Checked {
    /// Opens a file and checks its footer.
    ///
    /// # Errors
    ///
    /// [`ParquetError::External`] of the file system; [`ParquetError::General`] if the footer is damaged.
    pub fn open(path: &Path) -> Result<Self, ParquetError> {
        let file = File::open(path)?;
        let length = file.metadata()?.len();
        let Some(checksums) = find(&file, length)? else {
            return Ok(Self {
                file,
                length,
                groups: Mutex::default(),
            });
        };
        let from = checksums.groups.last().map_or(0, |group| group.end);
        check(
            &file,
            from..length,
            Some(checksums.digits),
            &checksums.footer,
        )?;
        Ok(Self {
            file,
            length,
            groups: Mutex::new(checksums.groups),
        })
    }

    /// Checks all row groups.
    ///
    /// # Errors
    ///
    /// As [`Checked::open`].
    pub fn check_all(&self) -> Result<(), ParquetError> {
        self.check(0..self.length)
    }

    /// Checks the row groups that have some of these bytes, unless they are checked already.
    fn check(&self, bytes: Range<u64>) -> Result<(), ParquetError> {
        let mut groups = self.groups.lock().unwrap_or_else(|it| it.into_inner());
        let mut from = 0;
        for group in groups.iter_mut() {
            if bytes.start < group.end && from < bytes.end && !group.is_checked {
                check(&self.file, from..group.end, None, &group.hash)?;
                group.is_checked = true;
            }
            from = group.end;
        }
        Ok(())
    }
}

impl Length for Checked {
    fn len(&self) -> u64 {
        self.length
    }
}

impl ChunkReader for Checked {
    type T = BufReader<File>;

    fn get_read(&self, start: u64) -> Result<Self::T, ParquetError> {
        self.check(start..start.saturating_add(1))?;
        self.file.get_read(start)
    }

    fn get_bytes(&self, start: u64, length: usize) -> Result<Bytes, ParquetError> {
        self.check(start..start.saturating_add(length as u64))?;
        self.file.get_bytes(start, length)
    }
}

/// Finds the checksums in the footer. `None` if it has none, or if the file has no footer: the Parquet
/// library states why.
fn find(file: &File, length: u64) -> Result<Option<Checksums>, ParquetError> {
    if length < END_BYTES {
        return Ok(None);
    }
    let end = length - END_BYTES;
    let last = file.get_bytes(end, MAGIC.len() + 4)?;
    let bytes = last.first_chunk().map_or(0, |it| u32::from_le_bytes(*it));
    if !last.ends_with(MAGIC) || u64::from(bytes) > end {
        return Ok(None);
    }
    let begin = end - u64::from(bytes);
    let footer = file.get_bytes(begin, bytes as usize)?;
    let Some(at) = rfind(&footer, ENCODED_KEY) else {
        return match rfind(&footer, FOOTER.as_bytes()) {
            Some(at) if digits(footer.get(at + FOOTER.len()..).unwrap_or_default()).is_some() => {
                Err(damaged("the key of its checksums is damaged"))
            }
            _ => Ok(None),
        };
    };
    let text_at = at + ENCODED_KEY.len();
    // Other programs copy the metadata of a table to a file that they write, whose bytes differ.
    let is_by = |writer: &[u8]| rfind(&footer[text_at..], writer).is_some();
    if !WRITERS.into_iter().any(is_by) {
        return Ok(None);
    }
    let checksums = text(&footer[text_at..]).and_then(|(skipped, text)| {
        let at = begin + (text_at + skipped + FOOTER.len()) as u64;
        parse(text, at, begin)
    });
    let checksums = checksums.ok_or_else(|| damaged("the text of its checksums is damaged"))?;
    Ok(Some(checksums))
}

/// Returns the text that `bytes` begin with, and the number of bytes of the length before it.
fn text(bytes: &[u8]) -> Option<(usize, &str)> {
    let mut length = 0;
    for (index, byte) in bytes.iter().enumerate().take(5) {
        length |= usize::from(byte & 0x7f) << (7 * index);
        if byte & 0x80 == 0 {
            let text = bytes.get(index + 1..)?.get(..length)?;
            return Some((index + 1, std::str::from_utf8(text).ok()?));
        }
    }
    None
}

/// Parses the text of the checksums, whose first digits are at `at`, before the footer begins at `begin`.
fn parse(text: &str, at: u64, begin: u64) -> Option<Checksums> {
    let mut parts = text.strip_prefix(FOOTER)?.split(' ');
    let footer = parts.next().filter(|it| it.len() == DIGITS)?.to_owned();
    let mut groups: Vec<Group> = Vec::new();
    for part in parts {
        let (end, hash) = part.split_once(':')?;
        let (end, hash) = (end.parse().ok()?, hash.to_owned());
        if end > begin || groups.last().is_some_and(|group| end <= group.end) {
            return None;
        }
        groups.push(Group {
            end,
            hash,
            is_checked: false,
        });
    }
    Some(Checksums {
        digits: at,
        footer,
        groups,
    })
}

/// Returns the digits of a hash that `bytes` begin with.
fn digits(bytes: &[u8]) -> Option<&[u8]> {
    let digits = bytes.get(..DIGITS)?;
    digits.iter().all(u8::is_ascii_hexdigit).then_some(digits)
}

fn rfind(bytes: &[u8], searched: &[u8]) -> Option<usize> {
    let mut windows = bytes.windows(searched.len());
    windows.rposition(|window| window == searched)
}

fn check(
    file: &File,
    bytes: Range<u64>,
    digits: Option<u64>,
    expected: &str,
) -> Result<(), ParquetError> {
    if hash(file, bytes.clone(), digits)? == expected {
        return Ok(());
    }
    let Range { start, end } = bytes;
    Err(damaged(&format!(
        "its bytes from {start} to {end} do not match their checksum"
    )))
}

/// Hashes bytes of a file, those of the `digits` as zeros, if any.
fn hash(file: &File, bytes: Range<u64>, digits: Option<u64>) -> Result<String, ParquetError> {
    let mut hasher = blake3::Hasher::new();
    let update = |hasher: &mut blake3::Hasher, bytes: Range<u64>| {
        let mut file = file;
        file.seek(SeekFrom::Start(bytes.start))?;
        let length = bytes.end.saturating_sub(bytes.start);
        io::copy(&mut file.take(length), hasher)
    };
    match digits {
        Some(at) => {
            update(&mut hasher, bytes.start..at)?;
            hasher.update("0".repeat(DIGITS).as_bytes());
            update(&mut hasher, at + DIGITS as u64..bytes.end)?;
        }
        None => {
            update(&mut hasher, bytes)?;
        }
    }
    Ok(hasher.finalize().to_hex().to_string())
}

fn damaged(problem: &str) -> ParquetError {
    let remedy = "copy the file again, or restore it from a backup";
    ParquetError::General(format!("it is damaged: {problem}; {remedy}"))
}
