//! Files that exist as a whole or not at all.
//!
//! A file is written under a temporary name in the folder of its path, synced, and then renamed. After a
//! crash the path has the old content or the new one, and a temporary file may be left: its name begins
//! with [`PREFIX`] and the name of the file, and [`remove_unfinished`] removes it. While a process writes
//! one of [`begin`], it holds an advisory lock on it, if the file system has locks: [`remove_abandoned`]
//! removes those without.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions, Permissions};
use std::io::{self, ErrorKind, Write};
use std::path::Path;

use tempfile::{Builder, NamedTempFile};

/// What the names of temporary files begin with.
pub const PREFIX: &str = ".jostle-";

/// Writes a file, and replaces one that exists.
///
/// # Errors
///
/// If it cannot be written. A file that existed is as it was, unless syncing the folder failed.
pub fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = begin(path)?;
    file.write_all(bytes)?;
    publish(file, path)
}

/// Writes a file that does not exist.
///
/// # Errors
///
/// [`io::ErrorKind::AlreadyExists`] if it does; others if it cannot be written.
pub fn write_new(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = begin(path)?;
    file.write_all(bytes)?;
    file.as_file().sync_all()?;
    file.persist_noclobber(path).map_err(|error| error.error)?;
    sync_folder_of(path)
}

/// Creates the temporary file that [`publish`] renames. If it is dropped before, it is removed.
///
/// # Errors
///
/// If the folder cannot be written to.
pub fn begin(path: &Path) -> io::Result<NamedTempFile> {
    let prefix = prefix_of(path);
    let mut builder = Builder::new();
    builder.prefix(&prefix);
    // The permissions of a usual file, less the umask.
    #[cfg(unix)]
    builder.permissions(<Permissions as std::os::unix::fs::PermissionsExt>::from_mode(0o666));
    loop {
        let file = builder.tempfile_in(folder_of(path))?;
        // Without a lock, no other process removes it.
        if file.as_file().lock().is_err() || file.path().exists() {
            return Ok(file);
        }
        // Another process has removed it before it was locked.
    }
}

/// As [`begin`], with permissions for the owner only.
///
/// # Errors
///
/// If the folder cannot be written to.
pub fn begin_private(path: &Path) -> io::Result<NamedTempFile> {
    Builder::new()
        .prefix(&prefix_of(path))
        .tempfile_in(folder_of(path))
}

/// Removes temporary files of `path` that a crash left. The caller must be its only writer.
///
/// # Errors
///
/// If the folder cannot be read, or one of them cannot be removed.
pub fn remove_unfinished(path: &Path) -> io::Result<()> {
    for_each_unfinished(path, |unfinished| fs::remove_file(unfinished))
}

/// Removes temporary files of `path` that a crash left, as far as it can. Others may write to `path`: what
/// they have begun with [`begin`] is not removed.
pub fn remove_abandoned(path: &Path) {
    // Each by itself: a file that cannot be removed does not keep the others.
    let _ = for_each_unfinished(path, |unfinished| {
        if let Ok(file) = OpenOptions::new().write(true).open(unfinished)
            && file.try_lock().is_ok()
        {
            // While it is locked: `begin` then notices that its file is gone.
            let _ = fs::remove_file(unfinished);
        }
        Ok(())
    });
}

fn for_each_unfinished(path: &Path, each: impl Fn(&Path) -> io::Result<()>) -> io::Result<()> {
    let prefix = prefix_of(path);
    for entry in fs::read_dir(folder_of(path))? {
        let entry = entry?;
        let name = entry.file_name();
        if name
            .as_encoded_bytes()
            .starts_with(prefix.as_encoded_bytes())
        {
            each(&entry.path())?;
        }
    }
    Ok(())
}

