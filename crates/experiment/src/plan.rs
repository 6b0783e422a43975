//! The plan of an experiment: all its runs, checked before the first one starts.

use std::collections::BTreeMap;
use std::sync::Arc;

use jostle_measures::{Measure, check_past};
use jostle_physics::observables::Definitions;
use jostle_physics::simulation::{Spec, Start, begin, steps_in};
use jostle_proto::keys;
use toml::Spanned;

use crate::error::PlanError;
use crate::file::{File, Source};
use crate::files::Files;
use crate::grid::{self, Choice, Grid};
use crate::limits::{
    MAX_BLOCKS_OF_PLAN, MAX_ENTRIES, MAX_INDIVIDUALS, MAX_RUNS, MAX_STEPS, MAX_TRAJECTORY_BYTES,
    REPLICATES, SEEDS, STEPS_BETWEEN,
};
use crate::protocol::{Block, Protocol, Setting, Variables, first_span, templates, used};
use crate::row_grids;
use crate::set_points::SetPointTable;
use crate::start::Base;
use jostle_convert::spec;
use jostle_convert::value::count;

use self::named::{base, points};
use self::settings::{check_sizes, columns, seeds};

mod memory;
mod named;
mod settings;

/// Bytes of the file of a trajectory, and in addition of each of its frames and rows.
const BYTES_OF_TRAJECTORY: f64 = 2700.0;
const BYTES_OF_FRAME: f64 = 20.0;
const BYTES_OF_ROW: f64 = 27.0;

/// An experiment: common settings and the list of runs.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The name of the experiment.
    pub name: String,
    /// The seed from which the seeds of all runs are derived.
    pub seed: u64,
    /// The duration of each run, in time units.
    pub duration: f64,
    /// Steps between two entries of the order's time series; none if no series is recorded.
    pub order_every: Option<u64>,
    /// Whether contacts and their effect on bodies are measured.
    pub touch: bool,
    /// The measures whose means are columns of the table of results.
    pub columns: Columns,
    /// Steps between two frames of the trajectories; none if no trajectories are recorded.
    pub record_every: Option<u64>,
    /// The definitions of its measures: those of the folder in which it began, if there is one.
    pub definitions: Definitions,
    /// The experiment's files, unchanged.
    pub files: Files,
    /// The state from which every run starts, if the file has `start`.
    pub(crate) base: Option<Base>,
    /// The set-points of every run, if the file has `setpoints`.
    pub(crate) set_points: Option<Arc<SetPointTable>>,
    points: Vec<Point>,
    runs: Vec<PlannedRun>,
    /// The indices of all runs, sorted by name.
    by_name: Vec<usize>,
}

/// Measures whose means are columns of the table of results.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Columns {
    /// The measures.
    pub measures: Vec<Measure>,
    /// The time from which they are measured, in time units.
    pub from: f64,
    /// Steps between two measurements.
    pub every: u64,
    /// Steps between two entries of their time series; none if no series is recorded.
    pub series_every: Option<u64>,
}

/// The settings that the replicates of a run share.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// The spec of the swarm, except for its seed.
    pub spec: Spec,
    /// Number of individuals that are informed from the start.
    pub informed: usize,
    /// Number of steps of a run, at most.
    pub steps: u64,
    /// The values of the variables.
    pub variables: Variables,
    /// The commands of a run, and the condition that ends it.
    pub protocol: Option<Arc<Protocol>>,
}

/// One run of an experiment.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedRun {
    /// The values that vary and the replicate: `pi1=4 n=50 #0`.
    pub name: String,
    /// The seed of the run, derived from the experiment's seed and the name.
    pub seed: u64,
    point: usize,
}

impl Plan {
    /// Parses and checks an experiment's file that names no other file.
    ///
    /// # Errors
    ///
    /// As [`Self::of`].
    pub fn parse(toml: &str) -> Result<Self, PlanError> {
        Self::of(Files::from(toml))
    }

    /// Parses and checks an experiment's files.
    ///
    /// Runs are ordered by grid. Within a grid the axes vary in the order of
    /// [`jostle_proto::AXES`], the last one fastest, each in the order of its listed values;
    /// replicates vary fastest of all. The name of a run contains every axis of any grid. Adding
    /// values to an axis therefore changes no name and no seed.
    ///
    /// # Errors
    ///
    /// [`PlanError`], with the line or the run.
    pub fn of(files: Files) -> Result<Self, PlanError> {
        let checked = Self::checked(&files, false);
        #[cfg(test)]
        tests::compare(&files, &checked);
        let mut plan = checked?;
        plan.files = files;
        Ok(plan)
    }

