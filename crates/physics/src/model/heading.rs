//! Unit vectors of many angles at once, bit for bit those of `libm::sincos`.
//!
//! The formulas and constants are those of FreeBSD's `s_sin.c`, `k_sin.c`, `k_cos.c` and
//! `e_rem_pio2.c`, which `libm` uses as well:
//!
//! Copyright (C) 1993 by Sun Microsystems, Inc. All rights reserved.
//! Developed at SunPro, a Sun Microsystems, Inc. business.
//! Permission to use, copy, modify, and distribute this software is freely granted, provided
//! that this notice is preserved.
//!
//! Those sources choose a branch by the range of the angle. Here all angles take the same branch,
//! so that the compiler can use vector registers. The few angles for which this branch could give
//! another result are computed by `libm` itself.

use std::f64::consts::FRAC_PI_4;

use crate::model::simd::{Level, multiversion};

/// Angles per block. The angles that are left to `libm` are computed after each block, while the
/// block is still in the cache.
const BLOCK: usize = 64;

const INVERSE_PIO2: f64 = f64::from_bits(0x3FE4_5F30_6DC9_C883);
/// The first 33 bits of π/2, so that its multiples are exact. [`PIO2_LOW`] is the rest.
const PIO2_HIGH: f64 = f64::from_bits(0x3FF9_21FB_5440_0000);
const PIO2_LOW: f64 = f64::from_bits(0x3DD0_B461_1A62_6331);

/// Added to a number, it leaves the nearest integer in the last bits of the sum.
const TO_INTEGER: f64 = 6_755_399_441_055_744.0;

const SINE: [f64; 6] = [
    f64::from_bits(0xBFC5_5555_5555_5549),
    f64::from_bits(0x3F81_1111_1110_F8A6),
    f64::from_bits(0xBF2A_01A0_19C1_61D5),
    f64::from_bits(0x3EC7_1DE3_57B1_FE7D),
    f64::from_bits(0xBE5A_E5E6_8A2B_9CEB),
    f64::from_bits(0x3DE5_D93A_5ACF_D57C),
];

const COSINE: [f64; 6] = [
    f64::from_bits(0x3FA5_5555_5555_554C),
    f64::from_bits(0xBF56_C16C_16C1_5177),
    f64::from_bits(0x3EFA_01A0_19CB_1590),
    f64::from_bits(0xBE92_7E4F_809C_52AD),
    f64::from_bits(0x3E21_EE9E_BDB4_B1C4),
    f64::from_bits(0xBDA8_FAE9_BE88_38D4),
];

/// Angles nearer than this to the border between two quadrants are left to `libm`. Where `libm`
/// reads the quadrant from the upper half of an angle's bits, it may choose the other quadrant.
/// The value is four times the resolution of that half at 2π.
const BORDER: f64 = 1.6e-5;

/// If the remainder is at most this share of the angle, the reduction needs more digits of π.
/// `libm` draws the limit at 2⁻¹⁶, by the exponents; this is twice that.
const CANCELLATION: f64 = 1.0 / 32_768.0;

/// Angles of this size or more are left to `libm`. `libm` reduces in doubles up to 2²⁰ π/2, about
/// 1.65e6.
const LARGEST: f64 = 1.6e6;

/// Angles of at most this size are left to `libm`, where zero keeps its sign. Above it the
/// formulas give the results of `libm` without its branch for small angles.
const SMALLEST: f64 = 1e-9;

/// Computes `(cos, sin)` of every angle into `units`.
///
/// - Shapes: n angles in, n unit vectors out.
/// - Units: radians in. An angle that is not finite gives NaN for both components.
pub fn unit_vectors(level: Level, angles: &[f64], units: &mut Vec<[f64; 2]>) {
    units.resize(angles.len(), [0.0; 2]);
    for (angles, units) in angles.chunks(BLOCK).zip(units.chunks_mut(BLOCK)) {
        if ordinary_unit_vectors(level, angles, units) {
            let unset = angles
                .iter()
                .zip(units)
                .filter(|(_, unit)| unit[0].is_nan());
            unset.for_each(|(&angle, unit)| *unit = unit_vector(angle));
        }
    }
}

/// Computes `(cos, sin)` of one angle.
#[must_use]
pub fn unit_vector(angle: f64) -> [f64; 2] {
    let (sin, cos) = libm::sincos(angle);
    [cos, sin]
}

multiversion! {
    /// Computes the unit vectors of the ordinary angles. Every other angle gets NaN as its
    /// cosine. Returns whether any angle is not ordinary.
    fn ordinary_unit_vectors(level, angles: &[f64], units: &mut [[f64; 2]]) -> bool {
        let mut left = false;
        for (&angle, unit) in angles.iter().zip(units) {
            let (ordinary, cos, sin) = ordinary_unit_vector(angle);
            *unit = [if ordinary { cos } else { f64::NAN }, sin];
            left |= !ordinary;
        }
        left
    }
}

