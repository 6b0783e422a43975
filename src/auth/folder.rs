//! The folder that `jostled auth init` makes: what is in it, and how it is read.
//!
//! ```text
//! ca.pem  ca-key.pem          the private certificate authority
//! daemon.pem  daemon-key.pem  the daemon's own certificate
//! people.json                 who there is: name, role, hash of the token; where the daemon is reached
//! passwords                   what sessions are opened with, as zenoh reads it
//! jostled.toml                settings to begin from: `jostled --config`
//! people/NAME/                what is handed to a person
//! ```

use std::fs::{self, File};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use jostle_proto::{Credentials, Role};
use rustix::process::geteuid;
use serde::{Deserialize, Serialize};

use crate::auth::{RightsError, secret};

/// A person as `people.json` has them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// Their name.
    pub person: String,
    /// What they are.
    pub role: Role,
    /// BLAKE3 of their token, in hexadecimal.
    pub token_hash: String,
    /// The last day of their certificate, as `2029-02-24`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until: Option<String>,
}

/// What `people.json` says.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct People {
    /// Where people are to look for the daemon.
    pub endpoint: String,
    /// Where they find its page, if it serves HTTP. Older files do not have it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub page: Option<String>,
    /// The names by which other machines reach the daemon. Older files do not have them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hosts: Option<Vec<String>>,
    /// The last day of the daemon's certificate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until: Option<String>,
    /// Everybody, by name.
    pub people: Vec<Entry>,
}

/// Where people's rights and secrets are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Folder(PathBuf);

impl Folder {
    /// The folder at `path`, which may not be there yet.
    pub fn at(path: PathBuf) -> Self {
        Folder(path)
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// The certificate authority's certificate and key.
    pub fn authority(&self) -> [PathBuf; 2] {
        [self.0.join("ca.pem"), self.0.join("ca-key.pem")]
    }

    /// The daemon's certificate and key.
    pub fn daemon(&self) -> [PathBuf; 2] {
        [self.0.join("daemon.pem"), self.0.join("daemon-key.pem")]
    }

    /// Names and passwords, as zenoh reads them.
    pub fn passwords_file(&self) -> PathBuf {
        self.0.join("passwords")
    }

    /// Who there is.
    pub fn people_file(&self) -> PathBuf {
        self.0.join("people.json")
    }

    /// Settings to begin from.
    pub fn settings_file(&self) -> PathBuf {
        self.0.join("jostled.toml")
    }

    /// What is handed to a person.
    pub fn of(&self, person: &str) -> PathBuf {
        self.0.join("people").join(person)
    }

    /// Whose folders are here.
    ///
    /// # Errors
    ///
    /// [`RightsError::File`] when one may not look.
    pub fn handed(&self) -> Result<Vec<String>, RightsError> {
        let path = self.0.join("people");
        if matches!(path.try_exists(), Ok(false)) {
            return Ok(Vec::new());
        }
        let entries = fs::read_dir(&path).map_err(|error| at(&path, error))?;
        let names = entries.map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned()));
        names
            .collect::<std::io::Result<_>>()
            .map_err(|error| at(&path, error))
    }

    /// Keeps others from changing it meanwhile; waits for those who do.
    ///
    /// # Errors
    ///
    /// [`RightsError::File`] when it is not there.
    pub fn hold(&self) -> Result<File, RightsError> {
        let folder = File::open(&self.0).map_err(|error| at(&self.0, error))?;
        folder.lock().map_err(|error| at(&self.0, error))?;
        Ok(folder)
    }

    /// Whether it has people, or is to have some.
    ///
    /// # Errors
    ///
    /// [`RightsError::File`] when one may not look.
    pub fn is_made(&self) -> Result<bool, RightsError> {
        let path = self.people_file();
        path.try_exists().map_err(|error| at(&path, error))
    }

    /// Who there is.
    ///
    /// # Errors
    ///
    /// [`RightsError`] when the file is not there or is none.
    pub fn people(&self) -> Result<People, RightsError> {
        match self.is_made()? {
            true => read_json(&self.people_file()),
            false => Err(RightsError::Nothing(self.0.clone())),
        }
    }

    /// A person's own secrets, while they lie here.
    ///
    /// # Errors
    ///
    /// [`RightsError`] when there are none.
    pub fn credentials(&self, person: &str) -> Result<Credentials, RightsError> {
        read_json(&self.of(person).join(Credentials::FILE))
    }

    /// The passwords, as pairs of name and password.
    ///
    /// # Errors
    ///
    /// [`RightsError`] when the file is not there or is none.
    pub fn passwords(&self) -> Result<Vec<(String, String)>, RightsError> {
        let path = self.passwords_file();
        let text = read(&path)?;
        let wrong = || RightsError::Content {
            path: path.clone(),
            problem: "has a line that is no NAME:PASSWORD".into(),
        };
        let pairs = text.lines().map(|line| match line.split_once(':') {
            Some((person, password)) if !person.is_empty() && !password.is_empty() => {
                Ok((person.to_owned(), password.to_owned()))
            }
            _ => Err(wrong()),
        });
        pairs.collect()
    }

    /// Refuses what others can change, and secrets that others can read.
    ///
    /// # Errors
    ///
    /// [`RightsError`], with the remedy.
    pub fn check(&self) -> Result<(), RightsError> {
        if !self.is_made()? {
            return Err(RightsError::Nothing(self.0.clone()));
        }
        let ([authority, authority_key], [certificate, key]) = (self.authority(), self.daemon());
        let needed = [&authority, &certificate, &key];
        if let Some(missing) = needed
            .into_iter()
            .find(|it| matches!(it.try_exists(), Ok(false)))
        {
            return Err(RightsError::Missing(missing.clone()));
        }
        for path in [&self.0, &self.people_file(), &authority, &certificate] {
            check_owner(path)?;
        }
        let is_here = authority_key.try_exists().unwrap_or(true);
        let authority_key = is_here.then_some(authority_key);
        for path in [key, self.passwords_file()]
            .into_iter()
            .chain(authority_key)
        {
            if check_owner(&path)? & 0o044 != 0 {
                return Err(RightsError::Open(path));
            }
        }
        Ok(())
    }

    /// Refuses a folder or a `people.json` that others can change.
    ///
    /// # Errors
    ///
    /// [`RightsError`], with the remedy.
    pub fn check_people(&self) -> Result<(), RightsError> {
        check_owner(&self.0)?;
        match self.is_made()? {
            true => check_owner(&self.people_file()).map(drop),
            false => Err(RightsError::Nothing(self.0.clone())),
        }
    }

    /// Rejects a folder that other users can write. Root may change the folder of a daemon that
    /// runs as another user.
    ///
    /// # Errors
    ///
    /// [`RightsError`], with the remedy.
    pub fn check_own(&self) -> Result<(), RightsError> {
        let checked = match geteuid().is_root() {
            true => check_mode(&self.0),
            false => check_owner(&self.0),
        };
        checked.map(drop)
    }

    /// Writes who there is.
    ///
    /// # Errors
    ///
    /// [`RightsError::File`].
    pub fn write_people(&self, people: &People) -> Result<(), RightsError> {
        write_json(&self.people_file(), people)
    }

    /// Writes the passwords.
    ///
    /// # Errors
    ///
    /// [`RightsError::File`].
    pub fn write_passwords(&self, passwords: &[(String, String)]) -> Result<(), RightsError> {
        let lines = passwords.iter();
        let lines: String = lines
            .map(|(person, password)| format!("{person}:{password}\n"))
            .collect();
        write(&self.passwords_file(), &lines)
    }
}

