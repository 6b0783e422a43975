//! Reads an experiment's files from a disk, and writes their copies.

use std::borrow::Cow;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use serde::Deserialize;
use thiserror::Error;

use super::{Files, POINTS, SET_POINTS, START, is_outside, is_text};

/// The name of the TOML in the folder of results.
pub const EXPERIMENT: &str = "experiment.toml";

/// The largest file that is read: a device has no end.
const MAX_BYTES: u64 = 250_000_000;

/// Why a file cannot be read.
#[derive(Debug, Error)]
#[error("failed to read {}: {source}", path.display())]
pub struct FilesError {
    /// The file.
    pub path: PathBuf,
    /// The system's error.
    pub source: io::Error,
}

/// The names of files in a TOML.
#[derive(Default, Deserialize)]
struct Named {
    points: Option<String>,
    start: Option<String>,
    setpoints: Option<String>,
}

impl Named {
    /// Returns the names; none if the TOML is invalid, which the plan reports.
    fn of(toml: &str) -> Self {
        let mut named: Self = toml::from_str(toml).unwrap_or_default();
        named.setpoints = named.setpoints.filter(|it| !is_text(it));
        named
    }
}

impl Files {
    /// Reads the TOML at `path` and the files that it names, relative to its folder.
    ///
    /// # Errors
    ///
    /// [`FilesError`].
    pub fn read(path: &Path) -> Result<Self, FilesError> {
        Self::with_named(read_text(path)?, path)
    }

    /// Adds the files that `toml` names, relative to the folder of `path`, from which it was read. If
    /// that is in a folder of results, its copies are read.
    ///
    /// # Errors
    ///
    /// [`FilesError`].
    pub fn with_named(toml: String, path: &Path) -> Result<Self, FilesError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let is_copy = path.file_name().is_some_and(|name| name == EXPERIMENT);
        let place = |named: &str, copy: &str| {
            let copy = folder.join(copy);
            match is_copy && copy.is_file() {
                true => copy,
                false => folder.join(named),
            }
        };
        let named = Named::of(&toml);
        let points = named.points.map(|it| read_text(&place(&it, POINTS)));
        let start = named.start.map(|it| read(&place(&it, START)));
        let setpoints = named.setpoints;
        let setpoints = setpoints.map(|it| read_text(&place(&it, SET_POINTS)));
        Ok(Self {
            points: points.transpose()?,
            start: start.transpose()?,
            setpoints: setpoints.transpose()?,
            toml,
        })
    }

    /// Returns a warning for each file that the TOML names outside its folder; `path` is that of the TOML.
    #[must_use]
    pub fn warnings(&self, path: &Path) -> Vec<String> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let is_copy = path.file_name().is_some_and(|name| name == EXPERIMENT);
        let named = Named::of(&self.toml);
        let files = [
            ("points", named.points, POINTS),
            ("start", named.start, START),
            ("setpoints", named.setpoints, SET_POINTS),
        ];
        let is_read = |copy: &str| !(is_copy && folder.join(copy).is_file());
        let outside = files.into_iter().filter_map(|(field, name, copy)| {
            let name = name.filter(|name| is_outside(name) && is_read(copy))?;
            Some(format!(
                "{field} = {name:?} is outside the folder of the experiment: its content becomes a part \
                 of the experiment, and another machine may not have it"
            ))
        });
        outside.collect()
    }

    /// Reads the copies in a folder of results.
    ///
    /// # Errors
    ///
    /// [`FilesError`].
    pub fn stored(folder: &Path) -> Result<Self, FilesError> {
        let toml = read_text(&folder.join(EXPERIMENT))?;
        let named = Named::of(&toml);
        let points = named.points.map(|_| read_text(&folder.join(POINTS)));
        let start = named.start.map(|_| read(&folder.join(START)));
        let setpoints = named.setpoints;
        let setpoints = setpoints.map(|_| read_text(&folder.join(SET_POINTS)));
        Ok(Self {
            points: points.transpose()?,
            start: start.transpose()?,
            setpoints: setpoints.transpose()?,
            toml,
        })
    }

    /// Writes the copies in a folder of results. The TOML is the last: with it they are complete.
    ///
    /// # Errors
    ///
    /// [`FilesError`].
    pub fn store(&self, folder: &Path) -> Result<(), FilesError> {
        let points = self.points.as_deref().map(str::as_bytes);
        let copies = [
            (POINTS, points),
            (SET_POINTS, self.setpoints.as_deref().map(str::as_bytes)),
            (START, self.start.as_deref()),
            (EXPERIMENT, Some(self.toml.as_bytes())),
        ];
        for (name, contents) in copies {
            let path = folder.join(name);
            if let Some(contents) = contents {
                jostle_atomic_file::write(&path, contents)
                    .map_err(|source| FilesError { path, source })?;
            }
        }
        Ok(())
    }
}

/// Reads a file of at most 250 MB.
pub fn read(path: &Path) -> Result<Vec<u8>, FilesError> {
    let read = || {
        let mut bytes = Vec::new();
        File::open(path)?
            .take(MAX_BYTES + 1)
            .read_to_end(&mut bytes)?;
        match bytes.len() as u64 > MAX_BYTES {
            true => Err(io::Error::new(
                io::ErrorKind::FileTooLarge,
                "it has more than 250 MB",
            )),
            false => Ok(bytes),
        }
    };
    read().map_err(|source| FilesError {
        path: path.to_owned(),
        source,
    })
}

fn read_text(path: &Path) -> Result<String, FilesError> {
    let bytes = read(path)?;
    match String::from_utf8_lossy(&bytes) {
        Cow::Borrowed(text) => Ok(text.to_owned()),
        Cow::Owned(_) => Err(FilesError {
            path: path.to_owned(),
            source: io::Error::new(
                io::ErrorKind::InvalidData,
                "it is not UTF-8: save it as UTF-8",
            ),
        }),
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_file_without_an_end_is_not_read_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("study.toml");
        std::fs::write(&path, "points = '/dev/zero'\n").unwrap();
        let error = Files::read(&path).unwrap_err().to_string();
        assert_eq!(error, "failed to read /dev/zero: it has more than 250 MB");
    }
}
