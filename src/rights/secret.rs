//! What nobody can guess.

use std::fs::{self, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, fchown};
use std::path::Path;

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

/// Writes a file that nobody else can read. It is written aside and then takes the place of one
/// that is there, so that what is cut off is never taken for the whole.
///
/// # Errors
///
/// When it cannot be written.
pub fn write(path: &Path, text: &str) -> io::Result<()> {
    let mut aside = path.as_os_str().to_owned();
    aside.push(".new");
    match fs::remove_file(&aside) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    let options = OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(&aside);
    let mut file = options?;
    // Root writes into the folder of a daemon that runs as somebody else, who reads it.
    if geteuid().is_root()
        && let Some(folder) = path.parent()
    {
        let owner = fs::metadata(folder)?;
        fchown(&file, Some(owner.uid()), Some(owner.gid()))?;
    }
    file.write_all(text.as_bytes())?;
    file.sync_all()?;
    fs::rename(&aside, path)
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