    /// As [`Self::of`], of a stored experiment: accepts all that an earlier version accepted.
    ///
    /// # Errors
    ///
    /// [`PlanError`], with the line or the run.
    pub fn stored(files: Files) -> Result<Self, PlanError> {
        let mut plan = Self::checked(&files, true)?;
        plan.files = files;
        Ok(plan)
    }

    /// As [`Self::of`], of an experiment that may be stored; with why it is rejected if it is not.
    ///
    /// # Errors
    ///
    /// [`PlanError`] if no version accepts it.
    pub fn new_or_stored(files: Files) -> Result<(Self, Result<(), PlanError>), PlanError> {
        match Self::of(files.clone()) {
            Ok(plan) => Ok((plan, Ok(()))),
            Err(error) => match Self::stored(files) {
                Ok(plan) => Ok((plan, Err(error))),
                Err(_) => Err(error),
            },
        }
    }

    /// As [`Self::of`], without the files.
    fn checked(files: &Files, is_stored: bool) -> Result<Self, PlanError> {
        let source = Source {
            toml: &files.toml,
            points: None,
            is_stored,
        };
        let file = source.read()?;
        let points = points(source, &file, files)?;
        let source = Source {
            points: points.as_ref(),
            ..source
        };
        let name = file.name.get_ref();
        if !keys::is_name(name) {
            let reason = format!(
                "invalid name = {name:?}: use 1 to {} lowercase letters, digits, '-' and '_', the \
                 first a letter or digit",
                keys::MAX_NAME_LENGTH
            );
            return Err(source.reject(&file.name.span(), reason));
        }
        let seed = source.whole("seed", file.seed.as_ref(), 0, SEEDS)?;
        let replicates = source.whole("replicates", file.replicates.as_ref(), 1, REPLICATES)?;
        let every = file.measure.order_every.as_ref();
        let every = source.whole("order_every", every, 0, STEPS_BETWEEN)?;
        let record = file.measure.record_every.as_ref();
        let record = source.whole("record_every", record, 0, STEPS_BETWEEN)?;
        let duration = *file.duration.get_ref();
        if !(duration.is_finite() && duration > 0.0) {
            let reason = format!("duration = {duration} is not a finite number above 0");
            return Err(source.reject(&file.duration.span(), reason));
        }
        let seeds = seeds(source, &file)?;
        let replicates = seeds
            .as_ref()
            .map_or(replicates, |seeds| seeds.len() as u64);
        let columns = columns(source, &file.measure, duration)?;
        if file.measure.touch
            && let Some(first) = file.at.first()
        {
            let reason = "[[at]] and touch exclude each other: leave out one of them";
            return Err(source.reject(&first_span(first), reason));
        }
        check_sizes(source, &file)?;
        let base = base(source, &file, files)?;
        let common = grid::common(source, &file.spec, base.as_ref())?;
        let used = used(file.at.iter().map(Spanned::get_ref).chain([&file.stop]));
        let grids = match &points {
            Some(points) => row_grids::grids(points, source, &used, replicates)?,
            None => grid::grids(source, &file.grid, &used, replicates)?,
        };
        if base.is_some() {
            grid::check_varied(source, &grids)?;
        }
        let runs = count_runs(&grids);
        if runs > MAX_RUNS {
            return Err(PlanError::TooManyRuns { runs });
        }
        let points = runs / replicates.max(1);
        if points.saturating_mul(file.at.len() as u64) > MAX_BLOCKS_OF_PLAN as u64 {
            let span = file.at.first().map_or(0..0, first_span);
            let reason = format!(
                "{} blocks at {points} points of the grid: the limit is {MAX_BLOCKS_OF_PLAN} in all",
                file.at.len()
            );
            return Err(source.reject(&span, reason));
        }
        let mut plan = Self {
            name: name.clone(),
            seed,
            duration,
            order_every: (every > 0).then_some(every),
            touch: file.measure.touch,
            columns,
            record_every: (record > 0).then_some(record),
            definitions: Definitions::default(),
            files: Files::default(),
            base,
            set_points: SetPointTable::of(source, &file, files)?.map(Arc::new),
            points: Vec::new(),
            runs: Vec::new(),
            by_name: Vec::new(),
        };
        let varied = grids.iter().flat_map(Grid::names).collect();
        let mut names = BTreeMap::new();
        for grid in &grids {
            for index in 0..count(grid.size().unwrap_or(0)) {
                let choice = grid.choice(source, &common, index)?;
                let name = choice.name(&varied);
                let added = plan.add_point((source, &file), grid, &choice, &name);
                added.map_err(|error| source.in_row(&grid.span, error))?;
                if let Some(seeds) = &seeds {
                    let first = plan.runs.len() - seeds.len();
                    for (run, &seed) in plan.runs[first..].iter_mut().zip(seeds) {
                        run.seed = seed;
                    }
                }
                let new = plan.runs.iter().enumerate().rev();
                for (index, run) in new.take(count(grid.replicates)) {
                    if names.insert(run.name.clone(), index).is_none() {
                        continue;
                    }
                    let (line, run) = (source.line(&grid.span), run.name.clone());
                    return Err(match source.points {
                        Some(_) => {
                            let reason = format!("duplicate run {run:?}: remove the repeated row");
                            source.reject(&grid.span, reason)
                        }
                        None => PlanError::Repeated { line, run },
                    });
                }
            }
        }
        plan.by_name = names.into_values().collect();
        let entries = plan.runs.iter().map(|run| plan.entries(run));
        let entries = entries.fold(0, u64::saturating_add);
        if entries > MAX_ENTRIES {
            return Err(PlanError::TooManyEntries { entries });
        }
        let sum = |of: fn(&Self, &PlannedRun) -> f64| -> f64 {
            plan.runs.iter().map(|run| of(&plan, run)).sum()
        };
        let (rows, bytes) = (sum(Self::trajectory_rows), sum(Self::trajectory_bytes));
        if bytes > MAX_TRAJECTORY_BYTES {
            return Err(PlanError::TooManyFrames { rows, bytes });
        }
        Ok(plan)
    }

