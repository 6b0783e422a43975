//! Alignment: whether individuals head in one direction, are parallel, or circle the centroid.

use crate::definition::Definition;
use crate::view::View;

pub(crate) const DEFINITIONS: [Definition; 3] = [
    Definition {
        name: "order",
        unit: "1",
        formula: "|(1/n) Σ e_i|",
        source: "paper, the integrand of eq. (8)",
        range: "0 to 1",
        evaluate: |view, _| Some(view.order().order),
        ..Definition::PLAIN
    },
    Definition {
        name: "nematic",
        unit: "1",
        formula: "|(1/n) Σ exp(2 i α_i)|",
        source: "Chaté et al., Phys. Rev. Lett. 96, 180602 (2006); paper, section 3.1",
        range: "0 to 1",
        evaluate: |view, _| Some(nematic_order(&view.state().configuration.alpha)),
        ..Definition::PLAIN
    },
    Definition {
        name: "milling",
        unit: "1",
        formula: "|(1/n) Σ r_i × e_i|, r_i the unit vector from the centroid to i, 0 at the centroid",
        source: "Couzin et al., J. Theor. Biol. 218, 1 (2002), m_group; Tunstrøm et al., PLoS Comput. Biol. 9, e1002915 (2013), O_r",
        range: "0 to 1",
        evaluate: |view, _| Some(milling(view)),
        ..Definition::PLAIN
    },
];

/// Individuals nearer to the centroid than this count as at the centroid: their direction from it
/// would be a rounding error. In body sizes.
const AT_CENTROID: f64 = 1e-9;

/// Computes the nematic order `|⟨exp(2 i α)⟩|`, in [0, 1]: 1 if all axes are parallel, irrespective of
/// which end is ahead; 0 for an empty group.
///
/// - Shapes: n angles, in radians.
/// - Source: paper, section 3.1, in which individuals that turn back destabilise such groups.
#[must_use]
pub fn nematic_order(angles: &[f64]) -> f64 {
    let sum = angles.iter().fold([0.0, 0.0], |sum, &alpha| {
        let (sin, cos) = libm::sincos(2.0 * alpha);
        [sum[0] + cos, sum[1] + sin]
    });
    let length = (sum[0] * sum[0] + sum[1] * sum[1]).sqrt();
    // Rounding could make it larger than 1.
    (length / angles.len().max(1) as f64).min(1.0)
}

fn milling(view: &View<'_>) -> f64 {
    let mut sum = 0.0;
    for ([x, y], [cos, sin]) in view.centred().iter().zip(view.headings()) {
        let distance = (x * x + y * y).sqrt();
        if distance > AT_CENTROID {
            sum += (x * sin - y * cos) / distance;
        }
    }
    // Rounding could make it larger than 1.
    (sum.abs() / view.count()).min(1.0)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_3, FRAC_PI_4, PI};

    use super::*;
    use crate::testing::{assert_near, state, value};

    #[test]
    fn opposite_headings_are_parallel_and_crossed_ones_cancel() {
        assert!((nematic_order(&[0.3, 0.3 + PI, 0.3 - PI]) - 1.0).abs() < 1e-15);
        assert!(nematic_order(&[0.3, 0.3 + FRAC_PI_2]) < 1e-15);
        assert!((nematic_order(&[0.0, FRAC_PI_4]) - 0.5f64.sqrt()).abs() < 1e-15);
        assert_eq!(nematic_order(&[]), 0.0);
        let opposite = state(&[[0.0, 0.0, 0.3], [1.0, 0.0, 0.3 + PI]]);
        assert_near(value("nematic", &opposite), 1.0);
    }

    #[test]
    fn axes_spread_evenly_over_half_a_turn_have_no_order() {
        let angles: Vec<f64> = (0..7).map(|k| 0.1 + f64::from(k) * PI / 7.0).collect();
        assert!(nematic_order(&angles) < 1e-15);
        // Many axes spread evenly over an angle of w have the order |sin w| / w.
        let many: Vec<f64> = (0..10_000).map(|k| (f64::from(k) + 0.5) * 1e-4).collect();
        assert!((nematic_order(&many) - libm::sin(1.0)).abs() < 1e-8);
    }

    #[test]
    fn order_is_the_length_of_the_mean_heading() {
        let right_angle = state(&[[0.0, 0.0, 0.0], [0.0, 0.0, FRAC_PI_2]]);
        assert_near(value("order", &right_angle), 0.5f64.sqrt());
        assert_eq!(value("order", &state(&[])), None);
    }

    /// Individuals on a regular hexagon, turned by `turn` from the direction away from its centre,
    /// which is far from the origin.
    fn hexagon(turn: f64) -> Vec<[f64; 3]> {
        let place = |k: u32| {
            let angle = FRAC_PI_3 * f64::from(k);
            [
                300.0 + 2.0 * angle.cos(),
                5.0 + 2.0 * angle.sin(),
                angle + turn,
            ]
        };
        (0..6).map(place).collect()
    }

    #[test]
    fn a_ring_mills_if_its_headings_are_tangential() {
        let milling = |turn| value("milling", &state(&hexagon(turn)));
        assert_near(milling(FRAC_PI_2), 1.0);
        assert_near(milling(-FRAC_PI_2), 1.0);
        assert_near(milling(0.0), 0.0);
        assert_near(milling(0.4), libm::sin(0.4));
        // Three circle in each sense.
        let mut both = hexagon(FRAC_PI_2);
        both[3..].iter_mut().for_each(|pose| pose[2] += PI);
        assert_near(value("milling", &state(&both)), 0.0);
    }

    #[test]
    fn an_individual_at_the_centroid_contributes_nothing() {
        let mut poses = hexagon(FRAC_PI_2);
        poses.push([300.0, 5.0, 1.0]);
        assert_near(value("milling", &state(&poses)), 6.0 / 7.0);
        assert_eq!(value("milling", &state(&[[0.1, 0.2, 1.0]; 3])), Some(0.0));
        assert_eq!(value("milling", &state(&[[0.1, 0.2, 1.0]])), Some(0.0));
    }
}
