//! States for the unit tests.

use jostle_physics::model::State;

use crate::{Measure, Past, View};

/// Returns a state of individuals at these positions and headings, with the default parameters:
/// bodies 1.6 long and 0.4 wide, `dt = 0.02`.
pub fn state(poses: &[[f64; 3]]) -> State {
    let mut state = State::default();
    for &[x, y, alpha] in poses {
        state.configuration.push(x, y, alpha);
    }
    state
}

/// As [`state`], with discs of diameter 1 that all head along +x.
pub fn discs(places: &[[f64; 2]]) -> State {
    let poses: Vec<[f64; 3]> = places.iter().map(|&[x, y]| [x, y, 0.0]).collect();
    let mut state = state(&poses);
    state.parameters.pi1 = 1.0;
    state
}

/// Evaluates a measure without a past.
pub fn value(measure: &str, state: &State) -> Option<f64> {
    value_after(measure, state, &Past::new(0))
}

/// Evaluates a measure.
#[expect(clippy::unwrap_used, reason = "tests")]
pub fn value_after(measure: &str, state: &State, past: &Past) -> Option<f64> {
    let measure: Measure = measure.parse().unwrap();
    measure.evaluate(&View::new(state, past))
}

/// Asserts that a measure has a value, except for rounding.
#[track_caller]
pub fn assert_near(actual: Option<f64>, expected: f64) {
    let is_near = actual.is_some_and(|actual| (actual - expected).abs() < 1e-12);
    assert!(is_near, "{actual:?} is not {expected}");
}
