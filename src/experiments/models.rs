//! Experiments whose runs another version of the model executed: they remain readable, and no run is added.

use std::path::Path;

use jostle_experiment::{Folder, MODEL_VERSION};

use super::ExperimentManager;
use super::error::ExperimentError;

/// Returns the version of the model that began the experiment in a folder, if this program has another one.
pub(super) fn other_model(folder: &Path) -> Option<u32> {
    Folder::model_version(folder).filter(|version| *version != MODEL_VERSION)
}

impl ExperimentManager {
    /// The version of the model that executed the finished runs of an experiment, if it is another one; none
    /// if there is no such experiment.
    pub(super) fn other_model(&self, name: &str) -> Result<Option<u32>, ExperimentError> {
        match self.entry(name, |entry| entry.other_model) {
            Err(ExperimentError::Unknown(_)) => Ok(None),
            other => other,
        }
    }

    /// Checks that runs can be added to an experiment.
    pub(super) fn check_model(&self, name: &str) -> Result<(), ExperimentError> {
        match self.other_model(name)? {
            Some(theirs) => Err(ExperimentError::other_model(name, theirs)),
            None => Ok(()),
        }
    }
}
