//! A part of an experiment, which one machine executes.

use jostle_experiment::Subset;

/// One part of an experiment.
pub struct Part {
    /// Its number, from 1.
    pub number: usize,
    /// The runs of it that are to be executed.
    pub runs: Subset,
}
