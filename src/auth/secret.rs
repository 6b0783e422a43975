//! What nobody can guess.

use std::fs;
use std::io::{self, Read, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, fchown};
use std::path::Path;

use jostle_atomic_file as atomic_file;
use rustix::process::geteuid;

/// So many random bytes, in hexadecimal digits.
///
/// # Errors
///
/// When the system gives none.
pub fn draw(bytes: usize) -> io::Result<String> {
    let mut secret = vec![0; bytes];
    fs::File::open("/dev/urandom")?.read_exact(&mut secret)?;
    Ok(secret.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Writes a whole file that only its owner can read, or none. It replaces a file of this name.
///
/// # Errors
///
/// When it cannot be written.
pub fn write(path: &Path, text: &str) -> io::Result<()> {
    atomic_file::remove_unfinished(path)?;
    let mut file = atomic_file::begin_private(path)?;
    // Root writes into the folder of a daemon that runs as somebody else, who reads it.
    if geteuid().is_root()
        && let Some(folder) = path.parent()
    {
        let owner = fs::metadata(folder)?;
        fchown(file.as_file(), Some(owner.uid()), Some(owner.gid()))?;
    }
    file.write_all(text.as_bytes())?;
    atomic_file::publish(file, path)
}

/// Makes a folder, and those it is in, that nobody else can look into; harmless if it is there.
///
/// # Errors
///
/// When it cannot be made.
pub fn make_folder(path: &Path) -> io::Result<()> {
    fs::DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(path)
}
