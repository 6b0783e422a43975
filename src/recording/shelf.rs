//! What the daemon keeps of its recordings on the disk: a folder for each, and how it stands.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

use rustix::fs::{CWD, RenameFlags, renameat_with};
use serde::{Deserialize, Serialize};

use super::{Format, Phase};

/// How it stands, in its folder.
const STANDING: &str = "recording.json";

/// How it stood before, beside it: what comes next is written over it, and takes its place. So there
/// is room to write down that a recording has failed, where that is for want of room.
const SPARE: &str = "recording.json.spare";

/// What both have bytes for, as spaces where less is said.
const ROOM: usize = 4096;

/// What the folder of a deleted recording begins with until it is gone.
const GONE: &str = ".gone-";

/// How a recording stands, as far as it outlives the daemon. Of one that goes on its files tell
/// how much there is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Standing {
    /// The swarm.
    pub swarm: String,
    /// How it is written.
    pub format: Format,
    /// The steps of its states are multiples of this. An earlier version left it out for all states
    /// that were published.
    pub every: Option<u64>,
    /// Whether states are left out while the disk is behind; otherwise the swarm waits.
    #[serde(default)]
    pub drop_when_behind: bool,
    /// The bytes from which on it ends.
    #[serde(default)]
    pub max_bytes: Option<u64>,
    /// How many more steps are to be recorded, if there is an end.
    #[serde(default)]
    pub steps_left: Option<u64>,
    /// Whether a client that fetches it deletes it.
    #[serde(default)]
    pub temporary: bool,
    /// What it is doing.
    pub phase: Phase,
    /// Why it ended or failed.
    pub reason: Option<String>,
    /// How many frames there are.
    pub frames: u64,
    /// How many were missed.
    pub missed: u64,
    /// How many files are whole.
    pub parts: u64,
    /// Their bytes.
    pub bytes: u64,
    /// When it began.
    pub began_unix_secs: u64,
}

/// The folder of all recordings.
#[derive(Clone, Debug)]
pub struct Shelf(PathBuf);

impl Shelf {
    /// The shelf in a folder, which is made.
    ///
    /// # Errors
    ///
    /// When it cannot be made or read.
    pub fn open(folder: &Path) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        for entry in fs::read_dir(folder)? {
            let path = entry?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            // Whoever deleted it was ended in the midst of it.
            if name.starts_with(GONE) {
                fs::remove_dir_all(&path)?;
            } else if path.is_dir() && !path.join(STANDING).exists() {
                // Whoever began it was, and got no answer. Anything else in it is somebody's.
                let _ = fs::remove_file(path.join(SPARE));
                let _ = fs::remove_dir(&path);
            }
        }
        Ok(Shelf(folder.to_owned()))
    }

    /// The names of all that is there, each with how it stands, or why that is not known.
    ///
    /// # Errors
    ///
    /// When the folder cannot be read.
    pub fn list(&self) -> io::Result<Vec<(String, io::Result<Standing>)>> {
        let mut found = Vec::new();
        for entry in fs::read_dir(&self.0)? {
            let entry = entry?;
            if let Ok(name) = entry.file_name().into_string()
                && entry.path().is_dir()
            {
                let standing = fs::read(entry.path().join(STANDING));
                let standing = standing.and_then(|bytes| Ok(serde_json::from_slice(&bytes)?));
                found.push((name, standing));
            }
        }
        Ok(found)
    }

    /// Whether there is something of that name.
    pub fn has(&self, name: &str) -> bool {
        fs::symlink_metadata(self.folder(name)).is_ok()
    }

    /// The folder of a recording.
    pub fn folder(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// Writes down how a recording stands. It is on the disk on return, and but for the first time it
    /// takes no more room, where files are written in place.
    ///
    /// # Errors
    ///
    /// When it cannot be written; it stands as before then.
    pub fn note(&self, name: &str, standing: &Standing) -> io::Result<()> {
        let folder = self.folder(name);
        let (there, spare) = (folder.join(STANDING), folder.join(SPARE));
        let mut text = serde_json::to_vec(standing)?;
        text.resize(text.len().next_multiple_of(ROOM), b' ');
        write_over(&spare, &text)?;
        if renameat_with(CWD, &spare, CWD, &there, RenameFlags::EXCHANGE).is_err() {
            // There is none yet, or the file system cannot.
            fs::rename(&spare, &there)?;
            write_over(&spare, &text)?;
        }
        sync(&folder)?;
        sync(&self.0)
    }

    /// Removes a recording. Ended in the midst of it, it is gone as well.
    ///
    /// # Errors
    ///
    /// When it cannot be removed.
    pub fn remove(&self, name: &str) -> io::Result<()> {
        let gone = self.0.join(format!("{GONE}{name}"));
        match fs::remove_dir_all(&gone) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        fs::rename(self.folder(name), &gone)?;
        sync(&self.0)?;
        fs::remove_dir_all(gone)
    }
}

/// How long a file is, and what it holds from an offset on, at most so much.
///
/// # Errors
///
/// When it cannot be read.
pub fn piece(path: &Path, offset: u64, most: u64) -> io::Result<(u64, Vec<u8>)> {
    let mut file = File::open(path)?;
    let (length, mut bytes) = (file.metadata()?.len(), Vec::new());
    if offset < length {
        file.seek(SeekFrom::Start(offset))?;
        file.take(most).read_to_end(&mut bytes)?;
    }
    Ok((length, bytes))
}

/// Writes over what a file holds, where it is; it is on the disk on return.
fn write_over(path: &Path, text: &[u8]) -> io::Result<()> {
    let mut options = OpenOptions::new();
    let mut file = options
        .write(true)
        .create(true)
        .truncate(false)
        .open(path)?;
    file.write_all(text)?;
    file.set_len(text.len() as u64)?;
    file.sync_all()
}

/// Has the disk know the names in a folder.
fn sync(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}