/// Returns whether the angle is ordinary, that is, whether this is the result of `libm`; and the
/// cosine and sine.
#[inline(always)]
fn ordinary_unit_vector(angle: f64) -> (bool, f64, f64) {
    // The nearest multiple of π/2, and the remainder of the angle as a sum of two doubles.
    let shifted = angle * INVERSE_PIO2 + TO_INTEGER;
    let (quadrant, multiple) = (shifted.to_bits(), shifted - TO_INTEGER);
    let high = angle - multiple * PIO2_HIGH;
    let low = multiple * PIO2_LOW;
    let x = high - low;
    let y = (high - x) - low;
    let (size, left) = (angle.abs(), x.abs());
    let ordinary = (left < FRAC_PI_4 - BORDER)
        & (left > CANCELLATION * size)
        & (size < LARGEST)
        & (size > SMALLEST);
    let z = x * x;
    let w = z * z;
    // Sine, with a separate formula if the multiple is 0 and nothing was subtracted.
    let [s1, s2, s3, s4, s5, s6] = SINE;
    let r = s2 + z * (s3 + z * s4) + z * w * (s5 + z * s6);
    let v = z * x;
    let whole = x + v * (s1 + z * r);
    let reduced = x - ((z * (0.5 * y - v * r) - y) - v * s1);
    let sine = if multiple == 0.0 { whole } else { reduced };
    // Cosine.
    let [c1, c2, c3, c4, c5, c6] = COSINE;
    let r = z * (c1 + z * (c2 + z * c3)) + w * w * (c4 + z * (c5 + z * c6));
    let half = 0.5 * z;
    let rest = 1.0 - half;
    let cosine = rest + (((1.0 - rest) - half) + (z * r - x * y));
    // In odd quadrants sine and cosine are exchanged; the signs depend on the quadrant too.
    let odd = quadrant & 1 != 0;
    let (along, across) = if odd { (sine, cosine) } else { (cosine, sine) };
    let signed = |value: f64, turn: u64| f64::from_bits(value.to_bits() ^ ((turn & 2) << 62));
    (
        ordinary,
        signed(along, quadrant.wrapping_add(1)),
        signed(across, quadrant),
    )
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, TAU};

    use super::*;
    use crate::model::random::{Purpose, Stream};

    fn assert_same(angles: &[f64]) {
        // The angles that are left to `libm` may hold any NaN.
        let at = |level| {
            let mut units = vec![[0.0; 2]; angles.len()];
            ordinary_unit_vectors(level, angles, &mut units);
            let bits = |unit: [f64; 2]| (!unit[0].is_nan()).then(|| unit.map(f64::to_bits));
            units.into_iter().map(bits).collect::<Vec<_>>()
        };
        for level in Level::available() {
            assert_eq!(at(level), at(Level::BASELINE), "{level:?}");
        }
        let mut units = vec![[7.0; 2]; 3];
        unit_vectors(Level::default(), angles, &mut units);
        assert_eq!(units.len(), angles.len());
        for (&angle, unit) in angles.iter().zip(&units) {
            let (sin, cos) = libm::sincos(angle);
            assert_eq!(
                unit.map(f64::to_bits),
                [cos, sin].map(f64::to_bits),
                "{angle:e}: {unit:?}, not {:?}",
                [cos, sin]
            );
        }
    }

    #[test]
    fn unit_vectors_equal_libm_bit_for_bit() {
        let mut stream = Stream::new(1, 0, 0, Purpose::Start);
        for width in [1e-12, 1e-8, 1e-3, 1.0, 3.0, TAU, 20.0, 1e3, 1e6, 4e6, 1e12] {
            let angles: Vec<f64> = (0..200_000)
                .map(|_| width * (2.0 * stream.uniform() - 1.0))
                .collect();
            assert_same(&angles);
        }
    }

    #[test]
    fn unit_vectors_equal_libm_next_to_every_border() {
        let mut angles = Vec::new();
        for eighth in (-400..=400).chain([100_003, 1_000_002, 1_018_589]) {
            let border = f64::from(eighth) * FRAC_PI_4;
            for exponent in 0..53 {
                let nudge = f64::powi(2.0, -exponent);
                angles.extend([border * (1.0 - nudge), border + nudge, border - nudge]);
            }
            angles.extend([border, border.next_up(), border.next_down()]);
        }
        assert_same(&angles);
    }

    #[test]
    fn few_angles_are_left_to_libm() {
        let mut stream = Stream::new(2, 0, 0, Purpose::Start);
        let left = (0..100_000).filter(|_| !ordinary_unit_vector(100.0 * stream.uniform()).0);
        assert!(left.count() < 1000);
    }

    #[test]
    fn zero_keeps_its_sign_and_non_finite_angles_give_nan() {
        assert_same(&[0.0, -0.0, f64::MIN_POSITIVE, -1e-300, FRAC_PI_2, f64::MAX]);
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut units = Vec::new();
            unit_vectors(Level::default(), &[bad, 0.5], &mut units);
            assert!(units[0].iter().all(|value| value.is_nan()));
            assert_eq!(units[1], unit_vector(0.5));
        }
    }
}
