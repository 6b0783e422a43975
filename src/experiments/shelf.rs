//! What a laboratory keeps on the disk: a folder for each experiment, and how it stands.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use jostle_atomic_file as atomic_file;
use serde::{Deserialize, Serialize};

use super::Phase;

/// The file that an experiment is made from, in its folder.
const EXPERIMENT: &str = "experiment.toml";

/// How it stands, beside what the engine keeps.
const STANDING: &str = "standing.json";

/// What the folder of a deleted experiment begins with until it is gone.
const GONE: &str = ".gone-";

/// How an experiment stands, as far as it outlives the daemon.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Standing {
    /// Its place in the order of submission.
    pub number: u64,
    /// What it is doing; one that is running is queued for whoever starts anew.
    pub phase: Phase,
    /// How many runs it has.
    #[serde(default)]
    pub runs: usize,
    /// How many are over.
    #[serde(default)]
    pub finished: usize,
    /// How many of them ended early.
    #[serde(default)]
    pub faulted: usize,
    /// The share of its work that is done.
    #[serde(default)]
    pub share: f64,
    /// How long it took so far.
    #[serde(default)]
    pub elapsed_secs: f64,
    /// Why it failed, or what is to be said of it.
    #[serde(default)]
    pub message: Option<String>,
}

/// The folder of all experiments.
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
            let entry = entry?;
            // Whoever deleted it was ended in the midst of it.
            if entry.file_name().to_string_lossy().starts_with(GONE) {
                fs::remove_dir_all(entry.path())?;
            }
        }
        Ok(Shelf(folder.to_owned()))
    }

    /// The names of all that is there, each with how it stands, if that is known.
    ///
    /// # Errors
    ///
    /// When the folder cannot be read.
    pub fn list(&self) -> io::Result<Vec<(String, Option<Standing>)>> {
        let mut found = Vec::new();
        for entry in fs::read_dir(&self.0)? {
            let entry = entry?;
            let Ok(name) = entry.file_name().into_string() else {
                continue;
            };
            if entry.path().join(EXPERIMENT).is_file() {
                let standing = fs::read(entry.path().join(STANDING)).ok();
                let standing = standing.and_then(|bytes| serde_json::from_slice(&bytes).ok());
                found.push((name, standing));
            }
        }
        found.sort_by(|(one, _), (other, _)| one.cmp(other));
        Ok(found)
    }

    /// The folder of an experiment.
    pub fn folder(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// The file that an experiment was made from.
    ///
    /// # Errors
    ///
    /// When it cannot be read.
    pub fn text(&self, name: &str) -> io::Result<String> {
        fs::read_to_string(self.folder(name).join(EXPERIMENT))
    }

    /// How many bytes there are of an experiment's finished runs: what is the same has not changed.
    pub fn extent(&self, name: &str) -> u64 {
        let list = fs::metadata(self.folder(name).join("runs.jsonl"));
        list.map_or(0, |list| list.len())
    }

    /// Writes down how an experiment stands. It is on the disk on return.
    ///
    /// # Errors
    ///
    /// When it cannot be written; it stands as before then.
    pub fn note(&self, name: &str, standing: &Standing) -> io::Result<()> {
        let folder = self.folder(name);
        let path = folder.join(STANDING);
        atomic_file::remove_unfinished(&path)?;
        atomic_file::write(&path, &serde_json::to_vec(standing)?)?;
        sync(&self.0)
    }

    /// Removes an experiment. Ended in the midst of it, it is gone as well.
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

/// Has the disk know the names in a folder.
fn sync(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}
