//! The report of a step, and the reasons for which a step fails.

use thiserror::Error;

use crate::model::parameters::ParametersError;
use crate::model::{Attraction, State};

/// Accuracy and work of a step, and what it found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepReport {
    /// The residual `max |min(λ, s)|` over the contacts, in body sizes.
    pub residual: f64,
    /// Whether the residual exceeds [`TARGET`](super::solve::TARGET), but not
    /// [`ACCEPTABLE`](super::solve::ACCEPTABLE).
    pub degraded: bool,
    /// Number of contacts listed.
    pub contacts: usize,
    /// Number of contacts with a positive multiplier.
    pub active: usize,
    /// Number of linear systems factored, including one for each iteration of Clarabel.
    pub iterations: usize,
    /// Number of calls of Clarabel.
    pub fallback: usize,
    /// The worst gap of any contact at the start of the step, in body sizes; `None` if no contact
    /// was within the reach.
    pub worst_gap: Option<f64>,
    /// Number of crossed pairs at the start of the step; 0 unless the contact rule is `closest`.
    pub crossed: usize,
    /// Ids of the individuals that became uninformed at the end of the step.
    pub lapsed: Vec<u32>,
}

/// The reason for which a step failed.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum StepError {
    /// The parameters of the state are outside their ranges: they were changed without a check.
    #[error(transparent)]
    Parameters(#[from] ParametersError),
    /// Two axes cross before or after the step, or in the configuration about which `relinearise`
    /// linearises: their distance has no gradient. Does not occur under `closest`.
    #[error(
        "the bodies of individuals {first} and {second} cross: a shorter dt or a smaller pi4 avoids it"
    )]
    CrossedBodies {
        /// Id of the first individual.
        first: u32,
        /// Id of the second individual.
        second: u32,
    },
    /// No solution had a residual of at most [`ACCEPTABLE`](super::solve::ACCEPTABLE), or further
    /// contacts were missed in every one of the lists.
    #[error("the step is only solved to {residual}")]
    NotSolved {
        /// The least residual reached; infinite if there was no solution or the lists ran out.
        residual: f64,
    },
    /// As one of the others, and the attraction [`Attraction::Power`], which is not limited, turned a
    /// free body further in the step than `dt` permits under the other laws.
    #[error(
        "attraction power={exponent} turns individual {id} by {} rad in one step, and contacts cannot be \
         solved: a smaller exponent, pi3 or dt avoids it", rounded(*turn)
    )]
    Overturned {
        /// The exponent.
        exponent: f64,
        /// Id of the individual that turned furthest.
        id: u32,
        /// The most that it could turn, in radians.
        turn: f64,
    },
    /// A position or angle is not a finite number before or after the step.
    #[error("the position of individual {id} is not a finite number")]
    NotFinite {
        /// Id of the individual.
        id: u32,
    },
}

impl StepError {
    /// Returns the error of a step with this attraction, or [`StepError::Overturned`] if that is the cause.
    ///
    /// - Shapes: n vectors of `pull`.
    pub(super) fn with_cause(self, state: &State, pull: &[[f64; 2]]) -> Self {
        let parameters = &state.parameters;
        let (Attraction::Power { exponent }, false) =
            (parameters.attraction, matches!(self, Self::Parameters(_)))
        else {
            return self;
        };
        let lengths = pull.iter().map(|[x, y]| libm::hypot(*x, *y)).enumerate();
        let longest = lengths.max_by(|(_, one), (_, other)| one.total_cmp(other));
        let Some((index, longest)) = longest else {
            return self;
        };
        // The limit of `Parameters::longest_step`, with the pull itself in place of its bound of 1.
        let turn = parameters.dt * parameters.pi3 * longest;
        let travel = parameters.dt + parameters.half_length() * turn;
        // Not if it is NaN: then a position is.
        if travel > 2.0 * parameters.radius() {
            let id = state.configuration.id[index];
            return Self::Overturned { exponent, id, turn };
        }
        self
    }
}

/// Formats an angle: how large it is matters, not its digits.
fn rounded(turn: f64) -> String {
    match turn {
        ..1000.0 => format!("{turn:.1}"),
        _ => format!("{turn:.0e}"),
    }
}
