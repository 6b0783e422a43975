//! Digests of what is too long for the result of a run: two executions are compared by them, with
//! neither in memory.

use std::cell::RefCell;

use blake3::{Hash, Hasher};
use jostle_physics::model::State;
use jostle_results::table::{Series, Trajectory};

use crate::run::Recorder;
use crate::series::{SeriesKind, encode};
use crate::trajectory::frame;

/// Digests of the rows of both long series and of the trajectory of a run.
#[derive(Default)]
pub struct Digests(RefCell<[Hasher; 3]>);

impl Digests {
    /// Adds rows of a series.
    pub fn add_series(&self, kind: SeriesKind, rows: &Series) {
        self.0.borrow_mut()[kind as usize].update(&encode(rows));
    }

    /// Adds rows of the trajectory.
    pub fn add_trajectory(&self, rows: &Trajectory) {
        let mut bytes = Vec::with_capacity(45 * rows.len());
        for row in 0..rows.len() {
            bytes.extend(rows.step[row].to_le_bytes());
            bytes.extend(rows.id[row].to_le_bytes());
            for column in [&rows.time, &rows.x, &rows.y, &rows.alpha] {
                bytes.extend(column[row].to_le_bytes());
            }
            bytes.push(rows.informed[row].into());
        }
        let [.., trajectory] = &mut *self.0.borrow_mut();
        trajectory.update(&bytes);
    }

    /// Returns the digests.
    pub fn finish(self) -> [Hash; 3] {
        self.0.into_inner().map(|hasher| hasher.finalize())
    }
}

impl Recorder for Digests {
    fn add_frame(&self, state: &State) {
        self.add_trajectory(&frame(state));
    }

    fn add_rows(&self, kind: SeriesKind, rows: &[u8], _: u64) {
        self.0.borrow_mut()[kind as usize].update(rows);
    }
}
