//! The experiments of a daemon: one at a time is carried out, the others wait their turn.
//!
//! What was submitted outlives the daemon, and goes on with the first unfinished run when it
//! starts anew. Of one that is paused the runs stand still where they are, and the next begins.

mod error;
mod results;
mod shelf;

use std::collections::BTreeMap;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use jostle_proto::keys;
use serde::{Deserialize, Serialize};
use tracing::{info, warn};

pub use self::error::LabError;
use self::results::Desk;
use self::shelf::{Shelf, Standing};
use jostle_experiment::{Control, Execution, Folder, Outcome, Plan, Progress, Subset, execute};

/// The most experiments that are kept: a list of them fits a message.
const MOST: usize = 1000;

/// The time between two checkpoints of a run: as much is computed again after a crash.
const CHECKPOINT_EVERY: Duration = Duration::from_secs(300);

/// How long the end of a cancelled experiment is waited for: its runs finish the step they are at.
const PATIENCE: Duration = Duration::from_secs(3);

/// What an experiment is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// It waits for those before it.
    Queued,
    /// Its runs are carried out.
    Running,
    /// Its runs stand still until it is resumed.
    Paused,
    /// Every run is over.
    Finished,
    /// It was ended half way.
    Cancelled,
    /// It cannot go on.
    Failed,
}

impl Phase {
    /// The word for it.
    pub fn word(self) -> &'static str {
        match self {
            Phase::Queued => "queued",
            Phase::Running => "running",
            Phase::Paused => "paused",
            Phase::Finished => "finished",
            Phase::Cancelled => "cancelled",
            Phase::Failed => "failed",
        }
    }

    /// Whether nothing more happens to it by itself.
    pub fn is_over(self) -> bool {
        matches!(self, Phase::Finished | Phase::Cancelled | Phase::Failed)
    }
}

/// How an experiment stands.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// Its name.
    pub name: String,
    /// What it is doing.
    pub phase: Phase,
    /// How far it is.
    pub progress: Progress,
    /// Why it failed, or what is to be said of it.
    pub message: Option<String>,
}

/// The experiments of a daemon. Clones are the same ones.
#[derive(Clone)]
pub struct Lab(Arc<Shared>);

struct Shared {
    shelf: Shelf,
    threads: usize,
    desk: Desk,
    /// Held by whoever changes something, so that one thing is done at a time.
    doing: Mutex<()>,
    bench: Mutex<Bench>,
    changed: Condvar,
}

#[derive(Default)]
struct Bench {
    entries: BTreeMap<String, Entry>,
    is_stopping: bool,
    /// Grows with every change of a phase.
    news: u64,
}

struct Entry {
    number: u64,
    phase: Phase,
    /// What is to be carried out; none of one that was over when the daemon started.
    plan: Option<Arc<Plan>>,
    /// The go under way, also when it stands still or is about to end.
    go: Option<Arc<Control>>,
    /// How far it was when the last go ended.
    before: Progress,
    message: Option<String>,
}

impl Entry {
    fn report(&self, name: &str) -> Report {
        let mut progress = match &self.go {
            // Before it has begun it knows nothing of itself.
            Some(control) => match control.progress() {
                new if new.runs == 0 => self.before.clone(),
                known => Progress {
                    elapsed_secs: self.before.elapsed_secs + known.elapsed_secs,
                    ..known
                },
            },
            None => self.before.clone(),
        };
        if self.phase != Phase::Running {
            progress.left_secs = None;
        }
        if self.phase.is_over() {
            progress.running.clear();
        }
        Report {
            name: name.to_owned(),
            phase: self.phase,
            progress,
            message: self.message.clone(),
        }
    }

    fn standing(&self, phase: Phase) -> Standing {
        let progress = self.report("").progress;
        Standing {
            number: self.number,
            phase: match phase {
                Phase::Running => Phase::Queued,
                phase => phase,
            },
            runs: progress.runs,
            finished: progress.finished,
            faulted: progress.faulted,
            share: progress.share,
            elapsed_secs: progress.elapsed_secs,
            message: self.message.clone(),
        }
    }
}