/// Syncs `file`, renames it to `path` and syncs the folder.
///
/// # Errors
///
/// If one of these fails, or `path` is a folder, a device or a pipe, which a renamed file would replace. Unless only the last did, a file that existed at `path` is as it was.
pub fn publish(file: NamedTempFile, path: &Path) -> io::Result<()> {
    if fs::metadata(path).is_ok_and(|it| !it.is_file()) {
        let problem = "it is a folder, a device or a pipe: name a file";
        return Err(io::Error::new(ErrorKind::InvalidInput, problem));
    }
    file.as_file().sync_all()?;
    file.persist(path).map_err(|error| error.error)?;
    sync_folder_of(path)
}

fn prefix_of(path: &Path) -> OsString {
    let mut prefix = OsString::from(PREFIX);
    prefix.push(path.file_name().unwrap_or_default());
    prefix.push("-");
    prefix
}

/// The name of a file is an entry of its folder, which is synced apart from the file. Some folders may
/// be written to but not read, and some file systems cannot sync one: the file is in its place then.
fn sync_folder_of(path: &Path) -> io::Result<()> {
    #[cfg(unix)]
    match File::open(folder_of(path)).and_then(|folder| folder.sync_all()) {
        Err(error) if !CANNOT_SYNC.contains(&error.kind()) => return Err(error),
        _ => {}
    }
    Ok(())
}

#[cfg(unix)]
const CANNOT_SYNC: [ErrorKind; 3] = [
    ErrorKind::PermissionDenied,
    ErrorKind::InvalidInput,
    ErrorKind::Unsupported,
];

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn an_unfinished_file_leaves_the_old_one_and_no_temporary_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.csv");
        fs::write(&path, "old").unwrap();
        let mut unfinished = begin(&path).unwrap();
        unfinished.write_all(b"ne").unwrap();
        drop(unfinished);
        assert_eq!(fs::read(&path).unwrap(), b"old");
        write(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_new_file_replaces_none() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("school.snapshot");
        write_new(&path, b"one").unwrap();
        let error = write_new(&path, b"two").unwrap_err();
        assert_eq!(error.kind(), ErrorKind::AlreadyExists);
        assert_eq!(fs::read(&path).unwrap(), b"one");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn what_is_no_file_is_not_replaced() {
        use std::os::unix::fs::{FileTypeExt, symlink};
        use std::os::unix::net::UnixListener;

        let folder = tempfile::tempdir().unwrap();
        let [socket, link] = ["socket", "link"].map(|name| folder.path().join(name));
        let _listener = UnixListener::bind(&socket).unwrap();
        symlink(&socket, &link).unwrap();
        for path in [&socket, &link] {
            let error = write(path, b"new").unwrap_err();
            assert!(error.to_string().contains("name a file"), "{error}");
        }
        assert!(fs::metadata(&link).unwrap().file_type().is_socket());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[test]
    fn only_unfinished_files_of_a_path_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let [path, other] = ["token", "token.old"].map(|name| folder.path().join(name));
        write(&path, b"new").unwrap();
        for path in [&path, &other] {
            // As after a crash.
            begin(path).unwrap().keep().unwrap();
        }
        remove_unfinished(&path).unwrap();
        let left = fs::read_dir(folder.path()).unwrap();
        let mut left: Vec<_> = left.map(|it| it.unwrap().file_name()).collect();
        left.sort();
        assert!(left[0].to_str().unwrap().starts_with(".jostle-token.old-"));
        assert_eq!(left[1..], ["token"]);
    }

    #[test]
    fn an_abandoned_file_is_removed_and_one_in_use_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let [path, other] = ["series", "series.old"].map(|name| folder.path().join(name));
        let mut in_use = begin(&path).unwrap();
        for path in [&path, &other] {
            // As after a crash.
            begin(path).unwrap().keep().unwrap();
        }
        remove_abandoned(&path);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
        in_use.write_all(b"new").unwrap();
        publish(in_use, &path).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        remove_abandoned(&other);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn a_private_file_is_for_its_owner_only() {
        use std::os::unix::fs::PermissionsExt;

        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("token");
        publish(begin_private(&path).unwrap(), &path).unwrap();
        let mode = fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
    }
}
