//! The set-points of a run: directions, weights and drives that controllers of a swarm gave its
//! individuals, as a CSV with a row for each individual and step.

mod log;
mod read;

use std::collections::BTreeSet;
use std::ops::Range;

use jostle_physics::model::Drive;
use jostle_physics::simulation::{self, Simulation};

pub use self::log::SetPointLog;
use crate::error::PlanError;
use crate::files::shown;

/// The columns of the CSV. `after` is the number of blocks that are executed at this step before.
const COLUMNS: [&str; 7] = [
    "step",
    "id",
    "direction",
    "weight",
    "turn",
    "speed",
    "after",
];

/// The columns that a CSV must have.
const REQUIRED: usize = 3;

/// The turning rate or the speed of the model, instead of a number.
const MODEL: &str = "model";

/// What a controller did with an individual.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SetPoint {
    /// It informed the individual.
    Steer {
        /// The preferred direction, in radians.
        direction: f64,
        /// The weight; none is `pi2`.
        weight: Option<f64>,
        /// The drive; none leaves it as it is.
        drive: Option<Drive>,
    },
    /// It made the individual uninformed, without a drive.
    Release,
}

/// The CSV of a file, checked.
#[derive(Clone, Debug, PartialEq)]
pub struct SetPointTable {
    place: Place,
    /// In the order of their steps and, within a step, of `after`.
    rows: Vec<Row>,
    /// The largest id; none without rows.
    largest: Option<u32>,
}

/// Where the CSV stands.
#[derive(Clone, Debug, PartialEq)]
enum Place {
    /// In a file, as the TOML names it.
    File(String),
    /// In the TOML: the line before its first one.
    Within(usize),
}

#[derive(Clone, Debug, PartialEq)]
struct Row {
    step: u64,
    /// The number of blocks of this step that are executed before.
    after: u64,
    id: u32,
    point: SetPoint,
    line: usize,
}

impl Place {
    fn reject(&self, line: usize, column: usize, reason: String) -> PlanError {
        match self {
            Place::File(file) => PlanError::SetPoints {
                file: file.clone(),
                line,
                column,
                reason: shown(file, reason),
            },
            Place::Within(before) => PlanError::Field {
                line: before + line,
                column: 1,
                reason: format!("setpoints, column {column}: {reason}"),
            },
        }
    }

    /// Returns the line for the reason of a fault.
    fn of_line(&self, line: usize) -> String {
        match self {
            Place::File(file) => format!("{file}, line {line}"),
            Place::Within(before) => format!("setpoints of line {}", before + line),
        }
    }
}

impl SetPointTable {
    /// Checks that the rows are within a run of `steps` steps, and that their individuals can exist:
    /// at most `most`.
    ///
    /// # Errors
    ///
    /// [`PlanError`] with the place of the first row that is wrong.
    pub fn check(&self, steps: u64, most: u64) -> Result<(), PlanError> {
        // A grid checks the same rows for each of its points.
        let is_within = self.rows.last().is_none_or(|row| row.step < steps);
        if is_within && self.largest.is_none_or(|id| u64::from(id) < most) {
            return Ok(());
        }
        for Row { step, id, line, .. } in &self.rows {
            if *step >= steps {
                let reason = format!("step = {step} is not before the end, step {steps}");
                return Err(self.place.reject(*line, 1, reason));
            }
            if u64::from(*id) >= most {
                let reason =
                    format!("id = {id} cannot exist: the group has at most {most} individuals");
                return Err(self.place.reject(*line, 2, reason));
            }
        }
        Ok(())
    }

    /// Returns the number of rows, and the steps of the first and of the last one.
    pub fn extent(&self) -> (usize, [u64; 2]) {
        let step = |row: Option<&Row>| row.map_or(0, |row| row.step);
        let ends = [step(self.rows.first()), step(self.rows.last())];
        (self.rows.len(), ends)
    }

    /// Applies the rows of a step that follow so many of its blocks.
    ///
    /// # Errors
    ///
    /// The reason if a set-point is invalid now.
    pub fn apply(&self, after: Range<u64>, simulation: &mut Simulation) -> Result<(), String> {
        let step = simulation.state.step;
        let from = |after: u64| {
            self.rows
                .partition_point(|row| (row.step, row.after) < (step, after))
        };
        let end = match after.end {
            // The last rows of the step.
            u64::MAX => self.rows.partition_point(|row| row.step <= step),
            end => from(end),
        };
        let rows = &self.rows[from(after.start)..end];
        // What frees a weight comes first: together they are valid if they were so one by one.
        let released = rows.iter().filter(|row| row.point == SetPoint::Release);
        let released: BTreeSet<u32> = released.map(|row| row.id).collect();
        simulation.release(&released);
        for is_driven in [false, true] {
            let set = steered(rows, is_driven, simulation.state.parameters.pi2);
            let Err(error) = simulation.steer(&set) else {
                continue;
            };
            // Alone, a row that is wrong fails as well.
            let line = rows
                .iter()
                .find(|row| {
                    let set = steered(
                        std::slice::from_ref(*row),
                        is_driven,
                        simulation.state.parameters.pi2,
                    );
                    simulation.steer(&set).is_err()
                })
                .or(rows.first())
                .map_or(1, |row| row.line);
            return Err(format!(
                "step {step}: {}: {error}",
                self.place.of_line(line)
            ));
        }
        Ok(())
    }
}

/// Returns the set-points with a drive, or without one.
fn steered(rows: &[Row], is_driven: bool, usual: f64) -> simulation::SetPoints {
    let (mut set, mut weights, mut drives) = <(simulation::SetPoints, Vec<_>, Vec<_>)>::default();
    for row in rows {
        let SetPoint::Steer {
            direction,
            weight,
            drive,
        } = row.point
        else {
            continue;
        };
        if drive.is_some() != is_driven {
            continue;
        }
        set.ids.push(row.id);
        set.direction.push(direction);
        weights.push(weight.unwrap_or(usual));
        drives.extend(drive);
    }
    set.weight = Some(weights);
    set.drives = is_driven.then_some(drives);
    set
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
