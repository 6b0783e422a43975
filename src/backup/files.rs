//! Lists the files of a data folder that belong in a backup, and copies files with their hashes.

use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io;
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::path::Path;
use std::thread::sleep;
use std::time::Duration;

use super::error::{BackupError, io_error};

/// Bytes per read.
const BUFFER: usize = 1 << 20;

/// Reads of a JSON file that is being replaced, and the time between two.
const JSON_READS: u32 = 20;
const JSON_INTERVAL: Duration = Duration::from_millis(5);

/// The folders of a data folder that belong in a backup.
pub const FOLDERS: [&str; 2] = ["experiments", "recordings"];

/// More than the depth of the folders of experiments and recordings.
pub const MAX_DEPTH: usize = 8;

/// The extensions of incomplete files, which are renamed when they are complete. The daemon
/// rewrites those of a running recording or experiment.
const UNFINISHED: [&str; 4] = ["partial", "part", "new", "spare"];

/// The start of the name of a folder that is being deleted.
const DELETED: &str = ".gone-";

/// The name of a lock file.
const LOCK: &str = "lock";

/// Creates a folder that only its owner can access, and its parents.
pub fn make_folder(path: &Path) -> Result<(), BackupError> {
    let mut builder = DirBuilder::new();
    let made = builder.recursive(true).mode(0o700).create(path);
    made.map_err(io_error(path))
}

/// Syncs a folder, so that the names in it are durable.
pub fn sync_folder(path: &Path) -> Result<(), BackupError> {
    let synced = File::open(path).and_then(|folder| folder.sync_all());
    synced.map_err(io_error(path))
}

/// Which files of a folder are copied before which.
///
/// A status file is copied before the list that it counts, and the list before the files that it names:
/// what a copy names is then in the backup, and what was finished meanwhile is not named.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Rank {
    Status,
    List,
    Named,
}

/// Calls `each` with every file in `folder`, and below it to a `depth`, that belongs in a backup, by
/// its path relative to `folder`: in each folder `.json` first, then `.jsonl`, then other files, then
/// subfolders.
///
/// The files of a rank, and of a subfolder, are listed after `each` has returned for those before them.
/// What is deleted meanwhile is omitted.
pub fn for_each(
    folder: &Path,
    depth: usize,
    each: &mut impl FnMut(&Path) -> Result<(), BackupError>,
) -> Result<(), BackupError> {
    for_each_below(folder, Path::new(""), depth, each)
}

fn for_each_below(
    root: &Path,
    below: &Path,
    depth: usize,
    each: &mut impl FnMut(&Path) -> Result<(), BackupError>,
) -> Result<(), BackupError> {
    let folder = root.join(below);
    for rank in [Rank::Status, Rank::List, Rank::Named] {
        for (_, name) in list(&folder)?.files.iter().filter(|it| it.0 == rank) {
            each(&below.join(name))?;
        }
    }
    for name in list(&folder)?.folders.iter().filter(|_| depth > 0) {
        for_each_below(root, &below.join(name), depth - 1, each)?;
    }
    Ok(())
}

/// The names of the folders in `folder` that belong in a backup.
pub fn folders(folder: &Path) -> Result<Vec<String>, BackupError> {
    Ok(list(folder)?.folders)
}

/// What tells apart the folder of an experiment or a recording from a later one of the same name.
pub struct Identity {
    /// While a folder is open, no other folder gets its number.
    folder: File,
    /// The names of its status files.
    status: Vec<String>,
}

impl Identity {
    /// The identity of a folder; `None` if there is no such folder.
    pub fn of(folder: &Path) -> Result<Option<Self>, BackupError> {
        let opened = match File::open(folder) {
            Ok(opened) => opened,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(io_error(folder)(error)),
        };
        let files = list(folder)?.files.into_iter();
        let status = files.filter(|it| it.0 == Rank::Status);
        Ok(Some(Identity {
            folder: opened,
            status: status.map(|(_, name)| name).collect(),
        }))
    }

    /// Whether `folder` is still the same, with the same status files.
    pub fn is_of(&self, folder: &Path) -> Result<bool, BackupError> {
        let Some(now) = Identity::of(folder)? else {
            return Ok(false);
        };
        let number = |it: &Identity| it.folder.metadata().map(|it| (it.dev(), it.ino()));
        let [before, after] = [number(self), number(&now)].map(|it| it.map_err(io_error(folder)));
        Ok(before? == after? && self.status == now.status)
    }
}

