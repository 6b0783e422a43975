//! The experiments of a daemon. One at a time is executed, the others are queued.
//!
//! An unfinished experiment resumes with its first unfinished run when the daemon restarts. While
//! one is paused, its runs are suspended and the next experiment is executed.

mod disk;
mod error;
mod loading;
mod memory;
mod missing_files;
mod models;
mod results;
mod scheduler;
mod starts;
mod status;

use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use jostle_experiment::{Files, Folder, Plan, name_again};
use jostle_proto::{ExperimentPhase as Phase, OccasionalColumns, keys};
use jostle_results::table::trajectory::{self, About};
use jostle_results::table::{TableError, Trajectory};
use parking_lot::{Condvar, Mutex, MutexGuard};

pub use self::disk::DiskUsage;
pub use self::error::ExperimentError;
pub use self::loading::phases;
use self::loading::{load, read_files, read_plan, stored};
use self::results::{Results, ResultsCache, Rows, SeriesCache};
use self::status::{Entry, Status};
pub use self::status::{Report, is_finished};
use crate::jobs::JobDirectory;
use crate::swarm::registry::SwarmRegistry;

/// Maximum number of experiments: a list of them fits a message.
const MAX_EXPERIMENTS: usize = 1000;

/// How long `cancel` waits for the runs to finish their current step.
const CANCEL_TIMEOUT: Duration = Duration::from_secs(3);

/// The experiments of a daemon. Clones share them.
#[derive(Clone)]
pub struct ExperimentManager(Arc<Shared>);

/// Rows of the trajectory of a run.
pub struct TrajectoryRows {
    pub rows: Trajectory,
    /// The number of all rows.
    pub total: u64,
    /// The metadata of the file, with the first rows.
    pub about: Option<About>,
}

struct Shared {
    jobs: JobDirectory<Status>,
    threads: usize,
    /// The maximum of the bytes of all experiments.
    quota_bytes: Option<u64>,
    /// Limits the memory of swarms and experiments together.
    registry: Arc<SwarmRegistry>,
    results: ResultsCache,
    series: SeriesCache,
    /// Held during a request that changes an experiment.
    serialize_changes: Mutex<()>,
    /// Held while the status file of a submitted experiment is written; locked before `state`.
    serialize_writes: Mutex<()>,
    /// Nothing between two changes can panic.
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    entries: BTreeMap<String, Entry>,
    is_stopping: bool,
    /// Whether the orderly end of what was running is stored.
    is_stop_stored: bool,
    /// Whether the sizes of those that existed at the start are known.
    is_measured: bool,
    /// Increases with every change of a phase.
    version: u64,
}

impl ExperimentManager {
    /// Opens the experiments in a folder, which are executed on so many threads after
    /// [`Self::resume_all`]. Their files take at most `quota_bytes`.
    pub fn open(
        folder: &Path,
        threads: usize,
        quota_bytes: Option<u64>,
        registry: Arc<SwarmRegistry>,
    ) -> io::Result<Self> {
        let jobs = JobDirectory::open(folder)?;
        let mut state = State::default();
        for (name, status) in stored(&jobs)? {
            let entry = load(&name, &jobs, status);
            state.entries.insert(name, entry);
        }
        let manager = ExperimentManager(Arc::new(Shared {
            jobs,
            threads: threads.max(1),
            quota_bytes,
            registry,
            results: ResultsCache::default(),
            series: SeriesCache::default(),
            serialize_changes: Mutex::default(),
            serialize_writes: Mutex::default(),
            state: Mutex::new(state),
            changed: Condvar::new(),
        }));
        for entry in manager.lock().entries.values_mut() {
            entry.need = entry.plan.as_ref().map(|plan| manager.need(plan));
        }
        manager.find_missing_files()?;
        Ok(manager)
    }