/// The mode of what only its owner can change, and that is whoever reads it, or root.
fn check_owner(path: &Path) -> Result<u32, RightsError> {
    let metadata = fs::metadata(path).map_err(|error| at(path, error))?;
    let own = [0, geteuid().as_raw()];
    if !own.contains(&metadata.uid()) {
        return Err(RightsError::Foreign(path.to_owned()));
    }
    check_mode(path)
}

/// The mode of what only its owner can change.
fn check_mode(path: &Path) -> Result<u32, RightsError> {
    let mode = fs::metadata(path).map_err(|error| at(path, error))?.mode();
    match mode & 0o022 {
        0 => Ok(mode),
        _ => Err(RightsError::Changeable(path.to_owned())),
    }
}

/// Reads a file.
pub(super) fn read(path: &Path) -> Result<String, RightsError> {
    fs::read_to_string(path).map_err(|error| at(path, error))
}

/// Writes a file for nobody else to read.
pub(super) fn write(path: &Path, text: &str) -> Result<(), RightsError> {
    secret::write(path, text).map_err(|error| at(path, error))
}

/// Writes a value as JSON for nobody else to read.
pub(super) fn write_json<T: Serialize + ?Sized>(path: &Path, value: &T) -> Result<(), RightsError> {
    let text = serde_json::to_string_pretty(value);
    let text = text.map_err(|error| at(path, error.into()))?;
    write(path, &format!("{text}\n"))
}

/// What the system says of a file.
pub(super) fn at(path: &Path, error: std::io::Error) -> RightsError {
    RightsError::File {
        path: path.to_owned(),
        error,
    }
}

fn read_json<T: for<'de> Deserialize<'de>>(path: &Path) -> Result<T, RightsError> {
    serde_json::from_str(&read(path)?).map_err(|error| RightsError::Content {
        path: path.to_owned(),
        problem: error.to_string(),
    })
}
