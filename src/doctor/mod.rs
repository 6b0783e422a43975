//! What this version of the program would do with what another one has stored, asked before an upgrade. It
//! reads a data folder and folders of results, and changes nothing in them; a daemon may use them.

mod results;
mod swarms;

use std::fs;
use std::path::{Path, PathBuf};

use jostle_physics::model::MODEL_VERSION;
use serde::Serialize;

use crate::app::data_folder;
use crate::backup::{self, BackupError};
pub use crate::doctor::results::Results;
use crate::doctor::results::{experiments, folders};
pub use crate::doctor::swarms::Swarm;
use crate::doctor::swarms::swarms;
use crate::store::{self, Store};

/// What was found in a data folder and in folders of results.
#[derive(Debug, Serialize)]
pub struct Report {
    /// The version of this program.
    pub version: &'static str,
    /// The version of its model.
    pub model_version: u32,
    /// The data folder; left out if only folders of results were examined.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub data_dir: Option<PathBuf>,
    /// The swarms in it, by name.
    pub swarms: Vec<Swarm>,
    /// The experiments in it, by name.
    pub experiments: Vec<Results>,
    /// The number of its recordings, which stay as they are.
    pub recordings: usize,
    /// The folders of results.
    pub folders: Vec<Results>,
    /// How many of each will be marked.
    pub marked: Marked,
    /// What cannot be read, or prevents the daemon from starting.
    pub problems: Vec<String>,
}

/// Numbers of what will be marked as of an earlier version of the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Marked {
    /// Swarms that go on from their newest checkpoint.
    pub swarms: usize,
    /// Experiments to which no run is added.
    pub experiments: usize,
    /// Folders to which no run is added.
    pub folders: usize,
}

/// Examines a data folder, if one is given, and folders with results.
pub fn examine(data: Option<&Path>, results: &[PathBuf]) -> Report {
    let (mut problems, mut data_dir) = (Vec::new(), DataFolder::default());
    if let Some(data) = data {
        data_dir = DataFolder::read(data, &mut problems);
    }
    let folders = folders(results, &mut problems);
    let count = |results: &[Results]| results.iter().filter(|it| it.marked).count();
    let of_swarms = data_dir.swarms.iter().filter_map(Swarm::problem);
    let of_results = data_dir.experiments.iter().chain(&folders);
    problems.extend(of_swarms.chain(of_results.filter_map(Results::problem)));
    Report {
        version: env!("CARGO_PKG_VERSION"),
        model_version: MODEL_VERSION,
        data_dir: data.map(Path::to_owned),
        marked: Marked {
            swarms: data_dir.swarms.iter().filter(|it| it.marked).count(),
            experiments: count(&data_dir.experiments),
            folders: count(&folders),
        },
        swarms: data_dir.swarms,
        experiments: data_dir.experiments,
        recordings: data_dir.recordings,
        folders,
        problems,
    }
}

/// What is in a data folder.
#[derive(Default)]
struct DataFolder {
    swarms: Vec<Swarm>,
    experiments: Vec<Results>,
    recordings: usize,
}

impl DataFolder {
    fn read(data: &Path, problems: &mut Vec<String>) -> Self {
        let read = open(data).and_then(|store| swarms(&store).map_err(|it| it.to_string()));
        let swarms = match read {
            Ok(swarms) => swarms,
            // The daemon does not start: nothing will be done with the folders either.
            Err(problem) => {
                problems.push(problem);
                return Self::default();
            }
        };
        let [experiments, recordings] = backup::FOLDERS.map(|name| data.join(name));
        Self {
            swarms,
            experiments: self::experiments(&experiments, problems),
            recordings: self::recordings(&recordings),
        }
    }
}

/// Opens the store of a data folder, if a daemon would start with it.
fn open(data: &Path) -> Result<Store, String> {
    data_folder::check(data).map_err(|error| error.to_string())?;
    if !data.join(store::RESTORING).exists() {
        backup::check_database(data).map_err(|error| error.to_string())?;
        if !is_data_folder(data) {
            return Err(BackupError::NoData(data.to_owned()).to_string());
        }
    }
    Store::examine(data).map_err(|error| error.to_string())
}

/// Whether a folder has a database.
pub fn is_data_folder(folder: &Path) -> bool {
    data_folder::has(folder, store::FILE)
}

/// The number of recordings.
fn recordings(folder: &Path) -> usize {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries
        .filter(|entry| {
            let is_hidden = entry.file_name().as_encoded_bytes().starts_with(b".");
            !is_hidden && entry.path().is_dir()
        })
        .count()
}
