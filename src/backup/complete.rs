//! What experiments and recordings name and do not have. A backup of an earlier version, which listed
//! all files before it copied the first, may lack some.

use std::fs;
use std::path::Path;

use jostle_experiment::{Files, Folder, Plan};
use serde::Serialize;

use crate::{experiments, recording};

/// The number of runs that a reason names.
const MAX_NAMED: usize = 5;

/// An experiment or a recording that lacks files.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Incomplete {
    /// Its path in the data folder.
    pub path: String,
    /// Which files it lacks.
    pub reason: String,
}

/// The experiments and recordings in a data folder or a backup that lack files which their lists and
/// status files name.
pub fn incomplete(folder: &Path) -> Vec<Incomplete> {
    let [experiments, recordings] = super::files::FOLDERS;
    let mut found = Vec::new();
    for (kind, lost) in [
        (experiments, lost_runs as fn(&Path) -> Option<String>),
        (recordings, recording::lost_parts),
    ] {
        let entries = fs::read_dir(folder.join(kind)).into_iter().flatten();
        found.extend(entries.flatten().filter_map(|entry| {
            let reason = lost(&entry.path())?;
            let name = entry.file_name();
            Some(Incomplete {
                path: format!("{kind}/{}", name.to_string_lossy()),
                reason,
            })
        }));
    }
    found.sort_by(|one, other| one.path.cmp(&other.path));
    found
}

/// Which finished runs of an experiment lack files, or that its list of runs cannot be read. None if it
/// has no plan, which the daemon reports.
fn lost_runs(experiment: &Path) -> Option<String> {
    let mut plan = Plan::stored(Files::stored(experiment).ok()?).ok()?;
    plan.name = experiment.file_name()?.to_str()?.to_owned();
    let missing = match Folder::missing_files(experiment, &plan) {
        Ok(missing) if experiments::is_finished(experiment) => missing.of_finished(),
        Ok(missing) => missing,
        Err(error) => return Some(format!("its list of runs cannot be read: {error}")),
    };
    let lost = missing.runs.indices();
    let named = lost
        .iter()
        .take(MAX_NAMED)
        .map(|index| (index + 1).to_string());
    let named = named.collect::<Vec<_>>().join(", ");
    let others = match lost.len().saturating_sub(MAX_NAMED) {
        0 => String::new(),
        others => format!(" and {others} more"),
    };
    let all = missing.finished + lost.len();
    (!lost.is_empty()).then(|| {
        format!(
            "files of {} of its {all} finished runs (run {named}{others})",
            lost.len()
        )
    })
}