impl Lab {
    /// Opens the laboratory in a folder; what is unfinished goes on at once, on so many threads.
    ///
    /// # Errors
    ///
    /// When the folder cannot be used.
    pub fn open(folder: &Path, threads: usize) -> io::Result<Self> {
        let shelf = Shelf::open(folder)?;
        let mut bench = Bench::default();
        for (name, standing) in shelf.list()? {
            if keys::is_name(&name) {
                let entry = remembered(&shelf, &name, standing);
                bench.entries.insert(name, entry);
            }
        }
        let lab = Lab(Arc::new(Shared {
            shelf,
            threads: threads.max(1),
            desk: Desk::default(),
            doing: Mutex::default(),
            bench: Mutex::new(bench),
            changed: Condvar::new(),
        }));
        lab.call_next(&mut lab.bench());
        Ok(lab)
    }

    /// Takes in an experiment, or finds that it is there; whether it is new, and how it stands.
    ///
    /// # Errors
    ///
    /// [`LabError`].
    pub fn submit(&self, name: Option<&str>, text: &str) -> Result<(bool, Report), LabError> {
        let mut plan = Plan::parse(text)?;
        if let Some(name) = name {
            name.clone_into(&mut plan.name);
        }
        let name = plan.name.clone();
        if !keys::is_name(&name) {
            return Err(LabError::Name(
                name.chars().take(keys::MAX_NAME_LENGTH).collect(),
            ));
        }
        let _doing = self.begin_doing()?;
        if let Some(phase) = self.phase(&name) {
            let there = self.shelf().text(&name).map_err(unreadable)?;
            if there != text {
                return Err(LabError::Exists(name));
            }
            if matches!(phase, Phase::Cancelled | Phase::Failed) {
                self.queue(&name)?;
            }
            return Ok((false, self.report(&name)?));
        }
        let count = self.bench().entries.len();
        if count >= MOST {
            return Err(LabError::TooMany(count));
        }
        let unkept = |error: &dyn std::fmt::Display| LabError::Unkept(error.to_string());
        Folder::open(&self.shelf().folder(&name), &plan).map_err(|error| unkept(&error))?;
        let entry = Entry {
            number: self.bench().next_number(),
            phase: Phase::Queued,
            before: Progress {
                runs: plan.runs().len(),
                ..Progress::default()
            },
            plan: Some(Arc::new(plan)),
            go: None,
            message: None,
        };
        let noted = self.shelf().note(&name, &entry.standing(Phase::Queued));
        noted.map_err(|error| unkept(&error))?;
        info!(experiment = name, "submitted");
        let mut bench = self.bench();
        bench.entries.insert(name.clone(), entry);
        self.call_next(&mut bench);
        drop(bench);
        Ok((true, self.report(&name)?))
    }

    /// Has an experiment stand still.
    ///
    /// # Errors
    ///
    /// [`LabError`].
    pub fn pause(&self, name: &str) -> Result<Report, LabError> {
        let _doing = self.begin_doing()?;
        match self.known_phase(name)? {
            Phase::Paused => {}
            Phase::Queued | Phase::Running => {
                self.note(name, Phase::Paused)?;
                self.change(name, |entry| {
                    // It may have ended just now.
                    if !entry.phase.is_over() {
                        entry.phase = Phase::Paused;
                        if let Some(control) = &entry.go {
                            control.pause();
                        }
                    }
                });
            }
            phase => return Err(refuse(name, phase, "there is nothing to pause")),
        }
        self.report(name)
    }

    /// Has a paused experiment go on, and one that was cancelled or failed too.
    ///
    /// # Errors
    ///
    /// [`LabError`].
    pub fn resume(&self, name: &str) -> Result<Report, LabError> {
        let _doing = self.begin_doing()?;
        match self.known_phase(name)? {
            Phase::Queued | Phase::Running => {}
            Phase::Paused | Phase::Cancelled | Phase::Failed => self.queue(name)?,
            phase @ Phase::Finished => {
                return Err(refuse(name, phase, "there is nothing left to do"));
            }
        }
        self.report(name)
    }

    /// Ends an experiment; what is finished is kept.
    ///
    /// # Errors
    ///
    /// [`LabError`].
    pub fn cancel(&self, name: &str) -> Result<Report, LabError> {
        let _doing = self.begin_doing()?;
        match self.known_phase(name)? {
            Phase::Cancelled => {}
            Phase::Queued | Phase::Running | Phase::Paused => {
                self.note(name, Phase::Cancelled)?;
                self.change(name, |entry| {
                    if !entry.phase.is_over() {
                        entry.phase = Phase::Cancelled;
                        if let Some(control) = &entry.go {
                            control.cancel();
                        }
                    }
                });
                self.wait_for_end(name);
            }
            phase => return Err(refuse(name, phase, "there is nothing to cancel")),
        }
        self.report(name)
    }

