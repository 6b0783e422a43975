//! Folders of jobs that outlive the daemon: one folder for each job, with its status in a file.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write as _};
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use rustix::fs::{CWD, RenameFlags, renameat_with};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// What the name of the spare file adds, which has the space for the next status: writing one needs no
/// free space on the disk, so a job can report that the disk is full.
const SPARE: &str = ".spare";

/// Both files are padded with spaces to a multiple of this, so that a longer status fits as well.
const BLOCK: usize = 4096;

/// The prefix of the folder of a job that is being deleted.
const DELETED: &str = ".gone-";

/// The status of a job, stored as JSON.
pub trait StatusFile: Serialize + DeserializeOwned {
    /// The file's name in the folder of the job.
    const NAME: &'static str;
}

/// The folder of all jobs of a kind.
pub struct JobDirectory<T> {
    root: PathBuf,
    status: PhantomData<fn() -> T>,
}

impl<T: StatusFile> JobDirectory<T> {
    /// Creates the folder if it does not exist, and completes interrupted deletions.
    pub fn open(root: &Path) -> io::Result<Self> {
        fs::create_dir_all(root)?;
        for entry in fs::read_dir(root)? {
            let path = entry?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            if name.starts_with(DELETED) {
                fs::remove_dir_all(&path)?;
            } else if path.is_dir() && !path.join(T::NAME).exists() {
                // Left by a request that a crash interrupted. Other files in it are kept.
                let _ = fs::remove_file(spare_path(&path.join(T::NAME)));
                let _ = fs::remove_dir(&path);
            }
        }
        Ok(Self::unopened(root))
    }

    /// The folder as it is: nothing is created or completed in it.
    pub fn unopened(root: &Path) -> Self {
        JobDirectory {
            root: root.to_owned(),
            status: PhantomData,
        }
    }

    /// The name of each job with its status, or why that cannot be read.
    pub fn list(&self) -> io::Result<Vec<(String, io::Result<T>)>> {
        let mut found = Vec::new();
        for entry in fs::read_dir(&self.root)? {
            let entry = entry?;
            if let Ok(name) = entry.file_name().into_string()
                && entry.path().is_dir()
            {
                let status = fs::read(entry.path().join(T::NAME));
                let status = status.and_then(|bytes| Ok(serde_json::from_slice(&bytes)?));
                found.push((name, status));
            }
        }
        Ok(found)
    }

    /// Whether a file or folder has this name.
    pub fn has(&self, name: &str) -> bool {
        fs::symlink_metadata(self.folder(name)).is_ok()
    }

    /// The folder of all jobs.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The folder of a job.
    pub fn folder(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    /// Writes the status of a job; it is durable on return. After an error the old status remains.
    pub fn write_status(&self, name: &str, status: &T) -> io::Result<()> {
        let folder = self.folder(name);
        let path = folder.join(T::NAME);
        let spare = spare_path(&path);
        let mut text = serde_json::to_vec(status)?;
        text.resize(text.len().next_multiple_of(BLOCK), b' ');
        overwrite(&spare, &text)?;
        if renameat_with(CWD, &spare, CWD, &path, RenameFlags::EXCHANGE).is_err() {
            // There is no status yet, or the file system does not support the flag.
            fs::rename(&spare, &path)?;
            overwrite(&spare, &text)?;
        }
        sync(&folder)?;
        sync(&self.root)
    }

    /// Removes a job with its folder. If that is interrupted, [`Self::open`] completes it.
    pub fn remove(&self, name: &str) -> io::Result<()> {
        let deleted = self.root.join(format!("{DELETED}{name}"));
        match fs::remove_dir_all(&deleted) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        fs::rename(self.folder(name), &deleted)?;
        sync(&self.root)?;
        fs::remove_dir_all(deleted)
    }
}

fn spare_path(path: &Path) -> PathBuf {
    let mut path = path.as_os_str().to_owned();
    path.push(SPARE);
    path.into()
}

/// Overwrites a file in place and syncs it.
fn overwrite(path: &Path, text: &[u8]) -> io::Result<()> {
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

/// Syncs a folder, so that the names in it are durable.
fn sync(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}
