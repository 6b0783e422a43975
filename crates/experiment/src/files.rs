//! The files that an experiment consists of: its TOML, and the files that this names.
//!
//! A client reads them and sends their contents; a daemon never reads a path of a client. The folder
//! of an experiment's results has copies of them, under names of their own.

#[cfg(feature = "files")]
pub mod disk;
mod encoded;

use std::path::{Component, Path};

#[cfg(feature = "files")]
pub use self::disk::{EXPERIMENT, FilesError};
pub use self::encoded::EncodedFiles;

/// The name of the copy of the file of `points` there.
pub const POINTS: &str = "experiment.points.csv";

/// The name of the copy of the file of `setpoints` there.
pub const SET_POINTS: &str = "experiment.setpoints.csv";

/// The name of the copy of the snapshot of `start` there.
pub const START: &str = "experiment.start.snapshot";

/// The contents of an experiment's files. Equal contents are the same experiment.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Files {
    /// The text of the TOML.
    pub toml: String,
    /// The text of the CSV that `points` names.
    pub points: Option<String>,
    /// The contents of the snapshot that `start` names.
    pub start: Option<Vec<u8>>,
    /// The text of the CSV that `setpoints` names; none if `setpoints` is that text itself.
    pub setpoints: Option<String>,
}

/// Says in place of what is wrong within a file outside the folder of the experiment. An experiment that
/// someone else wrote may name any file that its reader can read: errors, which others may see, do not
/// repeat its content.
const HIDDEN: &str = "what is wrong is not shown, because the file is outside the folder of the \
                      experiment: copy it there, and name the copy";

/// Whether the name of a file is outside the folder of the experiment, as far as the name says.
fn is_outside(name: &str) -> bool {
    let path = Path::new(name);
    path.is_absolute() || path.components().any(|it| it == Component::ParentDir)
}

/// Returns the reason why the content of a file is rejected, as it may be shown.
pub fn shown(name: &str, reason: String) -> String {
    match is_outside(name) {
        true => HIDDEN.to_owned(),
        false => reason,
    }
}

/// Whether the value of `setpoints` is the text of the CSV, and not the name of one.
pub fn is_text(setpoints: &str) -> bool {
    setpoints.contains('\n')
}

impl From<&str> for Files {
    fn from(toml: &str) -> Self {
        Self {
            toml: toml.to_owned(),
            ..Self::default()
        }
    }
}
