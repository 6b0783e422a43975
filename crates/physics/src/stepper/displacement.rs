//! Displacements of all individuals: how to apply, bound and check them.

use super::StepError;
use crate::model::{CELL, Configuration, Parameters, Stepping};

/// Margin of a bound on a distance for rounding, at the largest coordinates and angles.
pub const ROUNDING: f64 = 1e-6;

/// Returns the largest gap of a contact in the first list.
pub fn reach(parameters: &Parameters, configuration: &Configuration) -> f64 {
    match parameters.stepping {
        Stepping::Position => parameters.reach(configuration.largest_weight()),
        // Contacts with a gap up to a margin for rounding are found, whatever the overlap; those
        // with a gap above 0 are then removed.
        Stepping::Velocity => ROUNDING,
    }
}

/// Checks that the sum of coordinates of every individual is finite.
///
/// - Shapes: n sums.
///
/// # Errors
///
/// [`StepError::NotFinite`] with the first individual whose sum is not.
pub fn all_finite(
    configuration: &Configuration,
    sums: impl Iterator<Item = f64> + Clone,
) -> Result<(), StepError> {
    // All in one pass without a branch for each, since nearly always all are finite.
    let finite = sums.clone().fold(true, |all, sum| all & sum.is_finite());
    if finite {
        return Ok(());
    }
    let first = sums.into_iter().position(|sum| !sum.is_finite());
    let id = configuration.id[first.expect("one is not finite")];
    Err(StepError::NotFinite { id })
}

/// Returns an upper bound on the displacement of any point of an axis of half-length `h`.
pub fn furthest_travel(h: f64, displacement: &[[f64; 3]]) -> f64 {
    let larger = |one: f64, other: f64| if one > other { one } else { other };
    let (mut travel, mut turn) = ([0.0; 4], [0.0; 4]);
    for four in displacement.chunks(4) {
        for (lane, [x, y, alpha]) in four.iter().enumerate() {
            travel[lane] = larger(x * x + y * y, travel[lane]);
            turn[lane] = larger(alpha.abs(), turn[lane]);
        }
    }
    let [travel, turn] = [travel, turn].map(|lanes| lanes.into_iter().fold(0.0, larger));
    travel.sqrt() + h * turn
}

/// Applies n displacements, and moves the origin if the centroid is too far from it.
pub fn displace(configuration: &mut Configuration, displacement: &[[f64; 3]]) {
    let all_near = displace_all(configuration, displacement);
    // If all individuals are within half a cell of the origin, the centroid is, too.
    if !all_near {
        configuration.re_centre();
    }
}

/// Applies n displacements; returns whether all are then within half a cell of the origin.
pub fn displace_all(configuration: &mut Configuration, displacement: &[[f64; 3]]) -> bool {
    let Configuration { x, y, alpha, .. } = configuration;
    let poses = x.iter_mut().zip(y.iter_mut()).zip(alpha);
    let mut all_near = true;
    for (((x, y), alpha), moved) in poses.zip(displacement) {
        *x += moved[0];
        *y += moved[1];
        *alpha += moved[2];
        all_near &= (x.abs() <= CELL / 2.0) & (y.abs() <= CELL / 2.0);
    }
    all_near
}

/// Returns the largest and the second largest value, or 0 for values that are missing.
pub fn two_largest(values: &[f64]) -> (f64, f64) {
    values.iter().fold((0.0, 0.0), |(first, second), &value| {
        if value > first {
            (value, first)
        } else {
            (first, f64::max(second, value))
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_displacement_beyond_half_a_cell_is_reported_whichever_individual_it_is() {
        for (far, axis) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let mut configuration = Configuration::default();
            configuration.push(1.0, 2.0, 3.0);
            configuration.push(4.0, 5.0, 6.0);
            let mut displacement = [[0.5, 0.25, 0.125]; 2];
            assert!(displace_all(&mut configuration, &displacement));
            assert_eq!(
                (&*configuration.x, &*configuration.y),
                (&[1.5, 4.5][..], &[2.25, 5.25][..])
            );
            assert_eq!(configuration.alpha, [3.125, 6.125]);
            displacement[far][axis] = -CELL;
            assert!(
                !displace_all(&mut configuration, &displacement),
                "{far} {axis}"
            );
        }
    }
}
