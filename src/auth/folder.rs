//! The folder that `jostled auth init` creates: its files, and how they are read and written.
//!
//! ```text
//! ca.pem  ca-key.pem          the private certificate authority
//! daemon.pem  daemon-key.pem  the daemon's own certificate
//! people.json                 the users: name, role, hash of the token; the addresses of the daemon
//! passwords                   the passwords of zenoh sessions, as zenoh reads them
//! jostled.toml                settings to start with: `jostled --config`
//! people/NAME/                the folder to hand to a user
//! ```

use std::fs::{self, File};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use jostle_proto::{Credentials, Role};
use rustix::process::geteuid;
use serde::{Deserialize, Serialize};

use crate::auth::{AuthError, secret};

/// A user in `people.json`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UserEntry {
    /// Their name.
    pub person: String,
    /// Their role.
    pub role: Role,
    /// BLAKE3 of their token, in hexadecimal.
    pub token_hash: String,
    /// The last day of their certificate, as `2029-02-24`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until: Option<String>,
}

/// The content of `people.json`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PeopleFile {
    /// The endpoint to which clients connect.
    pub endpoint: String,
    /// The URL of its page, if it serves HTTP. Older files do not have it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub page: Option<String>,
    /// The names by which other machines reach the daemon. Older files do not have them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hosts: Option<Vec<String>>,
    /// The last day of the daemon's certificate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until: Option<String>,
    /// The users by name.
    pub people: Vec<UserEntry>,
}

/// The folder with the users and their secrets.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Folder {
    path: PathBuf,
    settings: Option<PathBuf>,
}

impl Folder {
    /// The folder at `path`, which need not exist.
    pub fn new(path: PathBuf) -> Self {
        Folder {
            path,
            settings: None,
        }
    }

    /// The same folder, of a daemon that reads its settings from this file.
    #[must_use]
    pub fn with_settings(self, file: PathBuf) -> Self {
        Folder {
            settings: Some(file),
            ..self
        }
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The certificate authority's certificate and key.
    pub fn authority(&self) -> [PathBuf; 2] {
        [self.path.join("ca.pem"), self.path.join("ca-key.pem")]
    }

    /// The daemon's certificate and key.
    pub fn daemon(&self) -> [PathBuf; 2] {
        [
            self.path.join("daemon.pem"),
            self.path.join("daemon-key.pem"),
        ]
    }

    /// Names and passwords, as zenoh reads them.
    pub fn passwords_file(&self) -> PathBuf {
        self.path.join("passwords")
    }

    /// The file with the users.
    pub fn people_file(&self) -> PathBuf {
        self.path.join("people.json")
    }

    /// The settings of the daemon.
    pub fn settings_file(&self) -> PathBuf {
        let given = self.settings.clone();
        given.unwrap_or_else(|| self.path.join("jostled.toml"))
    }

    /// Writes the settings of the daemon. A file outside the folder keeps its owner and permissions.
    pub fn write_settings(&self, text: &str) -> Result<(), AuthError> {
        let path = self.settings_file();
        match self.settings {
            Some(_) => secret::replace(&path, text).map_err(|error| file_error(&path, error)),
            None => write(&path, text),
        }
    }

    /// The folder to hand to a user.
    pub fn person_folder(&self, person: &str) -> PathBuf {
        self.path.join("people").join(person)
    }

    /// The users whose folders have not been moved away.
    pub fn user_folders(&self) -> Result<Vec<String>, AuthError> {
        let path = self.path.join("people");
        if matches!(path.try_exists(), Ok(false)) {
            return Ok(Vec::new());
        }
        let entries = fs::read_dir(&path).map_err(|error| file_error(&path, error))?;
        let names = entries.map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned()));
        names
            .collect::<std::io::Result<_>>()
            .map_err(|error| file_error(&path, error))
    }

    /// Locks the folder against concurrent changes.
    pub fn lock(&self) -> Result<File, AuthError> {
        let folder = File::open(&self.path).map_err(|error| file_error(&self.path, error))?;
        folder
            .lock()
            .map_err(|error| file_error(&self.path, error))?;
        Ok(folder)
    }

    /// Whether it has been created.
    pub fn exists(&self) -> Result<bool, AuthError> {
        let path = self.people_file();
        path.try_exists().map_err(|error| file_error(&path, error))
    }

    fn existing_people_file(&self) -> Result<PathBuf, AuthError> {
        match self.exists()? {
            true => Ok(self.people_file()),
            false => Err(AuthError::NoUsers(self.path.clone())),
        }
    }

    /// The users and the addresses of the daemon.
    pub fn people(&self) -> Result<PeopleFile, AuthError> {
        read_json(&self.existing_people_file()?)
    }

    /// The secrets of a user whose folder has not been moved away.
    pub fn credentials(&self, person: &str) -> Result<Credentials, AuthError> {
        read_json(&self.person_folder(person).join(Credentials::FILE))
    }

    /// The passwords, as pairs of name and password.
    pub fn passwords(&self) -> Result<Vec<(String, String)>, AuthError> {
        let path = self.passwords_file();
        let text = read(&path)?;
        let wrong = || AuthError::Content {
            path: path.clone(),
            problem: "has a line that is not NAME:PASSWORD".into(),
        };
        let pairs = text.lines().map(|line| match line.split_once(':') {
            Some((person, password)) if !person.is_empty() && !password.is_empty() => {
                Ok((person.to_owned(), password.to_owned()))
            }
            _ => Err(wrong()),
        });
        pairs.collect()
    }

    /// Rejects files that other users can write, and secrets that other users can read.
    pub fn check(&self) -> Result<(), AuthError> {
        let people = self.existing_people_file()?;
        let ([authority, authority_key], [certificate, key]) = (self.authority(), self.daemon());
        for path in [&authority, &certificate, &key] {
            if matches!(path.try_exists(), Ok(false)) {
                return Err(AuthError::Missing(path.clone()));
            }
        }
        for path in [&self.path, &people, &authority, &certificate] {
            check_owner(path)?;
        }
        let is_here = authority_key.try_exists().unwrap_or(true);
        let authority_key = is_here.then_some(authority_key);
        for path in [key, self.passwords_file()]
            .into_iter()
            .chain(authority_key)
        {
            if check_owner(&path)? & 0o044 != 0 {
                return Err(AuthError::Readable(path));
            }
        }
        Ok(())
    }

    /// Rejects a folder or a `people.json` that other users can write.
    pub fn check_people(&self) -> Result<(), AuthError> {
        check_owner(&self.path)?;
        check_owner(&self.existing_people_file()?).map(drop)
    }

    /// Rejects a folder that other users can write. Root may change the folder of a daemon that
    /// runs as another user.
    pub fn check_own(&self) -> Result<(), AuthError> {
        let checked = match geteuid().is_root() {
            true => check_mode(&self.path),
            false => check_owner(&self.path),
        };
        checked.map(drop)
    }

    /// Writes the users.
    pub fn write_people(&self, people: &PeopleFile) -> Result<(), AuthError> {
        write_json(&self.people_file(), people)
    }

    /// Writes the passwords.
    pub fn write_passwords(&self, passwords: &[(String, String)]) -> Result<(), AuthError> {
        let lines = passwords.iter();
        let lines: String = lines
            .map(|(person, password)| format!("{person}:{password}\n"))
            .collect();
        write(&self.passwords_file(), &lines)
    }
}

