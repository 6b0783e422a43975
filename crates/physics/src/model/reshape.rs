//! Changes of the shape of all bodies.

use thiserror::Error;

use super::body::{Body, Nearness, Pose, near_pairs, pose};
use super::{Configuration, Parameters, ParametersError, State};
use crate::plural::counted;

/// Relative tolerance of the factor above the least one: far below a visible change, and far
/// above the rounding error of a gap.
const FACTOR_TOLERANCE: f64 = 1e-9;

/// Why a change of shape is rejected.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum ReshapeError {
    /// `pi1` is outside its range, or needs a shorter step.
    #[error(transparent)]
    Parameters(#[from] ParametersError),
    /// The new bodies overlap more than the old ones did.
    #[error(
        "{} would overlap more than before, {first} and {second} by a gap of {gap}: set make_room \
         to move all individuals apart",
        counted(*.pairs, "pair")
    )]
    NoRoom {
        /// Number of such pairs.
        pairs: usize,
        /// The id of one individual of the first such pair.
        first: u32,
        /// The id of the other.
        second: u32,
        /// The gap of the first pair under the new shape, in body sizes.
        gap: f64,
    },
    /// Two centres coincide: no factor moves them apart.
    #[error("individuals {first} and {second} are at the same point: no factor moves them apart")]
    SamePlace {
        /// The id of one of them.
        first: u32,
        /// The id of the other.
        second: u32,
    },
}

/// Gives all bodies the length over width `pi1`, and returns the factor by which the positions
/// were scaled about the centroid: 1 unless `make_room` was needed.
///
/// No pair may overlap more than before, or cross. The factor is the least one that allows this,
/// or at most a factor 1 + 1e-9 larger. The warm start is kept: it is only a guess of the active
/// set, most contacts remain, and a wrong guess costs time, not accuracy.
///
/// # Errors
///
/// [`ReshapeError::NoRoom`] if a pair has no room and `make_room` is not set;
/// [`ReshapeError::SamePlace`] if it is set and the centres of such a pair coincide;
/// [`ReshapeError::Parameters`] if the new shape is out of range or its tips could move too far in
/// one step. On an error the state is unchanged.
pub fn change_pi1(state: &mut State, pi1: f64, make_room: bool) -> Result<f64, ReshapeError> {
    let configuration = &state.configuration;
    let parameters = Parameters {
        pi1,
        ..state.parameters
    };
    parameters.check(configuration.largest_weight())?;
    let (old, new) = (Body::new(&state.parameters), Body::new(&parameters));
    let tight: Vec<(u32, u32, Nearness)> = near_pairs(new, configuration, 0.0)
        .into_iter()
        .filter(|&(i, j, nearness)| !is_allowed(nearness, allowed(old, configuration, i, j)))
        .collect();
    let Some(&(i, j, Nearness { gap, .. })) = tight.first() else {
        state.parameters = parameters;
        return Ok(1.0);
    };
    let [first, second] = [i, j].map(|k| configuration.id[k as usize]);
    if !make_room {
        return Err(ReshapeError::NoRoom {
            pairs: tight.len(),
            first,
            second,
            gap,
        });
    }
    let mut factor: f64 = 1.0;
    for &(i, j, _) in &tight {
        let poses = [i, j].map(|k| pose(configuration, k as usize));
        if poses[0].x == poses[1].x && poses[0].y == poses[1].y {
            let [first, second] = [i, j].map(|k| configuration.id[k as usize]);
            return Err(ReshapeError::SamePlace { first, second });
        }
        factor = least_factor(new, poses, allowed(old, configuration, i, j), factor);
    }
    state.configuration = scaled(configuration, factor);
    state.parameters = parameters;
    Ok(factor)
}

/// Returns the smallest gap that a pair may have: its old gap, or 0 if the bodies were apart.
fn allowed(old: Body, configuration: &Configuration, i: u32, j: u32) -> f64 {
    let [first, second] = [i, j].map(|k| pose(configuration, k as usize));
    old.nearness(first, second).gap.min(0.0)
}

/// Returns whether a pair has at least the smallest gap and does not cross. Crossing is a condition
/// of its own, since a thinner body can cross another and still overlap less.
fn is_allowed(nearness: Nearness, smallest: f64) -> bool {
    nearness.gap >= smallest && !nearness.crossed
}

/// Finds the least factor, not below `least`, that gives a pair room. A body is convex and
/// symmetric under a half turn, so the gap grows with the distance of the centres along their line,
/// and bisection finds the least factor.
fn least_factor(body: Body, poses: [Pose; 2], smallest: f64, least: f64) -> f64 {
    let has_room = |factor: f64| {
        let apart = Pose {
            x: poses[0].x + factor * (poses[1].x - poses[0].x),
            y: poses[0].y + factor * (poses[1].y - poses[0].y),
            alpha: poses[1].alpha,
        };
        // Scaling all positions rounds them once more.
        is_allowed(body.nearness(poses[0], apart), smallest + ROUNDING)
    };
    if has_room(least) {
        return least;
    }
    let (mut low, mut high) = (least, 2.0 * least);
    while !has_room(high) {
        (low, high) = (high, 2.0 * high);
    }
    while high - low > FACTOR_TOLERANCE * low {
        let middle = f64::midpoint(low, high);
        if has_room(middle) {
            high = middle;
        } else {
            low = middle;
        }
    }
    high
}

