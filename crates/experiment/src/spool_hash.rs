//! The hash of the bytes of a spool. A checkpoint of its run has it, so that no run continues from a
//! spool that was damaged meanwhile.

use std::fs::File;
use std::io::{self, Read as _};
use std::path::Path;

use blake3::Hasher;

/// The BLAKE3 hash of the bytes that were appended to a spool.
#[derive(Default)]
pub struct SpoolHash(Hasher);

impl SpoolHash {
    /// Returns the hash of the first `length` bytes of a spool; none if it has fewer.
    pub fn of(spool: &Path, length: u64) -> io::Result<Option<Self>> {
        let mut hasher = Hasher::new();
        hasher.update_reader(File::open(spool)?.take(length))?;
        Ok((hasher.count() == length).then_some(Self(hasher)))
    }

    /// Adds appended bytes.
    pub fn add(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    /// Returns the hash in hexadecimal digits.
    pub fn hex(&self) -> String {
        self.0.finalize().to_hex().to_string()
    }

    /// Returns whether this is the hash of a checkpoint; those of earlier versions have none.
    pub fn is(&self, stored: Option<&String>) -> bool {
        stored.is_none_or(|stored| *stored == self.hex())
    }

    /// Checks that a spool has the bytes that were appended.
    ///
    /// # Errors
    ///
    /// [`io::ErrorKind::InvalidData`], and those of reading it.
    pub fn check(&self, spool: &Path) -> io::Result<()> {
        let read = Self::of(spool, self.0.count())?;
        match read.is_some_and(|read| read.hex() == self.hex()) {
            true => Ok(()),
            false => Err(io::Error::new(
                io::ErrorKind::InvalidData,
                "it is damaged: continue the experiment, which executes the run again",
            )),
        }
    }
}
