//! Finds the finished experiments of which files are missing, such as after a backup by an earlier version
//! was restored. They are not executed again until a client resumes them: an operator may have deleted the
//! files on purpose.

use std::io;
use std::thread;

use jostle_experiment::{Folder, FolderError, MODEL_VERSION, MissingFiles, Plan};
use jostle_physics::plural::counted;
use jostle_proto::ExperimentPhase as Phase;
use tracing::warn;

use super::error::ExperimentError;
use super::loading::read_plan;
use super::results::Results;
use super::{ExperimentManager, wrong_phase};

/// The niceness of the thread, which reads the lists of all finished experiments.
const NICENESS: i32 = 10;

impl ExperimentManager {
    /// Starts a thread that checks the files of all finished experiments, and ends.
    pub(super) fn find_missing_files(&self) -> io::Result<()> {
        let is_finished = |name: &&String| self.phase(name).is_ok_and(|it| it == Phase::Finished);
        let names: Vec<String> = self.lock().entries.keys().cloned().collect();
        let finished: Vec<String> = names.iter().filter(is_finished).cloned().collect();
        if finished.is_empty() {
            return Ok(());
        }
        let manager = self.clone();
        let run = move || {
            // `None` is the calling thread. Without the right to it, it keeps its priority.
            let _ = rustix::process::setpriority_process(None, NICENESS);
            for name in finished {
                if manager.lock().is_stopping {
                    return;
                }
                // Meanwhile no client resumes it.
                let _serialized = manager.0.serialize_changes.lock();
                match manager.missing_files(&name) {
                    Ok(missing) if missing.runs.indices().is_empty() => {}
                    Ok(missing) => manager.report_missing(&name, &missing),
                    Err(error) => manager.report_unreadable(&name, &error),
                }
            }
        };
        let thread = thread::Builder::new().name("check-files".into());
        thread.spawn(run).map(drop)
    }

    /// Checks that a finished experiment has runs that lack files and can be executed again.
    pub(super) fn check_resumable(&self, name: &str) -> Result<(), ExperimentError> {
        let missing = self.missing_files(name)?;
        match missing.runs.indices().is_empty() {
            true => Err(wrong_phase(
                name,
                Phase::Finished,
                "there is nothing left to do",
            )),
            false => self.check_model(name),
        }
    }

    fn missing_files(&self, name: &str) -> Result<MissingFiles, ExperimentError> {
        let folder = self.0.jobs.folder(name);
        // Not kept: an experiment that is over needs its plan only if its results are read.
        let plan = read_plan(name, &folder)?;
        let missing = Folder::missing_files(&folder, &plan);
        let missing = missing.map_err(ExperimentError::unreadable)?;
        Ok(missing.of_finished())
    }

    /// Why a file of a finished run cannot be read.
    pub(super) fn unreadable_file(
        &self,
        (name, plan, index): (&str, &Plan, usize),
        results: &Results,
        error: &FolderError,
    ) -> ExperimentError {
        let folder = self.0.jobs.folder(name);
        let run = plan.runs()[index].name.clone();
        let name = name.to_owned();
        if Folder::lacks_files(&folder, plan, &results.finished, index) {
            ExperimentError::MissingFile { name, run }
        } else if error.is_damage() {
            let reason = error.to_string();
            ExperimentError::DamagedFile { name, run, reason }
        } else {
            ExperimentError::unreadable(error)
        }
    }

    fn report_unreadable(&self, name: &str, error: &ExperimentError) {
        warn!(experiment = name, %error, "cannot check its files");
        let mut state = self.lock();
        if let Some(entry) = state.entries.get_mut(name)
            && entry.status.phase == Phase::Finished
        {
            entry.status.message = Some(error.to_string());
            state.version += 1;
            self.0.changed.notify_all();
        }
    }

    fn report_missing(&self, name: &str, missing: &MissingFiles) {
        let message = describe(missing);
        warn!(experiment = name, "{message}");
        let mut state = self.lock();
        if let Some(entry) = state.entries.get_mut(name)
            && entry.status.phase == Phase::Finished
        {
            entry.status.set_lacking(missing.finished, message);
            state.version += 1;
            self.0.changed.notify_all();
        }
    }
}

/// Says how many runs lack files, and what can be done.
fn describe(missing: &MissingFiles) -> String {
    let count = missing.runs.indices().len();
    let runs = format!(
        "{} {} files",
        counted(count, "run"),
        if count == 1 { "lacks" } else { "lack" }
    );
    match missing.model_version {
        MODEL_VERSION => format!("{runs}: `jostle experiment resume` executes them again"),
        theirs => format!(
            "{runs}, which cannot be executed again: they are of model version {theirs}, this daemon has \
             {MODEL_VERSION}"
        ),
    }
}
