//! Random secrets, and files that only their owner can read.

use std::fs;
use std::io::{self, Read, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, fchown};
use std::path::Path;

use jostle_atomic_file as atomic_file;
use rustix::process::geteuid;

/// Random bytes in hexadecimal.
pub fn random_hex(bytes: usize) -> io::Result<String> {
    let mut secret = vec![0; bytes];
    fs::File::open("/dev/urandom")?.read_exact(&mut secret)?;
    Ok(secret.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Atomically writes a file that only its owner can read.
pub fn write(path: &Path, text: &str) -> io::Result<()> {
    atomic_file::remove_unfinished(path)?;
    let mut file = atomic_file::begin_private(path)?;
    // The user of the daemon must be able to read what root writes.
    if geteuid().is_root()
        && let Some(folder) = path.parent()
    {
        let owner = fs::metadata(folder)?;
        fchown(file.as_file(), Some(owner.uid()), Some(owner.gid()))?;
    }
    file.write_all(text.as_bytes())?;
    atomic_file::publish(file, path)
}

/// Atomically replaces the content of a file, which keeps its owner and permissions.
pub fn replace(path: &Path, text: &str) -> io::Result<()> {
    let path = fs::canonicalize(path)?;
    let old = fs::metadata(&path)?;
    let mut file = atomic_file::begin_private(&path)?;
    if geteuid().is_root() {
        fchown(file.as_file(), Some(old.uid()), Some(old.gid()))?;
    }
    file.as_file().set_permissions(old.permissions())?;
    file.write_all(text.as_bytes())?;
    atomic_file::publish(file, &path)
}

/// Creates a folder that only its owner can read, and its parents, if they do not exist.
pub fn make_folder(path: &Path) -> io::Result<()> {
    fs::DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(path)
}
