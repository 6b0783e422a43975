//! Names of measures in requests and settings.

use jostle_measures::histograms::HistogramError;
use jostle_measures::{Measure, MeasureError, TooCostly, histograms};
use jostle_proto::MAX_PUBLISHED_MEASURES;
use thiserror::Error;

/// Maximum number of measures in one reply: each gap of `clusters.*` is a search of its own.
pub const MAX_MEASURES: usize = 64;

/// Maximum characters of a name in an error.
const MAX_SHOWN: usize = 64;

/// Why measures are not computed.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum MeasuresError {
    /// The text is no measure.
    #[error(transparent)]
    Measure(#[from] Box<MeasureError>),
    /// A running swarm has no past.
    #[error(
        "`{0}` needs the states of earlier steps, which a daemon keeps for conditions only: leave it \
         out, use it in a condition, or choose it as a column of an experiment"
    )]
    NeedsPast(String),
    /// The same measure is requested twice.
    #[error("`{0}` is named twice: name it once")]
    Twice(String),
    /// More measures are requested than one message has.
    #[error("more than {0} measures: name at most {0} measures")]
    TooMany(usize),
    /// The histogram is not computed.
    #[error(transparent)]
    Histogram(#[from] HistogramError),
    /// The pair correlation has no area.
    #[error(
        "pair_correlation is undefined while all individuals are on one line: their convex hull, \
         the area of which it needs, has none: take steps, or inject individuals"
    )]
    NoArea,
    /// The group is too large for a histogram.
    #[error(
        "`{name}` is computed for at most {} individuals, the swarm has {n}: use a smaller group, \
         or compute it from a snapshot of the swarm",
        histograms::MAX_INDIVIDUALS
    )]
    TooLarge {
        /// The histogram.
        name: &'static str,
        /// The number of individuals.
        n: usize,
    },
    /// The group is too large for it.
    #[error(transparent)]
    TooCostly(#[from] TooCostly),
}

/// Parses measures of one state: at most `max`, each once.
///
/// # Errors
///
/// [`MeasuresError`].
pub fn parse<'a>(
    names: impl Iterator<Item = &'a str>,
    max: usize,
) -> Result<Vec<Measure>, MeasuresError> {
    let mut measures = Vec::new();
    for text in names {
        if measures.len() == max {
            return Err(MeasuresError::TooMany(max));
        }
        let text: String = text.chars().take(MAX_SHOWN).collect();
        let measure: Measure = text.parse().map_err(Box::new)?;
        if measure.definition().needs_past() {
            return Err(MeasuresError::NeedsPast(measure.to_string()));
        }
        if measures.contains(&measure) {
            return Err(MeasuresError::Twice(measure.to_string()));
        }
        measures.push(measure);
    }
    Ok(measures)
}

/// Checks the names of the measures that a swarm publishes, and returns their normal forms.
///
/// # Errors
///
/// [`MeasuresError`].
pub fn published(names: &[String]) -> Result<Vec<String>, MeasuresError> {
    let measures = parse(names.iter().map(String::as_str), MAX_PUBLISHED_MEASURES)?;
    Ok(measures.iter().map(ToString::to_string).collect())
}

/// Returns the message of published measures: none if there are none.
pub fn published_to_proto(names: &[String]) -> Option<Vec<String>> {
    (!names.is_empty()).then(|| names.to_vec())
}
