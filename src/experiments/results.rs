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
        if let Some(cached) = &*self.0.lock()
            && Arc::ptr_eq(&cached.plan, plan)
            && cached.length == length
        {
            return Ok(cached.results.clone());
        }
        let mut finished = Folder::read(folder, plan).map_err(ExperimentError::unreadable)?;
        let rows = numbered(plan, std::mem::take(&mut finished.rows));
        let results = Results {
            rows: Arc::new(rows),
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