    /// Removes an experiment that is over, with its results; how it stood.
    ///
    /// # Errors
    ///
    /// [`LabError`].
    pub fn delete(&self, name: &str) -> Result<Report, LabError> {
        let _doing = self.begin_doing()?;
        let phase = self.known_phase(name)?;
        self.wait_for_end(name);
        let report = self.report(name)?;
        let is_going = self
            .bench()
            .entries
            .get(name)
            .is_some_and(|entry| entry.go.is_some());
        if !phase.is_over() || is_going {
            return Err(refuse(name, phase, "cancel it first"));
        }
        let removed = self.shelf().remove(name);
        removed.map_err(|error| LabError::Unkept(error.to_string()))?;
        info!(experiment = name, "deleted");
        let mut bench = self.bench();
        bench.entries.remove(name);
        bench.news += 1;
        self.0.changed.notify_all();
        Ok(report)
    }

    /// How an experiment stands.
    ///
    /// # Errors
    ///
    /// [`LabError::Unknown`].
    pub fn report(&self, name: &str) -> Result<Report, LabError> {
        let bench = self.bench();
        let entry = bench.entries.get(name);
        entry
            .map(|entry| entry.report(name))
            .ok_or_else(|| LabError::Unknown(name.to_owned()))
    }

    /// How all of them stand, in the order in which they were submitted.
    pub fn reports(&self) -> Vec<Report> {
        let bench = self.bench();
        let mut entries: Vec<_> = bench.entries.iter().collect();
        entries.sort_by_key(|(_, entry)| entry.number);
        entries
            .into_iter()
            .map(|(name, entry)| entry.report(name))
            .collect()
    }

    /// Waits until there is something to tell: any is carried out, or the phase of one has changed
    /// since the news numbered `seen`. The number of the newest; none once it is closed.
    pub fn news(&self, seen: u64) -> Option<u64> {
        let is_quiet = |bench: &mut Bench| {
            let mut phases = bench.entries.values().map(|entry| entry.phase);
            !bench.is_stopping && bench.news == seen && !phases.any(|it| it == Phase::Running)
        };
        let waited = self.0.changed.wait_while(self.bench(), is_quiet);
        let bench = waited.unwrap_or_else(PoisonError::into_inner);
        (!bench.is_stopping).then_some(bench.news)
    }

    /// Stops whatever is carried out, which goes on when the daemon starts anew. The number of
    /// those that do not stop in time; their finished runs are safe.
    pub fn stop(&self, patience: Duration) -> usize {
        let mut bench = self.bench();
        bench.is_stopping = true;
        for entry in bench.entries.values() {
            if let Some(control) = &entry.go {
                control.cancel();
            }
        }
        self.0.changed.notify_all();
        let going = |bench: &Bench| bench.entries.values().filter(|it| it.go.is_some()).count();
        let waited = self
            .0
            .changed
            .wait_timeout_while(bench, patience, |bench| going(bench) > 0);
        let (bench, _) = waited.unwrap_or_else(PoisonError::into_inner);
        going(&bench)
    }

    /// The plan of an experiment.
    fn plan(&self, name: &str) -> Result<Arc<Plan>, LabError> {
        let known = {
            let bench = self.bench();
            let entry = bench.entries.get(name);
            let entry = entry.ok_or_else(|| LabError::Unknown(name.to_owned()))?;
            entry.plan.clone()
        };
        if let Some(plan) = known {
            return Ok(plan);
        }
        let plan = Arc::new(read_plan(self.shelf(), name)?);
        if let Some(entry) = self.bench().entries.get_mut(name) {
            entry.plan = Some(plan.clone());
        }
        Ok(plan)
    }

    /// Puts an experiment that stands still or has ended among those to be carried out.
    fn queue(&self, name: &str) -> Result<(), LabError> {
        if self.known_phase(name)?.is_over() {
            self.wait_for_end(name);
        }
        self.plan(name)?;
        self.note(name, Phase::Queued)?;
        self.change(name, |entry| {
            entry.phase = Phase::Queued;
            entry.message = None;
        });
        Ok(())
    }

