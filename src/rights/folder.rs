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

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use jostle_proto::{Credentials, Role};
use serde::{Deserialize, Serialize};

use crate::rights::{RightsError, secret};

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
}

/// What `people.json` says.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct People {
    /// Where people are to look for the daemon.
    pub endpoint: String,
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

    /// Who there is.
    ///
    /// # Errors
    ///
    /// [`RightsError`] when the file is not there or is none.
    pub fn people(&self) -> Result<People, RightsError> {
        let path = self.people_file();
        if !path.exists() {
            return Err(RightsError::Nothing(self.0.clone()));
        }
        read_json(&path)
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
    /// [`RightsError::File`].
    pub fn passwords(&self) -> Result<Vec<(String, String)>, RightsError> {
        let text = read(&self.passwords_file())?;
        let pairs = text.lines().filter_map(|line| line.split_once(':'));
        Ok(pairs
            .map(|(person, password)| (person.to_owned(), password.to_owned()))
            .collect())
    }

    /// Refuses secrets of the daemon that others can read.
    ///
    /// # Errors
    ///
    /// [`RightsError::Open`], or [`RightsError::File`] for one that is not there.
    pub fn check_secrecy(&self) -> Result<(), RightsError> {
        if !self.people_file().exists() {
            return Err(RightsError::Nothing(self.0.clone()));
        }
        let [_, key] = self.daemon();
        for path in [key, self.passwords_file()] {
            let metadata = fs::metadata(&path);
            let metadata = metadata.map_err(|error| at(&path, error))?;
            if metadata.permissions().mode() & 0o077 != 0 {
                return Err(RightsError::Open(path));
            }
        }
        Ok(())
    }

    /// Writes who there is, and their passwords.
    ///
    /// # Errors
    ///
    /// [`RightsError::File`].
    pub fn write_people(
        &self,
        people: &People,
        passwords: &[(String, String)],
    ) -> Result<(), RightsError> {
        let lines = passwords.iter();
        let lines: String = lines
            .map(|(person, password)| format!("{person}:{password}\n"))
            .collect();
        write(&self.passwords_file(), &lines)?;
        write_json(&self.people_file(), people)
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
