//! The rows of an experiment's finished runs.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use jostle_experiment::{FinishedRuns, Folder, FolderError, Plan, SeriesKind};
use jostle_proto::OccasionalColumns;
use jostle_results::ResultRow;
use jostle_results::table::{Series, SeriesPart};
use parking_lot::Mutex;

use super::ExperimentManager;
use super::error::ExperimentError;

/// Rows in the plan's order, each with the number of its run in the plan, from 1.
pub type Rows = Arc<Vec<(u64, ResultRow)>>;

/// The finished runs of an experiment.
#[derive(Clone, Debug)]
pub struct Results {
    pub rows: Rows,
    pub columns: Arc<OccasionalColumns>,
    /// The same runs, from which their time series are read.
    pub finished: Arc<FinishedRuns>,
}

/// The results that were read last: a client requests one page after the other.
#[derive(Debug, Default)]
pub struct ResultsCache(Mutex<Option<Cached>>);

#[derive(Debug)]
struct Cached {
    /// The plan that the experiment has since its submission: another experiment may have the name of a
    /// deleted one, and a list of the same length.
    plan: Arc<Plan>,
    /// The length of the list of finished runs, which is only appended to.
    length: u64,
    results: Results,
}

impl ResultsCache {
    pub fn read(&self, folder: &Path, plan: &Arc<Plan>) -> Result<Results, ExperimentError> {
        let list = fs::metadata(folder.join("runs.jsonl"));
        let length = list.map_or(0, |list| list.len());
        let mut columns = None;
        if let Some(cached) = &*self.0.lock()
            && Arc::ptr_eq(&cached.plan, plan)
        {
            if cached.length == length {
                return Ok(cached.results.clone());
            }
            columns = Some(cached.results.columns.clone());
        }
        let mut finished = Folder::read(folder, plan).map_err(ExperimentError::unreadable)?;
        let rows = numbered(plan, std::mem::take(&mut finished.rows));
        let results = Results {
            rows: Arc::new(rows),
            columns: columns.unwrap_or_else(|| Arc::new(plan.occasional_columns())),
            finished: Arc::new(finished),
        };
        *self.0.lock() = Some(Cached {
            plan: plan.clone(),
            length,
            results: results.clone(),
        });
        Ok(results)
    }
}

/// The series that was read last as a whole: each page is then a part of it. One that is long is in a
/// file of its own, of which only the page is read.
#[derive(Debug, Default)]
pub struct SeriesCache(Mutex<Option<CachedSeries>>);

#[derive(Debug)]
struct CachedSeries {
    /// The list of finished runs from which it was read.
    finished: Arc<FinishedRuns>,
    of: (usize, SeriesKind),
    series: Arc<Series>,
}

impl SeriesCache {
    pub fn read(
        &self,
        folder: &Path,
        plan: &Plan,
        results: &Results,
        of: (usize, SeriesKind),
        (after, limit): (u64, usize),
    ) -> Result<SeriesPart, FolderError> {
        let finished = &results.finished;
        let source = Folder::find_series(folder, plan, finished, of)?;
        if let Some(part) = Folder::read_series_part(&source, after, limit)? {
            return Ok(part);
        }
        let series = self.cached(finished, of);
        let series = match series {
            Some(series) => series,
            None => Arc::new(Folder::read_series(folder, plan, finished, of)?),
        };
        *self.0.lock() = Some(CachedSeries {
            finished: finished.clone(),
            of,
            series: series.clone(),
        });
        Ok(SeriesPart::of(&series, after, limit))
    }

    fn cached(&self, finished: &Arc<FinishedRuns>, of: (usize, SeriesKind)) -> Option<Arc<Series>> {
        let cached = self.0.lock();
        let cached = cached.as_ref()?;
        let is_same = Arc::ptr_eq(&cached.finished, finished) && cached.of == of;
        is_same.then(|| cached.series.clone())
    }
}

impl ExperimentManager {
    /// Entries of a time series of one run: at most `limit` after the first `after`, and at most
    /// `values` numbers.
    pub fn series(
        &self,
        kind: SeriesKind,
        (name, run): (&str, &str),
        (after, limit, values): (u64, usize, usize),
    ) -> Result<SeriesPart, ExperimentError> {
        let plan = self.plan(name)?;
        if !kind.is_in(&plan) {
            return Err(match kind {
                SeriesKind::Order => ExperimentError::NoOrder(name.to_owned()),
                SeriesKind::Measures => ExperimentError::NoSeries(name.to_owned()),
            });
        }
        let limit = limit.min(values / (kind.measures(&plan).len() + 2)).max(1);
        let (index, mut results) = self.finished_run(name, &plan, run)?;
        let folder = self.0.jobs.folder(name);
        let of = (index, kind);
        let source = Folder::find_series(&folder, &plan, &results.finished, of);
        if source.is_ok_and(|source| source.is_long_line()) && self.move_series(name, &plan).is_ok()
        {
            results = self.results(name, &plan)?;
        }
        let series = &self.0.series;
        let part = series.read(&folder, &plan, &results, of, (after, limit));
        let of_run = (name, plan.as_ref(), index);
        part.map_err(|error| self.unreadable_file(of_run, &results, &error))
    }

    /// Moves long series that an earlier version wrote to files, as opening the folder does.
    fn move_series(&self, name: &str, plan: &Plan) -> Result<(), ExperimentError> {
        let _serialized = self.begin_change()?;
        // One that is queued is opened when it starts.
        if self.entry(name, |entry| {
            entry.status.phase.is_over() && !entry.is_ending()
        })? {
            let opened = Folder::open(&self.0.jobs.folder(name), plan);
            opened.map_err(ExperimentError::not_stored)?;
        }
        Ok(())
    }
}

/// Rows in the plan's order with the numbers of their runs.
fn numbered(plan: &Plan, rows: Vec<ResultRow>) -> Vec<(u64, ResultRow)> {
    let mut runs = (1..).zip(plan.runs());
    rows.into_iter()
        .filter_map(|row| {
            let (number, _) = runs.find(|(_, run)| run.name == row.run)?;
            Some((number, row))
        })
        .collect()
}
