//! What a run that is executed passes on, since it would be too much for memory.

use jostle_physics::model::State;

use crate::series::SeriesKind;

/// What takes the frames and the rows that are too many for the result of a run.
pub trait Recorder {
    /// Takes the state of a frame of the trajectory.
    fn add_frame(&self, state: &State);

    /// Takes rows of a series, after earlier ones of so many bytes.
    fn add_rows(&self, kind: SeriesKind, rows: &[u8], earlier: u64);
}
