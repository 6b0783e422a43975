//! The usual values of a parameter.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The usual values of a parameter, for a slider. They are those of the paper where it varies one, else around
/// its value; others are valid, too.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Usual {
    /// The least.
    pub from: f64,
    /// The largest.
    pub to: f64,
    /// How they are spread.
    pub scale: Scale,
}

/// How values are spread over a range.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Scale {
    /// Evenly.
    Linear,
    /// Evenly in their logarithms.
    Logarithmic,
}

/// Usual values, evenly spread.
pub(crate) const fn linear(from: f64, to: f64) -> Usual {
    let scale = Scale::Linear;
    Usual { from, to, scale }
}

/// Usual values, evenly spread in their logarithms.
pub(crate) const fn logarithmic(from: f64, to: f64) -> Usual {
    let scale = Scale::Logarithmic;
    Usual { from, to, scale }
}
