//! The name under which all runs of an experiment are executed anew, beside those that another version of
//! the model executed.

use std::path::{Path, PathBuf};

use jostle_physics::model::MODEL_VERSION;

/// Returns the name of an experiment that is executed anew under this version of the model.
#[must_use]
pub fn anew(name: &str) -> String {
    format!("{name}-model{MODEL_VERSION}")
}

/// Returns the folder of results that are computed anew, beside `folder`.
#[must_use]
pub fn anew_beside(folder: &Path) -> PathBuf {
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    folder.with_file_name(anew(&name))
}