    /// Submits an experiment, or resumes an equal one that exists. Returns whether it is new. With `again`, one
    /// whose runs another version of the model executed is submitted again beside it.
    pub fn submit(
        &self,
        name: Option<&str>,
        files: Files,
        again: bool,
    ) -> Result<(bool, Report), ExperimentError> {
        let (mut plan, accepted) = Plan::new_or_stored(files)?;
        if let Some(name) = name {
            name.clone_into(&mut plan.name);
        }
        check_name(&plan.name)?;
        let _serialized = self.begin_change()?;
        if again && self.other_model(&plan.name)?.is_some() {
            self.check_files(&plan)?;
            plan.name = name_again(&plan.name);
            check_name(&plan.name)?;
        }
        let name = plan.name.clone();
        if let Ok(phase) = self.phase(&name) {
            self.check_files(&plan)?;
            if phase != Phase::Finished {
                self.check_model(&name)?;
            }
            if matches!(phase, Phase::Cancelled | Phase::Failed) {
                self.enqueue(&name)?;
            }
            return Ok((false, self.report(&name)?));
        }
        accepted?;
        let (count, number) = {
            let entries = &self.lock().entries;
            let numbers = entries.values().map(|entry| entry.status.number);
            (entries.len(), numbers.max().map_or(0, |last| last + 1))
        };
        if count >= MAX_EXPERIMENTS {
            return Err(ExperimentError::TooMany(count));
        }
        let need = self.need(&plan);
        self.check_memory(&plan)?;
        let warning = self.check_need(need)?;
        let folder = self.0.jobs.folder(&name);
        Folder::open(&folder, &plan).map_err(ExperimentError::not_stored)?;
        let mut status = Status::queued(number);
        status.plan(&plan, 0);
        let written = self.0.jobs.write_status(&name, &status);
        written.map_err(ExperimentError::not_stored)?;
        let entry = Entry {
            status,
            plan: Some(Arc::new(plan)),
            other_model: None,
            bytes: self.measure(&name),
            need: Some(need),
            execution: None,
            number_of_execution: 0,
        };
        let mut state = self.lock();
        state.entries.insert(name.clone(), entry);
        self.schedule_next(&mut state);
        drop(state);
        let report = self.report(&name)?;
        let message = report.message.or(warning);
        Ok((true, Report { message, ..report }))
    }

    pub fn pause(&self, name: &str) -> Result<Report, ExperimentError> {
        let _serialized = self.begin_change()?;
        match self.phase(name)? {
            Phase::Paused => {}
            Phase::Queued | Phase::Running => self.suspend(name, Phase::Paused, None)?,
            phase => return Err(wrong_phase(name, phase, "there is nothing to pause")),
        }
        self.report(name)
    }

    /// Resumes an experiment that is paused, cancelled or failed, or of which runs lack files.
    pub fn resume(&self, name: &str) -> Result<Report, ExperimentError> {
        let _serialized = self.begin_change()?;
        match self.phase(name)? {
            Phase::Queued | Phase::Running => {}
            Phase::Paused | Phase::Cancelled | Phase::Failed => {
                self.check_model(name)?;
                self.enqueue(name)?;
            }
            Phase::Finished => {
                self.check_resumable(name)?;
                self.enqueue(name)?;
            }
        }
        self.report(name)
    }

    /// Cancels an experiment; the finished runs are kept.
    pub fn cancel(&self, name: &str) -> Result<Report, ExperimentError> {
        let _serialized = self.begin_change()?;
        match self.phase(name)? {
            Phase::Cancelled => {}
            Phase::Queued | Phase::Running | Phase::Paused => {
                self.suspend(name, Phase::Cancelled, None)?;
                self.wait_for_end(name);
            }
            phase => return Err(wrong_phase(name, phase, "there is nothing to cancel")),
        }
        self.report(name)
    }

    /// Deletes an experiment that is over, with its results. Returns its last report.
    pub fn delete(&self, name: &str) -> Result<Report, ExperimentError> {
        let _serialized = self.begin_change()?;
        let phase = self.phase(name)?;
        self.wait_for_end(name);
        let report = self.report(name)?;
        if !phase.is_over() || self.entry(name, |entry| entry.execution.is_some())? {
            return Err(wrong_phase(name, phase, "cancel it first"));
        }
        let removed = self.0.jobs.remove(name);
        removed.map_err(ExperimentError::not_stored)?;
        let mut state = self.lock();
        state.entries.remove(name);
        state.version += 1;
        self.0.changed.notify_all();
        Ok(report)
    }