/// Several times the spacing of doubles at half a cell, 1.1e-13.
const ROUNDING: f64 = 1e-12;

fn scaled(configuration: &Configuration, factor: f64) -> Configuration {
    let mut scaled = configuration.clone();
    let [x, y] = configuration.centroid();
    scaled
        .x
        .iter_mut()
        .for_each(|value| *value = x + factor * (*value - x));
    scaled
        .y
        .iter_mut()
        .for_each(|value| *value = y + factor * (*value - y));
    scaled
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::model::body::gaps;
    use crate::model::start::disc;

    fn pair(distance: f64, pi1: f64) -> State {
        let mut state = State::default();
        state.parameters.pi1 = pi1;
        state.configuration.push(0.0, 0.0, 0.0);
        state.configuration.push(distance, 0.0, 0.0);
        state
    }

    #[test]
    fn two_in_line_move_apart_to_the_new_length() {
        // Length at pi1 = 4 is 1.6; at pi1 = 8 it is 16/9.
        let mut state = pair(1.7, 4.0);
        let before = state.clone();
        let error = change_pi1(&mut state, 8.0, false).unwrap_err();
        assert!(
            matches!(error, ReshapeError::NoRoom { pairs: 1, first: 0, second: 1, gap } if (gap - (1.7 - 16.0 / 9.0)).abs() < 1e-14)
        );
        assert_eq!(state, before);
        let factor = change_pi1(&mut state, 8.0, true).unwrap();
        let least = 16.0 / 9.0 / 1.7;
        assert!(
            factor >= least && factor < least * (1.0 + 2e-9),
            "{factor} against {least}"
        );
        assert!((state.configuration.centroid()[0] - 0.85).abs() < 1e-15);
        assert_eq!(state.parameters.pi1, 8.0);
    }

    #[test]
    fn positions_stay_if_there_is_room() {
        let mut state = pair(1.8, 4.0);
        let before = state.configuration.clone();
        assert_eq!(change_pi1(&mut state, 8.0, true), Ok(1.0));
        assert_eq!(state.configuration, before);
    }

    #[test]
    fn a_pair_that_overlaps_may_keep_its_overlap() {
        let mut state = pair(1.6 - 1e-3, 4.0);
        assert_eq!(change_pi1(&mut state, 3.0, false), Ok(1.0));
        let factor = change_pi1(&mut state, 4.0, true).unwrap();
        assert!(factor > 1.0, "the earlier overlap is no longer allowed");
    }

    #[test]
    fn discs_pressed_together_do_not_become_crossed_needles() {
        // As discs they overlap by 0.3; as needles of radius 1/33 they would cross, at a gap
        // of only -2/33.
        let mut state = pair(0.7, 1.0);
        state.parameters.dt = 1e-3;
        state.configuration.alpha = vec![0.0, 1.5];
        assert!(matches!(
            change_pi1(&mut state, 32.0, false),
            Err(ReshapeError::NoRoom { .. })
        ));
        assert!(change_pi1(&mut state, 32.0, true).unwrap() > 1.0);
        assert_eq!(gaps(&state.parameters, &state.configuration).crossed, 0);
    }

    #[test]
    fn make_room_leaves_a_group_with_a_worst_gap_near_zero() {
        let mut state = State::default();
        state.configuration = disc(&state.parameters, 74, Some(6.5), 3).unwrap();
        let factor = change_pi1(&mut state, 8.0, true).unwrap();
        assert!(factor > 1.0);
        let measured = gaps(&state.parameters, &state.configuration);
        assert!(
            (0.0..1e-8).contains(&measured.worst_gap.unwrap()),
            "{measured:?}"
        );
    }

    #[test]
    fn rejections_change_nothing() {
        let mut state = pair(5.0, 4.0);
        state.parameters.dt = 0.2;
        let before = state.clone();
        for pi1 in [0.5, 33.0, f64::NAN, 8.0] {
            assert!(matches!(
                change_pi1(&mut state, pi1, true),
                Err(ReshapeError::Parameters(_))
            ));
        }
        assert!(matches!(
            change_pi1(&mut state, 8.0, true),
            Err(ReshapeError::Parameters(
                ParametersError::StepTooLong { .. }
            ))
        ));
        let mut state_at_one_place = pair(0.0, 4.0);
        let error = change_pi1(&mut state_at_one_place, 3.0, true);
        assert_eq!(
            error,
            Err(ReshapeError::SamePlace {
                first: 0,
                second: 1
            })
        );
        assert_eq!(state, before);
    }
}