    /// Returns all runs, in the order of the tables.
    #[must_use]
    pub fn runs(&self) -> &[PlannedRun] {
        &self.runs
    }

    /// Returns the index of the run with this name.
    #[must_use]
    pub fn index(&self, name: &str) -> Option<usize> {
        let by_name = &self.by_name;
        let found = by_name.binary_search_by(|&index| self.runs[index].name.as_str().cmp(name));
        found.ok().map(|position| by_name[position])
    }

    /// Returns a run by its number, from 1, or by its name; none if there is no such run.
    #[must_use]
    pub fn find(&self, run: &str) -> Option<&PlannedRun> {
        let number = run.parse::<usize>().ok();
        let index = number.and_then(|number| number.checked_sub(1));
        self.runs.get(index.or_else(|| self.index(run))?)
    }

    /// Returns the settings that `run` shares with its replicates.
    #[must_use]
    pub fn point(&self, run: &PlannedRun) -> &Point {
        &self.points[run.point]
    }

    /// Returns the spec of the swarm of `run`, with its seed.
    #[must_use]
    pub fn spec(&self, run: &PlannedRun) -> Spec {
        Spec {
            seed: run.seed,
            ..self.point(run).spec.clone()
        }
    }

    /// Returns the blocks of the protocol of `run` with their commands as text.
    ///
    /// # Errors
    ///
    /// [`PlanError`] if its files are not those of a plan.
    pub fn blocks(&self, run: &PlannedRun) -> Result<Vec<Block>, PlanError> {
        let source = Source {
            toml: &self.files.toml,
            points: None,
            is_stored: true,
        };
        let point = self.point(run);
        let setting = Setting {
            spec: &point.spec,
            informed: point.informed,
            duration: self.duration,
            variables: &point.variables,
            set_points: None,
        };
        templates(source, &source.read()?.at, setting)
    }

    /// Returns the number of values in a run's time series.
    #[must_use]
    pub fn entries(&self, run: &PlannedRun) -> u64 {
        let steps = self.point(run).steps;
        let orders = self.order_every.map_or(0, |every| steps / every + 1);
        let measures = self.columns.measures.len() as u64;
        let values = self.series_entries(run).saturating_mul(measures);
        orders.saturating_add(values)
    }

    /// Returns the number of steps of a run's time series of the chosen measures, at most.
    pub(crate) fn series_entries(&self, run: &PlannedRun) -> u64 {
        let every = self.columns.series_every;
        every.map_or(0, |every| self.point(run).steps / every + 2)
    }

    /// Returns the number of rows of a run's trajectory, at most: one for each individual at each
    /// recorded step, also for those that the protocol may inject.
    #[must_use]
    pub fn trajectory_rows(&self, run: &PlannedRun) -> f64 {
        let point = self.point(run);
        let injected = point.protocol.as_ref().map_or(0, |it| it.injected());
        let n = injected.saturating_add(point.spec.n as u64);
        let frames = self.record_every.map_or(0, |every| point.steps / every + 2);
        frames as f64 * n.min(MAX_INDIVIDUALS) as f64
    }

