//! Nematic order: whether bodies are parallel, irrespective of which end is ahead.

/// Computes the nematic order `|⟨exp(2 i α)⟩|`, in [0, 1]: 1 if all axes are parallel, 0 for an
/// empty group.
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

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

    use super::*;

    #[test]
    fn opposite_headings_are_parallel_and_crossed_ones_cancel() {
        assert!((nematic_order(&[0.3, 0.3 + PI, 0.3 - PI]) - 1.0).abs() < 1e-15);
        assert!(nematic_order(&[0.3, 0.3 + FRAC_PI_2]) < 1e-15);
        assert!((nematic_order(&[0.0, FRAC_PI_4]) - 0.5f64.sqrt()).abs() < 1e-15);
        assert_eq!(nematic_order(&[]), 0.0);
    }

    #[test]
    fn axes_spread_evenly_over_half_a_turn_have_no_order() {
        let angles: Vec<f64> = (0..7).map(|k| 0.1 + f64::from(k) * PI / 7.0).collect();
        assert!(nematic_order(&angles) < 1e-15);
        // Many axes spread evenly over an angle of w have the order |sin w| / w.
        let many: Vec<f64> = (0..10_000).map(|k| (f64::from(k) + 0.5) * 1e-4).collect();
        assert!((nematic_order(&many) - libm::sin(1.0)).abs() < 1e-8);
    }
}