    /// Writes down that an experiment is about to be in a phase.
    fn note(&self, name: &str, phase: Phase) -> Result<(), LabError> {
        let standing = {
            let bench = self.bench();
            let entry = bench.entries.get(name);
            let entry = entry.ok_or_else(|| LabError::Unknown(name.to_owned()))?;
            entry.standing(phase)
        };
        let noted = self.shelf().note(name, &standing);
        noted.map_err(|error| LabError::Unkept(error.to_string()))
    }

    /// Changes an experiment, and calls whoever is next.
    fn change(&self, name: &str, change: impl FnOnce(&mut Entry)) {
        let mut bench = self.bench();
        if let Some(entry) = bench.entries.get_mut(name) {
            change(entry);
        }
        bench.news += 1;
        self.call_next(&mut bench);
        self.0.changed.notify_all();
    }

    /// Waits until a cancelled experiment no longer uses its folder, but not for good.
    fn wait_for_end(&self, name: &str) {
        let is_ending = |bench: &mut Bench| {
            let entry = bench.entries.get(name);
            entry.is_some_and(|entry| entry.phase.is_over() && entry.go.is_some())
        };
        let waited = self
            .0
            .changed
            .wait_timeout_while(self.bench(), PATIENCE, is_ending);
        drop(waited);
    }

    /// Has the first of those that wait carried out, if none is.
    fn call_next(&self, bench: &mut Bench) {
        loop {
            let is_busy = |entry: &Entry| {
                entry.phase == Phase::Running || (entry.phase.is_over() && entry.go.is_some())
            };
            if bench.is_stopping || bench.entries.values().any(is_busy) {
                return;
            }
            let queued = bench.entries.iter_mut();
            let queued = queued.filter(|(_, entry)| entry.phase == Phase::Queued);
            let Some((name, entry)) = queued.min_by_key(|(_, entry)| entry.number) else {
                return;
            };
            bench.news += 1;
            entry.phase = Phase::Running;
            if let Some(control) = &entry.go {
                return control.resume();
            }
            if let Err(reason) = self.begin(name, entry) {
                warn!(experiment = name, reason, "failed to begin");
                entry.phase = Phase::Failed;
                entry.message = Some(reason);
            }
        }
    }

    /// Begins to carry out an experiment, on a thread that looks after those of its runs.
    fn begin(&self, name: &str, entry: &mut Entry) -> Result<(), String> {
        let Some(plan) = entry.plan.clone() else {
            return Err("its file is not known".to_owned());
        };
        let control = Arc::new(Control::new());
        let (lab, name, going) = (self.clone(), name.to_owned(), control.clone());
        let conduct = move || {
            let path = lab.shelf().folder(&name);
            let carried_out = catch_unwind(AssertUnwindSafe(|| {
                let mut folder = Folder::open(&path, &plan).map_err(|it| it.to_string())?;
                let execution = Execution {
                    plan: &plan,
                    subset: &Subset::all(&plan),
                    threads: lab.0.threads,
                    checkpoint_every: Some(CHECKPOINT_EVERY),
                };
                execute(execution, &mut folder, &going).map_err(|it| it.to_string())
            }));
            let outcome = carried_out.unwrap_or_else(|_| Err("a defect of the daemon".to_owned()));
            lab.ended(&name, outcome);
        };
        let thread = thread::Builder::new().name("experiment".into());
        thread.spawn(conduct).map_err(|error| error.to_string())?;
        entry.go = Some(control);
        Ok(())
    }

    /// A go of an experiment has ended.
    fn ended(&self, name: &str, outcome: Result<Outcome, String>) {
        let mut bench = self.bench();
        let is_stopping = bench.is_stopping;
        let Some(entry) = bench.entries.get_mut(name) else {
            return;
        };
        entry.before = entry.report(name).progress;
        entry.before.running.clear();
        entry.go = None;
        match outcome {
            Ok(outcome) if !outcome.is_cancelled => {
                entry.phase = Phase::Finished;
                entry.before.share = 1.0;
                entry.message = faults(&outcome);
            }
            // Whoever cancelled it wrote down whether it goes on.
            Ok(_) if is_stopping || entry.phase == Phase::Cancelled => {}
            Ok(_) => entry.phase = Phase::Cancelled,
            Err(reason) => {
                entry.phase = Phase::Failed;
                entry.message = Some(reason);
            }
        }
        let (phase, standing) = (entry.phase, entry.standing(entry.phase));
        info!(experiment = name, phase = phase.word(), "ended");
        if phase.is_over() {
            // What cannot be written is found again by the next start.
            if let Err(error) = self.shelf().note(name, &standing) {
                warn!(experiment = name, %error, "failed to write down how it stands");
            }
        }
        bench.news += 1;
        self.call_next(&mut bench);
        self.0.changed.notify_all();
    }