/// The files and folders in a folder that belong in a backup, by name.
#[derive(Default)]
struct Listed {
    files: Vec<(Rank, String)>,
    folders: Vec<String>,
}

/// Lists a folder; empty if there is none.
fn list(folder: &Path) -> Result<Listed, BackupError> {
    let mut listed = Listed::default();
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(listed),
        Err(error) => return Err(io_error(folder)(error)),
    };
    for entry in entries {
        let path = entry.map_err(io_error(folder))?.path();
        let Some(name) = path.file_name().and_then(|name| name.to_str()) else {
            continue;
        };
        let extension = Path::new(name).extension().and_then(|it| it.to_str());
        let is_unfinished = name.starts_with(jostle_atomic_file::PREFIX)
            || extension.is_some_and(|it| UNFINISHED.contains(&it));
        let rank = match extension {
            Some("json") => Rank::Status,
            Some("jsonl") => Rank::List,
            _ => Rank::Named,
        };
        match fs::metadata(&path) {
            Ok(it) if it.is_dir() && name.starts_with(DELETED) => {}
            Ok(it) if it.is_dir() => listed.folders.push(name.to_owned()),
            Ok(it) if it.is_file() && name != LOCK && !is_unfinished => {
                listed.files.push((rank, name.to_owned()));
            }
            // Deleted meanwhile, or not a file of the daemon, such as a socket.
            _ => {}
        }
    }
    listed.files.sort_by(|one, other| one.1.cmp(&other.1));
    listed.folders.sort();
    Ok(listed)
}

/// Copies a file to a new one and returns its length and hash; `None` if it does not exist.
pub fn copy(from: &Path, to: &Path) -> Result<Option<(u64, String)>, BackupError> {
    let opened: io::Result<Box<dyn io::Read>> = match from.extension() {
        Some(json) if json == "json" => {
            read_json(from).map(|it| Box::new(io::Cursor::new(it)) as _)
        }
        _ => File::open(from).map(|file| Box::new(file) as _),
    };
    match opened {
        Ok(mut content) => write(to, &mut content).map(Some),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(io_error(from)(error)),
    }
}

/// Reads a JSON file that the daemon may be overwriting: retries until two reads return the same
/// JSON.
fn read_json(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = fs::read(path)?;
    for _ in 0..JSON_READS {
        let again = fs::read(path)?;
        let is_whole = serde_json::from_slice::<serde::de::IgnoredAny>(&again).is_ok();
        if is_whole && again == bytes {
            break;
        }
        bytes = again;
        sleep(JSON_INTERVAL);
    }
    Ok(bytes)
}

/// Creates a new file that only its owner can access. Fails if it exists.
pub fn create(path: &Path) -> Result<File, BackupError> {
    let mut options = OpenOptions::new();
    let options = options.write(true).create_new(true).mode(0o600);
    options.open(path).map_err(io_error(path))
}

/// Writes a new file and syncs it; returns its length and hash.
fn write(to: &Path, from: &mut impl io::Read) -> Result<(u64, String), BackupError> {
    let mut file = create(to)?;
    let written = copy_and_hash(from, &mut file).map_err(io_error(to))?;
    file.sync_all().map_err(io_error(to))?;
    Ok(written)
}

/// The length and hash of a file.
pub fn hash(path: &Path) -> Result<(u64, String), BackupError> {
    let hashed = File::open(path).and_then(|mut file| copy_and_hash(&mut file, &mut io::sink()));
    hashed.map_err(io_error(path))
}