    pub fn report(&self, name: &str) -> Result<Report, ExperimentError> {
        self.entry(name, |entry| entry.report(name))
    }

    /// The reports of all experiments, in the order of submission.
    pub fn reports(&self) -> Vec<Report> {
        let state = self.lock();
        let mut entries: Vec<_> = state.entries.iter().collect();
        entries.sort_by_key(|(_, entry)| entry.status.number);
        let entries = entries.into_iter();
        entries.map(|(name, entry)| entry.report(name)).collect()
    }

    /// The rows of an experiment's finished runs, each with the number of its run in the plan, and the columns
    /// of its tables.
    pub fn rows(&self, name: &str) -> Result<(Arc<OccasionalColumns>, Rows), ExperimentError> {
        let plan = self.plan(name)?;
        let Results { columns, rows, .. } = self.results(name, &plan)?;
        Ok((columns, rows))
    }

    fn results(&self, name: &str, plan: &Arc<Plan>) -> Result<Results, ExperimentError> {
        self.0.results.read(&self.0.jobs.folder(name), plan)
    }

    /// Rows of the trajectory of one run, at most `limit` after the first `after`.
    pub fn trajectory(
        &self,
        name: &str,
        run: &str,
        after: u64,
        limit: usize,
    ) -> Result<TrajectoryRows, ExperimentError> {
        let plan = self.plan(name)?;
        if plan.record_every.is_none() {
            return Err(ExperimentError::NoTrajectory(name.to_owned()));
        }
        let (index, results) = self.finished_run(name, &plan, run)?;
        let path = Folder::trajectory_path(&self.0.jobs.folder(name), index);
        let read = || {
            let about = (after == 0).then(|| trajectory::read_about(&path));
            let (rows, total) = trajectory::read_page(&path, after, limit)?;
            Ok::<_, TableError>(TrajectoryRows {
                rows,
                total,
                about: about.transpose()?,
            })
        };
        let of_run = (name, plan.as_ref(), index);
        read().map_err(|error| self.unreadable_file(of_run, &results, &error.into()))
    }

    /// Returns the index of a finished run in the plan, and the finished runs.
    fn finished_run(
        &self,
        name: &str,
        plan: &Arc<Plan>,
        run: &str,
    ) -> Result<(usize, Results), ExperimentError> {
        let Some(index) = plan.index(run) else {
            return Err(ExperimentError::UnknownRun {
                name: name.to_owned(),
                run: run.chars().take(200).collect(),
            });
        };
        let results = self.results(name, plan)?;
        let rows = &results.rows;
        let is_finished = rows.binary_search_by_key(&(index as u64 + 1), |(number, _)| *number);
        if is_finished.is_err() {
            let (name, run) = (name.to_owned(), run.to_owned());
            return Err(ExperimentError::Unfinished { name, run });
        }
        Ok((index, results))
    }

    /// Waits while no experiment is running and the version of the state is `seen`. Returns the new
    /// version, or `None` once the manager is stopped.
    pub fn wait_for_change(&self, seen: u64) -> Option<u64> {
        let is_unchanged = |state: &mut State| {
            let mut entries = state.entries.values();
            !state.is_stopping
                && state.version == seen
                && !entries.any(|entry| entry.status.phase == Phase::Running)
        };
        let mut state = self.lock();
        self.0.changed.wait_while(&mut state, is_unchanged);
        (!state.is_stopping).then_some(state.version)
    }

    /// Stops what is running, which resumes when the daemon restarts. Returns how many executions
    /// do not stop within `timeout`; their finished runs are durable.
    pub fn stop(&self, timeout: Duration) -> usize {
        let running = self.begin_stop();
        self.store_orderly_ends(running);
        let mut state = self.lock();
        let count = |state: &State| {
            let entries = state.entries.values();
            entries.filter(|it| it.execution.is_some()).count()
        };
        let is_ending = |state: &mut State| count(state) > 0 || !state.is_stop_stored;
        self.0
            .changed
            .wait_while_for(&mut state, is_ending, timeout);
        count(&state)
    }

