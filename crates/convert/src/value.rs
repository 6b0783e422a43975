//! Checks of numbers in a message that need no swarm.

use jostle_physics::simulation::Rate;
use jostle_proto::LARGEST_WHOLE;
use serde_json::Value;
use thiserror::Error;

use crate::measures::MeasuresError;

/// Maximum rate, in time units per second of wall clock.
const MAX_RATE: f64 = 1e6;

/// Maximum number of steps between two published states.
const MAX_PUBLISH_EVERY: u64 = 1_000_000_000;

/// Minimum time for which a swarm waits for a silent controller, in seconds: a reply takes this long over a
/// slow network.
const MIN_IDLE_SECS: f64 = 0.1;

/// Maximum time for which a swarm waits for a silent controller, in seconds: eleven days.
const MAX_IDLE_SECS: f64 = 1e6;

/// Why a value of a message is rejected.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum WireError {
    /// A number is outside its range.
    #[error("{field} = {value} is outside its range")]
    OutOfRange {
        /// The field.
        field: &'static str,
        /// Its value.
        value: Value,
    },
    /// The published measures are invalid.
    #[error("measures: {0}")]
    Measures(#[from] MeasuresError),
    /// A column does not have one number for each individual.
    #[error("{field} has {length} numbers, n is {n}")]
    Length {
        /// The column.
        field: &'static str,
        /// Its length.
        length: usize,
        /// The number of individuals.
        n: u64,
    },
}

/// Why arguments are rejected.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ArgsError {
    /// A value is outside its range.
    #[error(transparent)]
    Value(#[from] WireError),
    /// A field is missing or inconsistent with others.
    #[error("{field} {problem}")]
    Field {
        /// The field.
        field: &'static str,
        /// What is wrong with it, and the remedy.
        problem: &'static str,
    },
}

impl WireError {
    /// Returns the error for a number outside its range.
    pub fn out_of_range<V: Copy + Into<Value> + ToString>(field: &'static str, value: V) -> Self {
        WireError::OutOfRange {
            field,
            // JSON has no number for NaN and infinity: send them as text.
            value: match value.into() {
                Value::Null => value.to_string().into(),
                value => value,
            },
        }
    }
}

/// Checks that a double can represent a whole number.
///
/// # Errors
///
/// [`WireError::OutOfRange`].
pub fn whole(field: &'static str, number: u64) -> Result<u64, WireError> {
    if number <= LARGEST_WHOLE {
        return Ok(number);
    }
    Err(WireError::out_of_range(field, number))
}

/// Checks a rate, in time units per second of wall clock.
///
/// # Errors
///
/// [`WireError::OutOfRange`].
pub fn rate(rate: Rate) -> Result<Rate, WireError> {
    match rate {
        Some(rate) if !(rate > 0.0 && rate <= MAX_RATE) => {
            Err(WireError::out_of_range("rate", rate))
        }
        rate => Ok(rate),
    }
}

/// Checks a number of steps between two published states.
///
/// # Errors
///
/// [`WireError::OutOfRange`].
pub fn publish_every(steps: u64) -> Result<u64, WireError> {
    if (1..=MAX_PUBLISH_EVERY).contains(&steps) {
        return Ok(steps);
    }
    Err(WireError::out_of_range("publish_every", steps))
}

/// Converts the longest time in seconds for which a swarm waits for a controller that sends nothing: 0 is
/// no limit.
///
/// # Errors
///
/// [`WireError::OutOfRange`].
pub fn max_idle_secs(secs: f64) -> Result<Option<f64>, WireError> {
    match (0.0..=MAX_IDLE_SECS).contains(&secs) {
        true => Ok((secs > 0.0).then_some(secs)),
        false => Err(WireError::out_of_range("max_idle_secs", secs)),
    }
}

/// Checks a time that [`max_idle_secs`] returned of a new command. Earlier versions accepted less, and journals
/// and snapshots may have it.
///
/// # Errors
///
/// [`WireError::OutOfRange`].
pub fn new_max_idle_secs(secs: Option<f64>) -> Result<(), WireError> {
    match secs.filter(|secs| *secs < MIN_IDLE_SECS) {
        Some(secs) => Err(WireError::out_of_range("max_idle_secs", secs)),
        None => Ok(()),
    }
}

/// Checks the weight with which individuals are informed. An individual of weight 0 is uninformed.
///
/// # Errors
///
/// [`WireError::OutOfRange`] unless it is above 0. The model checks the upper limit.
pub fn weight(weight: f64) -> Result<f64, WireError> {
    if weight > 0.0 {
        return Ok(weight);
    }
    Err(WireError::out_of_range("weight", weight))
}

/// Converts a number of individuals; saturates at `usize::MAX`.
pub fn count(count: u64) -> usize {
    usize::try_from(count).unwrap_or(usize::MAX)
}