/// Copies until the end of `from`, and returns length and hash.
fn copy_and_hash(from: &mut impl io::Read, to: &mut impl io::Write) -> io::Result<(u64, String)> {
    let mut hasher = blake3::Hasher::new();
    let (mut buffer, mut bytes) = (vec![0; BUFFER], 0);
    loop {
        let count = match from.read(&mut buffer) {
            Ok(0) => return Ok((bytes, hasher.finalize().to_hex().to_string())),
            Ok(count) => count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(error),
        };
        to.write_all(&buffer[..count])?;
        hasher.update(&buffer[..count]);
        bytes += count as u64;
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn unfinished_and_deleted_files_are_omitted_and_the_rest_is_in_order() {
        let root = tempfile::tempdir().unwrap();
        for path in [
            "lock/recording.json",
            "lock/recording.json.spare",
            "a/part-000000.mcap",
            "a/part-000001.mcap.partial",
            "a/recording.json",
            ".gone-b/recording.json",
            "part.part/x",
            "e/lock",
            "e/order/000000",
            "e/order/000001.part",
            "e/results.csv",
            "e/runs.jsonl",
            "e/standing.json",
            "e/.jostle-standing.json-x1",
        ] {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, "x").unwrap();
        }
        let mut found = Vec::new();
        for_each(root.path(), MAX_DEPTH, &mut |path| {
            found.push(path.to_str().unwrap().to_owned());
            Ok(())
        })
        .unwrap();
        assert_eq!(
            found,
            [
                "a/recording.json",
                "a/part-000000.mcap",
                "e/standing.json",
                "e/runs.jsonl",
                "e/results.csv",
                "e/order/000000",
                "lock/recording.json",
                "part.part/x",
            ]
        );
        let nothing = root.path().join("nothing");
        for_each(&nothing, MAX_DEPTH, &mut |path| {
            panic!("{}", path.display())
        })
        .unwrap();
    }

    #[test]
    fn what_is_finished_while_a_list_is_copied_is_listed_after_it() {
        let root = tempfile::tempdir().unwrap();
        let put = |name: &str| {
            let path = root.path().join("e").join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, "x").unwrap();
        };
        put("standing.json");
        let mut found = Vec::new();
        for_each(root.path(), MAX_DEPTH, &mut |path| {
            let path = path.to_str().unwrap().to_owned();
            match path.as_str() {
                "e/standing.json" => put("runs.jsonl"),
                "e/runs.jsonl" => {
                    put("part-0.mcap");
                    put("trajectories/1.parquet");
                }
                "e/part-0.mcap" => put("trajectories/2.parquet"),
                _ => {}
            }
            found.push(path);
            Ok(())
        })
        .unwrap();
        assert_eq!(
            found,
            [
                "e/standing.json",
                "e/runs.jsonl",
                "e/part-0.mcap",
                "e/trajectories/1.parquet",
                "e/trajectories/2.parquet",
            ]
        );
    }

    #[test]
    fn a_folder_that_replaces_another_or_gets_its_status_meanwhile_is_another() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("film");
        assert!(Identity::of(&folder).unwrap().is_none());
        fs::create_dir(&folder).unwrap();
        let empty = Identity::of(&folder).unwrap().unwrap();
        fs::write(folder.join("part-0.mcap"), "x").unwrap();
        assert!(empty.is_of(&folder).unwrap());
        fs::write(folder.join("recording.json"), "{}").unwrap();
        assert!(!empty.is_of(&folder).unwrap());
        let first = Identity::of(&folder).unwrap().unwrap();
        assert!(first.is_of(&folder).unwrap());
        for _ in 0..20 {
            fs::remove_dir_all(&folder).unwrap();
            assert!(!first.is_of(&folder).unwrap());
            fs::create_dir(&folder).unwrap();
            fs::write(folder.join("recording.json"), "{}").unwrap();
            assert!(!first.is_of(&folder).unwrap());
        }
    }

    #[test]
    fn a_copy_returns_its_hash_and_replaces_no_file() {
        let root = tempfile::tempdir().unwrap();
        let [from, to] = ["from", "to"].map(|name| root.path().join(name));
        let content = vec![7; BUFFER + 1];
        fs::write(&from, &content).unwrap();
        let (bytes, blake3) = copy(&from, &to).unwrap().unwrap();
        assert_eq!(bytes, content.len() as u64);
        assert_eq!(blake3, blake3::hash(&content).to_hex().to_string());
        assert_eq!(hash(&to).unwrap(), (bytes, blake3));
        assert_eq!(fs::read(&to).unwrap(), content);
        assert!(copy(&from, &to).is_err(), "it exists");
        assert_eq!(copy(&root.path().join("gone"), &to).unwrap(), None);
    }
}
