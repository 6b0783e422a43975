//! Errors in the text of a measure.

use thiserror::Error;

use crate::definition::Argument;
use crate::registry::definitions;

/// Maximum number of individuals for measures with a cost above n, where they are evaluated beside
/// live swarms: `neighbour_*` cost n² if all centres are on one line, and 2·10⁸ pairs take about a
/// second.
pub const MAX_COSTLY_INDIVIDUALS: usize = 20_000;

/// The least similarity of a name that is suggested for an unknown one, from 0 to 1.
const MIN_SIMILARITY: f64 = 0.7;

/// The group is too large for a measure.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error(
    "`{measure}` is computed for at most {MAX_COSTLY_INDIVIDUALS} individuals, the swarm has {n}: \
     leave it out"
)]
pub struct TooCostly {
    /// The measure.
    pub measure: String,
    /// The number of individuals.
    pub n: usize,
}

/// Why the text of a measure is rejected.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum MeasureError {
    /// No measure has this name.
    #[error("unknown measure `{name}`: {remedy}")]
    Unknown {
        /// The name.
        name: String,
        /// The measure with the most similar name, or all of them.
        remedy: String,
    },
    /// The argument has no closing parenthesis.
    #[error("`{0}` has no closing parenthesis at its end: write NAME(ARGUMENT)")]
    Open(String),
    /// The measure has no argument.
    #[error("`{name}` has no argument: leave out the parentheses")]
    NoArgument {
        /// The measure.
        name: &'static str,
    },
    /// A required argument is missing.
    #[error("`{name}` requires its {} in {}: write {name}({})", .argument.name, .argument.unit, .argument.name)]
    Missing {
        /// The measure.
        name: &'static str,
        /// Its argument.
        argument: Argument,
    },
    /// The argument is no finite number.
    #[error("the {} of `{name}` is no finite number: `{text}`", .argument.name)]
    NotANumber {
        /// The measure.
        name: &'static str,
        /// Its argument.
        argument: Argument,
        /// The text.
        text: String,
    },
    /// The argument is outside its range.
    #[error("the {} of `{name}` is {value}, it must be {} {}", .argument.name, .argument.range_text(), .argument.unit)]
    OutOfRange {
        /// The measure.
        name: &'static str,
        /// Its argument.
        argument: Argument,
        /// The value.
        value: f64,
    },
}

impl MeasureError {
    /// Creates the error for an unknown name, with the most similar one.
    pub(crate) fn unknown(name: &str) -> Self {
        let names = definitions().iter().map(|definition| definition.name);
        let mut best = (MIN_SIMILARITY, None);
        for known in names.clone() {
            let similarity = similarity(name, known);
            if similarity > best.0 {
                best = (similarity, Some(known));
            }
        }
        let remedy = match best.1 {
            Some(known) => format!("did you mean `{known}`?"),
            None => format!("there are {}", names.collect::<Vec<_>>().join(", ")),
        };
        let name = name.to_owned();
        MeasureError::Unknown { name, remedy }
    }
}

fn similarity(name: &str, known: &str) -> f64 {
    // The beginning of a name matches, however long the rest is.
    if name.len() > 2 && known.starts_with(name) {
        return 1.0;
    }
    strsim::jaro(&name.to_lowercase(), known)
}
