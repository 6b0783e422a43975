//! Why measures are not computed.

use jostle_convert::WireCode;
use jostle_convert::error::object;
use jostle_measures::MeasureError;
use jostle_proto::ErrorCode;
use serde_json::{Map, Value, json};
use thiserror::Error;

/// Maximum number of measures in one reply: each gap of `clusters.*` is a search of its own.
pub const MAX_MEASURES: usize = 64;

/// Why measures are not computed.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum MeasuresError {
    /// The text is no measure.
    #[error(transparent)]
    Measure(#[from] Box<MeasureError>),
    /// A running swarm has no past.
    #[error(
        "`{0}` needs the states of earlier steps, which a daemon does not keep: leave it out, or \
         choose it as a column of an experiment"
    )]
    NeedsPast(String),
    /// The same measure is requested twice.
    #[error("`{0}` is named twice: name it once")]
    Twice(String),
    /// More measures are requested than one reply has.
    #[error("more than {MAX_MEASURES} measures: request at most {MAX_MEASURES} measures at once")]
    TooMany,
    /// The group is too large for it.
    #[error(
        "`{measure}` is computed for at most {limit} individuals, the swarm has {n}: leave it out"
    )]
    TooLarge {
        /// The measure.
        measure: String,
        /// The number of individuals.
        n: usize,
        /// The limit.
        limit: usize,
    },
}

impl WireCode for MeasuresError {
    fn code(&self) -> ErrorCode {
        match self {
            MeasuresError::TooLarge { .. } => ErrorCode::ResourceExhausted,
            _ => ErrorCode::InvalidArgument,
        }
    }

    fn details(&self) -> Map<String, Value> {
        object(match self {
            MeasuresError::TooLarge { n, limit, .. } => json!({"n": n, "limit": limit}),
            _ => json!({"field": "names"}),
        })
    }
}
