//! The order of disordered groups: the mean length of a sum of random unit vectors.

use std::f64::consts::PI;
use std::sync::LazyLock;

/// The positive nodes of the 12-point Gauss-Legendre rule, and their weights.
const NODES: [(f64, f64); 6] = [
    (0.981_560_634_246_719_2, 0.047_175_336_386_511_83),
    (0.904_117_256_370_474_8, 0.106_939_325_995_318_31),
    (0.769_902_674_194_304_7, 0.160_078_328_543_346_33),
    (0.587_317_954_286_617_5, 0.203_167_426_723_065_92),
    (0.367_831_498_998_180_2, 0.233_492_536_538_354_78),
    (0.125_233_408_511_468_94, 0.249_147_045_813_402_88),
];

/// `A(3) = (3 ∛2 Γ(1/3)⁶ / 16 + 27 ∛4 Γ(2/3)⁶ / 4) / π⁴`, after Borwein and Straub.
const MEAN_LENGTH_OF_3: f64 = 1.574_597_237_551_893_7;

/// Bound on the truncated tail of the integral, far below the nine digits that are compared.
const TAIL: f64 = 1e-11;

/// `v_ind(n)` for n from 0 (not a number) to 100, the usual sizes of groups in experiments.
static SMALL: LazyLock<Vec<f64>> = LazyLock::new(|| (0..=100).map(integrate).collect());

/// Computes the mean order of `n` individuals of independent headings.
///
/// - Accuracy: better than 1e-10.
/// - Source: paper, eq. (9), with `A(n)` by Kluyver's integral.
///
/// # Panics
///
/// If `n` is 0.
pub fn v_ind(n: u64) -> f64 {
    assert!(n > 0, "v_ind is defined for n of at least 1");
    let small = usize::try_from(n).ok().and_then(|n| SMALL.get(n));
    small.copied().unwrap_or_else(|| integrate(n))
}

/// Computes the effective cluster size, `n_eff`: the size of the independent clusters into which
/// `n` individuals of mean order `v` are divided. Solves `v_ind(n / n_eff) = v`, with `v_ind`
/// interpolated between whole numbers.
///
/// Returns `None` if `n` is 0, if `v` is below `v_ind(n)`, the order of independent headings, or if
/// `v` is not a number.
///
/// - Source: paper, 3.1 and Figure 5.
pub fn n_eff(n: u64, v: f64) -> Option<f64> {
    if n == 0 || v.is_nan() || v < v_ind(n) {
        return None;
    }
    // `v_ind` decreases with n: bisect for the whole numbers of clusters around the solution.
    let (mut fewer, mut more) = (1, n);
    while more - fewer > 1 {
        let middle = fewer + (more - fewer) / 2;
        if v_ind(middle) >= v {
            fewer = middle;
        } else {
            more = middle;
        }
    }
    let (high, low) = (v_ind(fewer), v_ind(more));
    let beyond = if v >= high || high <= low {
        0.0
    } else {
        (high - v) / (high - low)
    };
    Some(n as f64 / (fewer as f64 + beyond))
}

fn integrate(n: u64) -> f64 {
    let count = n as f64;
    match n {
        0 => f64::NAN,
        // These have closed forms, and their integrals have long tails.
        1 => 1.0,
        2 => 2.0 / PI,
        3 => MEAN_LENGTH_OF_3 / 3.0,
        _ => mean_length(count) / count,
    }
}

/// `A(n) = ∫ (1 - J₀(t)ⁿ) / t² dt` over t > 0.
fn mean_length(n: f64) -> f64 {
    // |J₀(t)| < √(2/πt), so the terms J₀(t)ⁿ/t² beyond `end` contribute less than TAIL, and the
    // terms 1/t² contribute 1/end.
    let order = 1.0 + n / 2.0;
    let end = libm::pow(2.0 / PI, n / (n + 2.0)) * libm::pow(order * TAIL, -1.0 / order);
    // The panels resolve the peak of width 2/√n at 0 and the oscillations of length π.
    let panels = (end / (2.0 / n.sqrt()).min(1.0)).ceil();
    let half = end / panels / 2.0;
    let mut sum = 0.0;
    let mut centre = half;
    while centre < end {
        for (node, weight) in NODES {
            let pair = integrand(n, centre - half * node) + integrand(n, centre + half * node);
            sum += half * weight * pair;
        }
        centre += 2.0 * half;
    }
    sum + 1.0 / end
}

fn integrand(n: f64, t: f64) -> f64 {
    let square = t * t;
    if t > 1.0 {
        return (1.0 - libm::pow(libm::j0(t), n)) / square;
    }
    // 1 - J₀(t) by its power series, since the subtraction would cancel all digits near 0.
    let quarter = square / 4.0;
    let (mut term, mut fallen) = (1.0, 0.0);
    for k in 1..12 {
        let k = f64::from(k);
        term *= -quarter / (k * k);
        fallen -= term;
    }
    -libm::expm1(n * libm::log1p(-fallen)) / square
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn v_ind_matches_reference_values() {
        let digits = [
            (1, 1.0),
            (2, 2.0 / PI),
            (3, 0.52487),
            (4, 0.44977),
            (5, 0.40163),
            (10, 0.28204),
            (20, 0.19879),
            (50, 0.12549),
            (74, 0.10311),
        ];
        for (n, expected) in digits {
            let found = v_ind(n);
            assert!((found - expected).abs() < 6e-6, "v_ind({n}) = {found}");
        }
        // The truncated integral agrees with the closed form.
        assert!((mean_length(3.0) - MEAN_LENGTH_OF_3).abs() < 1e-10);
    }

    #[test]
    fn large_groups_approach_a_random_walk() {
        // A(n) = √(πn)/2 · (1 + 1/16n + O(n⁻²)), here to 1e-9.
        for n in [10_000_u32, 1_000_000] {
            let count = f64::from(n);
            let walk = (PI / count).sqrt() / 2.0 * (1.0 + 1.0 / (16.0 * count));
            let found = v_ind(n.into());
            assert!((found / walk - 1.0).abs() < 1e-9, "{n}: {found} {walk}");
        }
    }

    #[test]
    fn n_eff_is_defined_between_chance_and_full_order() {
        for n in [1, 2, 3, 10, 50, 74] {
            assert_eq!(n_eff(n, 1.0), Some(n as f64));
            assert_eq!(n_eff(n, 1.000_001), Some(n as f64));
            assert_eq!(n_eff(n, v_ind(n)), Some(1.0));
            assert_eq!(n_eff(n, v_ind(n) - 1e-9), None);
        }
        assert_eq!(n_eff(10, v_ind(5)), Some(2.0));
        let between = n_eff(50, (v_ind(4) + v_ind(5)) / 2.0).unwrap();
        assert!((between - 50.0 / 4.5).abs() < 1e-9, "{between}");
        assert_eq!(n_eff(10, f64::NAN), None);
        assert_eq!(n_eff(0, 1.0), None);
    }
}
