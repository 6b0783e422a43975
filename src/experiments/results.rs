//! The rows of an experiment's finished runs.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use jostle_experiment::{FinishedRuns, Folder, Plan};
use jostle_results::ResultRow;
use parking_lot::Mutex;

use super::error::ExperimentError;

/// Rows in the plan's order, each with the number of its run in the plan, from 1.
pub type Rows = Arc<Vec<(u64, ResultRow)>>;

/// The finished runs of an experiment.
#[derive(Clone, Debug)]
pub struct Results {
    pub rows: Rows,
    /// The same runs, from which their time series are read.
    pub finished: Arc<FinishedRuns>,
}

/// The results that were read last: a client requests one page after the other.
#[derive(Debug, Default)]
pub struct ResultsCache(Mutex<Cached>);

#[derive(Debug, Default)]
struct Cached {
    /// With the name of their experiment and the length of its list of finished runs.
    last: Option<(String, u64, Results)>,
    /// How many experiments were deleted. Another experiment may have the name of a deleted one, and a
    /// list of the same length.
    deletions: u64,
}

impl ResultsCache {
    /// Drops the results of a deleted experiment, also those that another thread reads at present.
    pub fn forget_deleted(&self) {
        let mut cached = self.0.lock();
        cached.last = None;
        cached.deletions += 1;
    }

    pub fn read(&self, name: &str, folder: &Path, plan: &Plan) -> Result<Results, ExperimentError> {
        // The list is only appended to.
        let list = fs::metadata(folder.join("runs.jsonl"));
        let length = list.map_or(0, |list| list.len());
        let deletions = {
            let cached = self.0.lock();
            if let Some((of, its_length, results)) = &cached.last
                && of == name
                && *its_length == length
            {
                return Ok(results.clone());
            }
            cached.deletions
        };
        let mut finished = Folder::read(folder, plan).map_err(ExperimentError::unreadable)?;
        let rows = numbered(plan, std::mem::take(&mut finished.rows));
        let results = Results {
            rows: Arc::new(rows),
            finished: Arc::new(finished),
        };
        let mut cached = self.0.lock();
        if cached.deletions == deletions {
            cached.last = Some((name.to_owned(), length, results.clone()));
        }
        Ok(results)
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