    /// Returns the number of bytes of a run's trajectory, about, with as many rows.
    #[must_use]
    pub fn trajectory_bytes(&self, run: &PlannedRun) -> f64 {
        let steps = self.point(run).steps;
        let frames = self.record_every.map_or(0, |every| steps / every + 2);
        let file = if frames > 0 { BYTES_OF_TRAJECTORY } else { 0.0 };
        file + BYTES_OF_FRAME * frames as f64 + BYTES_OF_ROW * self.trajectory_rows(run)
    }

    /// Checks a choice and adds all its replicates.
    fn add_point(
        &mut self,
        (source, file): (Source<'_>, &File),
        grid: &Grid,
        choice: &Choice,
        name: &str,
    ) -> Result<(), PlanError> {
        let reject = |reason: String| source.reject(&grid.span, reason);
        let Choice { spec, .. } = choice;
        let informed = self.base.as_ref().map_or(choice.informed, Base::informed);
        if !(1..=MAX_INDIVIDUALS).contains(&spec.n) {
            let reason = format!("n = {} is outside [1, {MAX_INDIVIDUALS}]", spec.n);
            return Err(source.reject(&grid.span_of("n"), reason));
        }
        let start =
            spec::from_proto(spec, count(spec.n)).map_err(|error| reject(error.to_string()))?;
        let reject_run = |error| {
            let run = numbered(name, 0);
            PlanError::Run { run, error }
        };
        let parameters = &start.parameters;
        let weight = if informed > 0 { parameters.pi2 } else { 0.0 };
        match &self.base {
            Some(base) => {
                let built = base.simulation(&start, Box::new(|_| Ok(())));
                built.map_err(reject_run)?;
            }
            None => {
                let checked = parameters.check(weight);
                checked.map_err(|error| reject_run(error.into()))?;
            }
        }
        // A start in the default disc is not checked: it has room.
        if start.start != Start::Disc(None) {
            begin(&start).map_err(reject_run)?;
        }
        let steps = steps_in(self.duration, parameters.dt);
        if steps > MAX_STEPS {
            let reason = format!("a run has {steps} steps, the limit is {MAX_STEPS}");
            return Err(reject(reason));
        }
        let setting = Setting {
            spec: &start,
            informed: self.base.as_ref().map_or(informed, |_| 0),
            duration: self.duration,
            variables: &choice.variables,
            set_points: self.set_points.as_ref(),
        };
        let protocol = Protocol::resolve(source, &file.at, &file.stop, setting)?;
        let lags = self.columns.measures.iter().map(|it| it.lag(parameters.dt));
        let lag = lags.max().unwrap_or(0);
        if let Some(from) = file.measure.from.as_ref()
            && !self.columns.measures.is_empty()
            && steps_in(self.columns.from, parameters.dt) >= steps
        {
            let (time, duration) = (self.columns.from, self.duration);
            let reason = format!("from = {time} is within the last step: duration = {duration}");
            return Err(source.reject(&from.span(), reason));
        }
        check_past(lag, start.n).map_err(|error| {
            let span = file.measure.columns.first().map_or(0..0, Spanned::span);
            source.reject(&span, error.to_string())
        })?;
        for replicate in 0..grid.replicates {
            let name = numbered(name, replicate);
            self.runs.push(PlannedRun {
                seed: derive_seed(self.seed, &name),
                name,
                point: self.points.len(),
            });
        }
        self.points.push(Point {
            spec: start,
            informed,
            steps,
            variables: choice.variables.clone(),
            protocol,
        });
        Ok(())
    }
}

/// Returns the number of runs of all grids; saturates at `u64::MAX`.
fn count_runs(grids: &[Grid]) -> u64 {
    let runs = grids.iter().map(|grid| {
        let points = grid.size().unwrap_or(u64::MAX);
        points.saturating_mul(grid.replicates)
    });
    runs.fold(0, u64::saturating_add)
}

fn numbered(name: &str, replicate: u64) -> String {
    let space = if name.is_empty() { "" } else { " " };
    format!("{name}{space}#{replicate}")
}

/// Returns the seed of a run: the first 53 bits of BLAKE3 over the experiment's seed, as 8
/// little-endian bytes, and the run's name.
fn derive_seed(seed: u64, name: &str) -> u64 {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&seed.to_le_bytes());
    hasher.update(name.as_bytes());
    let mut first = [0; 8];
    first.copy_from_slice(&hasher.finalize().as_bytes()[..8]);
    u64::from_be_bytes(first) >> 11
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
