//! What came of an experiment so far, page by page.

use std::sync::{Arc, Mutex, PoisonError};

use jostle_results::ResultRow;
use jostle_results::table::OrderSeries;

use super::{Lab, LabError};
use jostle_experiment::{Folder, Plan};

/// The rows of one experiment as they were read last, each with its run's number in the plan.
type Rows = Arc<Vec<(u64, ResultRow)>>;

/// The rows that were asked for last, of which experiment and of how many bytes of its list: who
/// asks for a page asks for the next one too.
#[derive(Debug, Default)]
pub struct Desk(Mutex<Option<(String, u64, Rows)>>);

impl Lab {
    /// Visits the rows of an experiment's finished runs with their numbers in its plan, from 1, in
    /// that order and only those numbered higher than `after`.
    ///
    /// # Errors
    ///
    /// [`LabError`].
    pub fn rows(&self, name: &str) -> Result<Rows, LabError> {
        let plan = self.plan(name)?;
        let extent = self.shelf().extent(name);
        let desk = &self.desk().0;
        let lying = desk.lock().unwrap_or_else(PoisonError::into_inner).clone();
        if let Some((of, length, rows)) = lying
            && of == name
            && length == extent
        {
            return Ok(rows);
        }
        let read = Folder::read(&self.shelf().folder(name), &plan)
            .map_err(|error| LabError::Unreadable(error.to_string()))?;
        let rows: Rows = Arc::new(numbered(&plan, read));
        let kept = (name.to_owned(), extent, rows.clone());
        *desk.lock().unwrap_or_else(PoisonError::into_inner) = Some(kept);
        Ok(rows)
    }

    /// The order over time of one run.
    ///
    /// # Errors
    ///
    /// [`LabError`].
    pub fn order(&self, name: &str, run: &str) -> Result<OrderSeries, LabError> {
        let plan = self.plan(name)?;
        if plan.order_every.is_none() {
            return Err(LabError::NoSeries(name.to_owned()));
        }
        let Some(index) = plan.runs().iter().position(|it| it.name == run) else {
            return Err(LabError::UnknownRun {
                name: name.to_owned(),
                run: run.chars().take(200).collect(),
            });
        };
        let number = index as u64 + 1;
        let rows = self.rows(name)?;
        if rows
            .binary_search_by_key(&number, |(number, _)| *number)
            .is_err()
        {
            let (name, run) = (name.to_owned(), run.to_owned());
            return Err(LabError::Unfinished { name, run });
        }
        Folder::read_order(&self.shelf().folder(name), &plan, index)
            .map_err(|error| LabError::Unreadable(error.to_string()))
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