    fn phase(&self, name: &str) -> Option<Phase> {
        self.bench().entries.get(name).map(|entry| entry.phase)
    }

    fn known_phase(&self, name: &str) -> Result<Phase, LabError> {
        self.phase(name)
            .ok_or_else(|| LabError::Unknown(name.to_owned()))
    }

    fn begin_doing(&self) -> Result<MutexGuard<'_, ()>, LabError> {
        let doing = &self.0.doing;
        let doing = doing.lock().unwrap_or_else(PoisonError::into_inner);
        match self.bench().is_stopping {
            true => Err(LabError::Stopping),
            false => Ok(doing),
        }
    }

    fn shelf(&self) -> &Shelf {
        &self.0.shelf
    }

    fn desk(&self) -> &Desk {
        &self.0.desk
    }

    fn bench(&self) -> MutexGuard<'_, Bench> {
        // Nothing between two changes can panic.
        self.0.bench.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Bench {
    fn next_number(&self) -> u64 {
        let numbers = self.entries.values().map(|entry| entry.number);
        numbers.max().map_or(0, |last| last + 1)
    }
}

/// An experiment as it was left.
fn remembered(shelf: &Shelf, name: &str, standing: Option<Standing>) -> Entry {
    // Whoever submitted it was ended before that was written down, and got no answer.
    let standing = standing.unwrap_or(Standing {
        number: u64::MAX >> 1,
        phase: Phase::Queued,
        runs: 0,
        finished: 0,
        faulted: 0,
        share: 0.0,
        elapsed_secs: 0.0,
        message: None,
    });
    let mut entry = Entry {
        number: standing.number,
        phase: standing.phase,
        plan: None,
        go: None,
        before: Progress {
            runs: standing.runs,
            finished: standing.finished,
            faulted: standing.faulted,
            share: standing.share,
            elapsed_secs: standing.elapsed_secs,
            ..Progress::default()
        },
        message: standing.message,
    };
    if entry.phase.is_over() {
        return entry;
    }
    let read = read_plan(shelf, name).and_then(|plan| {
        let rows = Folder::read(&shelf.folder(name), &plan);
        let rows = rows.map_err(|error| LabError::Unreadable(error.to_string()))?;
        Ok((plan, rows.len()))
    });
    match read {
        Ok((plan, finished)) => {
            entry.before.runs = plan.runs().len();
            entry.before.finished = entry.before.finished.max(finished);
            entry.plan = Some(Arc::new(plan));
        }
        Err(error) => {
            warn!(experiment = name, %error, "cannot go on");
            entry.phase = Phase::Failed;
            entry.message = Some(error.to_string());
        }
    }
    entry
}

fn read_plan(shelf: &Shelf, name: &str) -> Result<Plan, LabError> {
    let text = shelf.text(name).map_err(unreadable)?;
    let mut plan = Plan::parse(&text)?;
    name.clone_into(&mut plan.name);
    Ok(plan)
}

/// What is to be said of runs that ended early.
fn faults(outcome: &Outcome) -> Option<String> {
    let (run, why) = outcome.faults.first()?;
    Some(match outcome.faults.len() {
        1 => format!("run {run:?} ended early: {why}"),
        count => format!("{count} runs ended early; run {run:?}: {why}"),
    })
}

fn refuse(name: &str, phase: Phase, remedy: &'static str) -> LabError {
    LabError::Phase {
        name: name.to_owned(),
        phase: phase.word(),
        remedy,
    }
}

#[expect(clippy::needless_pass_by_value, reason = "it is the end of a chain")]
fn unreadable(error: io::Error) -> LabError {
    LabError::Unreadable(error.to_string())
}