/// Checks that a file belongs to the present user or root, and that only its owner can write it.
/// Returns its mode.
fn check_owner(path: &Path) -> Result<u32, AuthError> {
    let metadata = fs::metadata(path).map_err(|error| file_error(path, error))?;
    let own = [0, geteuid().as_raw()];
    if !own.contains(&metadata.uid()) {
        return Err(AuthError::Foreign(path.to_owned()));
    }
    check_mode(path)
}

/// Checks that only its owner can write a file. Returns its mode.
fn check_mode(path: &Path) -> Result<u32, AuthError> {
    let mode = fs::metadata(path)
        .map_err(|error| file_error(path, error))?
        .mode();
    match mode & 0o022 {
        0 => Ok(mode),
        _ => Err(AuthError::Writable(path.to_owned())),
    }
}

pub(super) fn read(path: &Path) -> Result<String, AuthError> {
    fs::read_to_string(path).map_err(|error| file_error(path, error))
}

/// Writes a file that only its owner can read.
pub(super) fn write(path: &Path, text: &str) -> Result<(), AuthError> {
    secret::write(path, text).map_err(|error| file_error(path, error))
}

/// Writes a value as JSON that only its owner can read.
pub(super) fn write_json<T: Serialize + ?Sized>(path: &Path, value: &T) -> Result<(), AuthError> {
    let text = serde_json::to_string_pretty(value);
    let text = text.map_err(|error| file_error(path, error.into()))?;
    write(path, &format!("{text}\n"))
}

/// An error that names `path`.
pub(super) fn file_error(path: &Path, error: std::io::Error) -> AuthError {
    AuthError::File {
        path: path.to_owned(),
        error,
    }
}

fn read_json<T: for<'de> Deserialize<'de>>(path: &Path) -> Result<T, AuthError> {
    serde_json::from_str(&read(path)?).map_err(|error| AuthError::Content {
        path: path.to_owned(),
        problem: error.to_string(),
    })
}
