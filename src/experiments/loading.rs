//! Loads the experiments of a data folder.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::sync::Arc;

use jostle_experiment::{EXPERIMENT, Files, Folder, MissingFiles, Plan};
use jostle_proto::{ExperimentPhase as Phase, keys};
use tracing::warn;

use super::error::ExperimentError;
use super::models::other_model;
use super::status::{Entry, Status};
use crate::jobs::JobDirectory;

/// The experiments in a folder that is not opened, and in which nothing changes, by name, each with its phase; a
/// running one is stored as queued.
pub fn phases(folder: &Path) -> io::Result<BTreeMap<String, Phase>> {
    let jobs = JobDirectory::<Status>::unopened(folder);
    let phase = |status: Option<Status>| status.map_or(Phase::Queued, |it| it.phase);
    match stored(&jobs) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(BTreeMap::new()),
        stored => Ok(stored?
            .map(|(name, status)| (name, phase(status)))
            .collect()),
    }
}

/// The names of the stored experiments, each with its status if that can be read.
pub(super) fn stored(
    jobs: &JobDirectory<Status>,
) -> io::Result<impl Iterator<Item = (String, Option<Status>)>> {
    let is_experiment =
        |name: &str| keys::is_name(name) && jobs.folder(name).join(EXPERIMENT).is_file();
    let listed = jobs.list()?.into_iter();
    let listed = listed.filter(move |(name, _)| is_experiment(name));
    Ok(listed.map(|(name, status)| (name, status.ok())))
}

/// Loads an experiment from its folder. Without a status a crash interrupted `submit`.
pub(super) fn load(name: &str, jobs: &JobDirectory<Status>, status: Option<Status>) -> Entry {
    let folder = &jobs.folder(name);
    let mut status = status.unwrap_or_else(|| Status::queued(u64::MAX >> 1));
    let mut loaded = None;
    let mut other_model =
        other_model(folder).filter(|_| !status.phase.is_over() || status.has_finished());
    if status.phase != Phase::Finished && status.phase != Phase::Queued {
        // A process that was killed left frames of runs that start again.
        let _ = Folder::sweep(folder);
    }
    if !status.phase.is_over() {
        let read = read_plan(name, folder).and_then(|plan| {
            let missing = Folder::missing_files(folder, &plan);
            let missing = missing.map_err(ExperimentError::unreadable)?;
            Ok((plan, missing))
        });
        match read {
            // One that has not finished a run starts from its beginning.
            Ok((plan, missing))
                if missing.has_runs()
                    && let Some(theirs) = other_model =>
            {
                status.plan(&plan, missing.finished);
                let error = ExperimentError::other_model(name, theirs);
                warn!(experiment = name, %error, "cannot resume");
                status.phase = Phase::Failed;
                status.message = Some(error.to_string());
                loaded = Some(Arc::new(plan));
            }
            Ok((plan, MissingFiles { finished, .. })) => {
                other_model = None;
                status.plan(&plan, finished);
                if status.pause_after_unclean_ends(name, finished)
                    && let Err(error) = jobs.write_status(name, &status)
                {
                    // The next start comes to the same conclusion.
                    warn!(experiment = name, %error, "failed to write the status file");
                }
                loaded = Some(Arc::new(plan));
            }
            Err(error) => {
                warn!(experiment = name, %error, "cannot resume");
                status.phase = Phase::Failed;
                status.message = Some(error.to_string());
            }
        }
    }
    Entry {
        status,
        plan: loaded,
        other_model,
        bytes: 0,
        need: None,
        execution: None,
        number_of_execution: 0,
    }
}

pub(super) fn read_plan(name: &str, folder: &Path) -> Result<Plan, ExperimentError> {
    let mut plan = Plan::stored(read_files(folder)?)?;
    name.clone_into(&mut plan.name);
    Ok(plan)
}

pub(super) fn read_files(folder: &Path) -> Result<Files, ExperimentError> {
    Files::stored(folder).map_err(ExperimentError::unreadable)
}
