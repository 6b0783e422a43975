//! `backup.json`: the manifest of a finished backup.

use std::fs;
use std::io;
use std::path::{Component, Path};

use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;

use super::complete::Incomplete;
use super::error::BackupError;

/// Its file name in the folder of a backup.
pub const FILE: &str = "backup.json";

/// The format that this version writes, and the newest that it reads.
const FORMAT: u32 = 1;

/// The contents of a backup.
#[derive(Debug, Serialize, Deserialize)]
pub struct Manifest {
    /// The format of the backup.
    pub format: u32,
    /// The version of jostled that took it.
    pub version: String,
    /// The schema of the database.
    pub schema: i64,
    /// When the database was copied, in seconds since 1970.
    pub taken_unix_secs: u64,
    /// Number of swarms in the database.
    pub swarms: u64,
    /// The files, the database last.
    pub files: Vec<FileEntry>,
    /// The experiments and recordings that lack files, which is found out when the backup is taken or
    /// restored.
    #[serde(skip)]
    pub incomplete: Vec<Incomplete>,
}

/// One file of a backup.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileEntry {
    /// Its path relative to the backup and to the data folder, with `/`.
    pub path: String,
    /// Its length.
    pub bytes: u64,
    /// The BLAKE3 hash of its content, in hexadecimal digits.
    pub blake3: String,
}

/// The file: the manifest and the hash of its text, to detect damage.
#[derive(Serialize, Deserialize)]
struct Checked<'a> {
    blake3: String,
    #[serde(borrow)]
    backup: &'a RawValue,
}

impl Manifest {
    /// The manifest of a new backup.
    pub fn new(schema: i64, taken_unix_secs: u64, swarms: u64, files: Vec<FileEntry>) -> Self {
        Manifest {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            schema,
            taken_unix_secs,
            swarms,
            files,
            incomplete: Vec::new(),
        }
    }

    /// The total length of the files.
    pub fn bytes(&self) -> u64 {
        self.files.iter().map(|file| file.bytes).sum()
    }

    /// A summary as JSON.
    #[must_use]
    pub fn summary(&self, folder: &Path) -> serde_json::Value {
        serde_json::json!({
            "folder": folder,
            "version": self.version,
            "taken_unix_secs": self.taken_unix_secs,
            "swarms": self.swarms,
            "files": self.files.len(),
            "bytes": self.bytes(),
            "incomplete": self.incomplete,
        })
    }

    /// The text of the file. Does not fail: it holds nothing that JSON cannot.
    pub fn to_text(&self) -> io::Result<String> {
        let backup = serde_json::value::to_raw_value(self)?;
        let blake3 = blake3::hash(backup.get().as_bytes()).to_hex().to_string();
        Ok(serde_json::to_string(&Checked {
            blake3,
            backup: &backup,
        })?)
    }

    /// Reads the manifest of the backup in `folder`.
    ///
    /// # Errors
    ///
    /// [`BackupError::Unfinished`], [`BackupError::Damaged`], [`BackupError::Newer`] and
    /// [`BackupError::Io`].
    pub fn read(folder: &Path) -> Result<Self, BackupError> {
        let path = folder.join(FILE);
        let text = match fs::read(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == io::ErrorKind::NotFound && folder.is_dir() => {
                return Err(BackupError::Unfinished(folder.to_owned()));
            }
            Err(source) => return Err(BackupError::Io { path, source }),
        };
        let damaged = |problem: &str| BackupError::Damaged {
            path: path.clone(),
            problem: problem.to_owned(),
        };
        let checked: Checked<'_> = serde_json::from_slice(&text)
            .map_err(|error| damaged(&format!("it cannot be read ({error})")))?;
        let backup = checked.backup.get();
        if blake3::hash(backup.as_bytes()).to_hex().as_str() != checked.blake3 {
            return Err(damaged("its checksum differs"));
        }
        // A later format may have other fields.
        #[derive(Deserialize)]
        struct Format {
            format: u32,
        }
        let format: Format =
            serde_json::from_str(backup).map_err(|_| damaged("it has no format"))?;
        if format.format > FORMAT {
            return Err(BackupError::Newer {
                folder: folder.to_owned(),
                what: "format",
                found: i64::from(format.format),
                known: i64::from(FORMAT),
            });
        }
        let manifest: Manifest = serde_json::from_str(backup)
            .map_err(|error| damaged(&format!("it cannot be read ({error})")))?;
        match manifest.files.iter().find(|file| !is_below(&file.path)) {
            Some(file) => Err(damaged(&format!("invalid path {:?}", file.path))),
            None => Ok(manifest),
        }
    }
}

/// Whether a path stays in the folder that it is joined to.
fn is_below(path: &str) -> bool {
    let mut components = Path::new(path).components();
    !path.is_empty() && components.all(|it| matches!(it, Component::Normal(_)))
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    fn written(path: &str) -> (tempfile::TempDir, String) {
        let folder = tempfile::tempdir().unwrap();
        let file = FileEntry {
            path: path.to_owned(),
            bytes: 3,
            blake3: blake3::hash(b"abc").to_hex().to_string(),
        };
        let text = Manifest::new(1, 5, 2, vec![file]).to_text().unwrap();
        fs::write(folder.path().join(FILE), &text).unwrap();
        (folder, text)
    }

    #[test]
    fn a_manifest_round_trips_and_a_change_of_any_byte_is_detected() {
        let (folder, text) = written("recordings/a/part-0.mcap");
        let manifest = Manifest::read(folder.path()).unwrap();
        assert_eq!((manifest.swarms, manifest.bytes()), (2, 3));
        for index in 0..text.len() {
            let mut damaged = text.clone().into_bytes();
            damaged[index] ^= 1;
            fs::write(folder.path().join(FILE), &damaged).unwrap();
            let rejected = Manifest::read(folder.path()).unwrap_err();
            assert!(
                matches!(rejected, BackupError::Damaged { .. }),
                "{rejected}"
            );
        }
        fs::write(folder.path().join(FILE), &text[..text.len() / 2]).unwrap();
        let rejected = Manifest::read(folder.path()).unwrap_err();
        assert!(
            matches!(rejected, BackupError::Damaged { .. }),
            "{rejected}"
        );
    }

    #[test]
    fn a_path_out_of_the_folder_is_rejected() {
        for path in ["../lock", "/etc/passwd", "a/../../b", "", "."] {
            let (folder, _) = written(path);
            let rejected = Manifest::read(folder.path()).unwrap_err().to_string();
            assert!(rejected.contains("invalid path"), "{path}: {rejected}");
        }
    }

    #[test]
    fn a_newer_format_is_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let mut manifest = Manifest::new(1, 5, 2, Vec::new());
        manifest.format = 7;
        fs::write(folder.path().join(FILE), manifest.to_text().unwrap()).unwrap();
        let rejected = Manifest::read(folder.path()).unwrap_err().to_string();
        assert!(rejected.contains("format 7"), "{rejected}");
    }
}