    fn plan(&self, name: &str) -> Result<Arc<Plan>, ExperimentError> {
        if let Some(plan) = self.entry(name, |entry| entry.plan.clone())? {
            return Ok(plan);
        }
        let plan = Arc::new(read_plan(name, &self.0.jobs.folder(name))?);
        // Another request may have read it meanwhile: an experiment has one plan.
        match self.lock().entries.get_mut(name) {
            Some(entry) => Ok(entry.plan.get_or_insert(plan).clone()),
            None => Ok(plan),
        }
    }

    /// Enqueues an experiment that is paused or over.
    fn enqueue(&self, name: &str) -> Result<(), ExperimentError> {
        if self.phase(name)?.is_over() {
            self.wait_for_end(name);
        }
        let plan = self.plan(name)?;
        let need = self.need(&plan);
        let writing = self.0.serialize_writes.lock();
        let status = self.entry(name, |entry| entry.status_in(Phase::Queued, None))?;
        self.write_status(name, &status)?;
        let mut state = self.lock();
        if let Some(entry) = state.entries.get_mut(name) {
            entry.enter(&status);
            entry.need = Some(need);
        }
        drop(writing);
        self.publish_change(state);
        Ok(())
    }

    /// Pauses or cancels an experiment, as `phase` says, unless it has just ended. `message` states why,
    /// if the daemon pauses it.
    fn suspend(
        &self,
        name: &str,
        phase: Phase,
        message: Option<String>,
    ) -> Result<(), ExperimentError> {
        let writing = self.0.serialize_writes.lock();
        let suspended = |entry: &Entry| {
            let is_over = entry.status.phase.is_over();
            (!is_over).then(|| entry.status_in(phase, message))
        };
        let Some(status) = self.entry(name, suspended)? else {
            return Ok(());
        };
        self.write_status(name, &status)?;
        let mut state = self.lock();
        if let Some(entry) = state.entries.get_mut(name) {
            entry.enter(&status);
            match &entry.execution {
                Some(execution) if phase == Phase::Paused => execution.pause(),
                Some(execution) => execution.cancel(),
                None => {}
            }
        }
        drop(writing);
        self.publish_change(state);
        Ok(())
    }

    /// Writes the status that an experiment is about to have.
    fn write_status(&self, name: &str, status: &Status) -> Result<(), ExperimentError> {
        let written = self.0.jobs.write_status(name, status);
        written.map_err(ExperimentError::not_stored)
    }

    /// Waits until an experiment that is over no longer uses its folder, at most
    /// [`CANCEL_TIMEOUT`].
    fn wait_for_end(&self, name: &str) {
        let is_ending = |state: &mut State| state.entries.get(name).is_some_and(Entry::is_ending);
        let changed = &self.0.changed;
        changed.wait_while_for(&mut self.lock(), is_ending, CANCEL_TIMEOUT);
    }

    /// Checks that the experiment with the name of a plan has its files.
    fn check_files(&self, plan: &Plan) -> Result<(), ExperimentError> {
        match read_files(&self.0.jobs.folder(&plan.name))? == plan.files {
            true => Ok(()),
            false => Err(ExperimentError::Exists(plan.name.clone())),
        }
    }

    fn phase(&self, name: &str) -> Result<Phase, ExperimentError> {
        self.entry(name, |entry| entry.status.phase)
    }

    fn entry<R>(&self, name: &str, read: impl FnOnce(&Entry) -> R) -> Result<R, ExperimentError> {
        let state = self.lock();
        let entry = state.entries.get(name).map(read);
        entry.ok_or_else(|| ExperimentError::Unknown(name.to_owned()))
    }

    fn begin_change(&self) -> Result<MutexGuard<'_, ()>, ExperimentError> {
        let serialized = self.0.serialize_changes.lock();
        match self.lock().is_stopping {
            true => Err(ExperimentError::Stopping),
            false => Ok(serialized),
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.state.lock()
    }
}

fn check_name(name: &str) -> Result<(), ExperimentError> {
    match keys::is_name(name) {
        true => Ok(()),
        false => Err(ExperimentError::Name(
            name.chars().take(keys::MAX_NAME_LENGTH).collect(),
        )),
    }
}

fn wrong_phase(name: &str, phase: Phase, remedy: &'static str) -> ExperimentError {
    ExperimentError::Phase {
        name: name.to_owned(),
        phase,
        remedy,
    }
}
