//! What would be done with results: of experiments in a data folder, and in folders of `jostled run`.

use std::fs;
use std::path::{Path, PathBuf};

use jostle_experiment::{
    EXPERIMENT, Files, Folder, MODEL_VERSION, Plan, finished, folder_again, name_again, results_in,
    start_remark,
};
use jostle_physics::plural::counted;
use jostle_proto::ExperimentPhase as Phase;
use serde::Serialize;

use crate::app::data_folder;
use crate::{experiments, store};

/// What would be done with an experiment, or with a folder of results.
#[derive(Debug, Serialize)]
pub struct Results {
    /// The name of the experiment, or the path of the folder.
    pub name: String,
    /// The phase of the experiment.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub phase: Option<Phase>,
    /// What was read of it; left out if it cannot be read.
    #[serde(flatten)]
    pub runs: Option<Runs>,
    /// Whether no run will be added because another version of the model executed the finished ones.
    pub marked: bool,
    /// The name, or the folder, in which `--again` executes all runs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub again: Option<String>,
    /// What will be done.
    pub message: String,
}

/// The runs of an experiment.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Runs {
    /// The number of all runs.
    pub runs: usize,
    /// The number of the finished ones.
    pub finished: usize,
    /// The version of the model that executed them.
    pub model_version: u32,
    /// The earliest version of the model that computed a part of the snapshot from which they start, if it is
    /// before this program's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start_model_version: Option<u32>,
}

impl Runs {
    fn read(folder: &Path) -> Result<Self, String> {
        let files = Files::stored(folder).map_err(|error| error.to_string())?;
        let plan = Plan::stored(files).map_err(|error| error.to_string())?;
        let found = Folder::missing_files(folder, &plan).map_err(|error| error.to_string())?;
        Ok(Self {
            runs: plan.runs().len(),
            finished: found.finished,
            // What has not finished a run starts from its beginning.
            model_version: match found.has_runs() {
                true => found.model_version,
                false => MODEL_VERSION,
            },
            start_model_version: plan.start_model_version(),
        })
    }

    /// Whether an experiment in this phase, or a folder, has runs left of another version.
    fn is_marked(self, phase: Option<Phase>) -> bool {
        let has_left = phase.is_some_and(|it| !it.is_over()) || self.finished < self.runs;
        self.model_version != MODEL_VERSION && has_left
    }
}

impl Results {
    /// Why it cannot be read.
    pub(super) fn problem(&self) -> Option<String> {
        let Self { name, message, .. } = self;
        self.runs.is_none().then(|| format!("{name}: {message}"))
    }

    fn of(
        (name, phase): (String, Option<Phase>),
        read: Result<Runs, String>,
        again: impl FnOnce() -> (String, String),
    ) -> Self {
        let marked = read.as_ref().is_ok_and(|runs| runs.is_marked(phase));
        let again = marked.then(again);
        let message = match (&read, &again) {
            (Err(error), _) => format!("cannot be read: {error}"),
            (Ok(runs), Some((_, execute))) => {
                let fate = match phase {
                    Some(phase) if phase.is_over() => format!("stays {phase}"),
                    Some(_) => "ends as failed".to_owned(),
                    None => "no run is added".to_owned(),
                };
                let runs = counted(runs.finished, "finished run");
                format!("{fate}; readable: {runs}; {execute}")
            }
            (Ok(runs), None) if runs.model_version != MODEL_VERSION => "readable".to_owned(),
            (Ok(_), None) => "as before".to_owned(),
        };
        let start = read.as_ref().ok().and_then(|it| it.start_model_version);
        let remark = start.map(|version| format!("; {}", start_remark(version)));
        Self {
            name,
            phase,
            marked,
            message: message + &remark.unwrap_or_default(),
            again: again.map(|(again, _)| again),
            runs: read.ok(),
        }
    }
}

/// The experiments in a folder of a daemon.
pub(super) fn experiments(folder: &Path, problems: &mut Vec<String>) -> Vec<Results> {
    let phases = experiments::phases(folder).unwrap_or_else(|error| {
        problems.push(format!("cannot use {}: {error}", folder.display()));
        Default::default()
    });
    let experiments = phases.into_iter().filter_map(|(name, phase)| {
        let path = folder.join(&name);
        let read = Runs::read(&path);
        // A running daemon may have deleted it meanwhile.
        let is_there = read.is_ok() || path.exists();
        is_there.then(|| {
            let again = name_again(&name);
            let command = "`jostle experiment run --again FILE` executes all runs again as";
            let execute = format!("{command} {again}");
            Results::of((name, Some(phase)), read, || (again, execute))
        })
    });
    experiments.collect()
}

/// The folders of results in `folders`, each of which is one or contains some.
pub(super) fn folders(folders: &[PathBuf], problems: &mut Vec<String>) -> Vec<Results> {
    let mut found = Vec::new();
    for folder in folders {
        match results(folder) {
            Ok(results) => found.extend(results.iter().map(|it| of_folder(it))),
            Err(problem) => problems.push(problem),
        }
    }
    found
}

fn results(folder: &Path) -> Result<Vec<PathBuf>, String> {
    let name = folder.display();
    let parts = unfinished_beside(folder);
    if !folder.exists() && !parts.is_empty() {
        return Ok(parts);
    }
    let is_folder = fs::metadata(folder).map(|it| it.is_dir());
    if !is_folder.map_err(|error| format!("cannot use {name}: {error}"))? {
        return Err(format!("{name} is a file: name the folder of the results"));
    }
    if data_folder::has(folder, store::FILE) {
        return Err(format!(
            "{name} is a data folder: name it with --data-dir, and folders of `jostled run` without"
        ));
    }
    let mut results = results_in(folder).map_err(|error| error.to_string())?;
    if results.is_empty() {
        if !folder.join(EXPERIMENT).exists() {
            return Err(format!(
                "{name} contains no results: name a folder of `jostled run`, or one that contains some"
            ));
        }
        results.push(folder.to_owned());
    }
    Ok(results)
}

/// The unfinished parts beside a folder, which is created when one of them is complete.
fn unfinished_beside(folder: &Path) -> Vec<PathBuf> {
    let mut parts = folder.parent().map_or(Vec::new(), |parent| {
        let parent = match parent.as_os_str().is_empty() {
            true => Path::new("."),
            false => parent,
        };
        results_in(parent).unwrap_or_default()
    });
    parts.retain(|it| it != folder && finished(it).file_name() == folder.file_name());
    parts
}

fn of_folder(folder: &Path) -> Results {
    let output = finished(folder);
    Results::of(
        (folder.display().to_string(), None),
        Runs::read(folder),
        || {
            let again = folder_again(&output).display().to_string();
            let execute = format!("`jostled run FILE --again` executes all runs again in {again}");
            (again, execute)
        },
    )
}
