//! Distributions of neighbours, computed on request: they are no measures, since they are no numbers.
//!
//! The cost grows with the number of pairs within the distance, at most n²/2; groups of more than
//! [`MAX_INDIVIDUALS`] are rejected.

use std::f64::consts::{PI, SQRT_2};

use jostle_physics::model::heading::unit_vector;
use jostle_physics::model::pairs::PairSearch;
use jostle_physics::model::{Configuration, State};
use thiserror::Error;

use crate::measure::Measure;
use crate::past::Past;
use crate::view::View;

/// The largest group: it has 2·10⁸ pairs, about a second.
pub const MAX_INDIVIDUALS: usize = 20_000;

/// The most bins of a histogram.
pub const MAX_BINS: usize = 1_000_000;

/// Margin of a search distance, so that rounding omits no pair.
const MARGIN: f64 = 1.0 + 1e-9;

/// Counts and values by distance or by place.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    /// The edges of the bins of one axis, in body sizes: one more than the axis has bins. A bin
    /// contains its lower edge.
    pub edges: Vec<f64>,
    /// The number of ordered pairs of individuals in each bin.
    pub counts: Vec<u64>,
    /// The value of each bin; the function that returns it has the unit.
    pub values: Vec<f64>,
}

/// Why a histogram is not computed.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum HistogramError {
    /// There are no bins or more than [`MAX_BINS`].
    #[error("{0} bins, it must be 1 to {MAX_BINS}")]
    Bins(usize),
    /// A length or an area is not finite or not above 0.
    #[error("a length or an area of {0}, it must be above 0")]
    Size(f64),
    /// The group is larger than [`MAX_INDIVIDUALS`].
    #[error("{0} individuals, the limit is {MAX_INDIVIDUALS}")]
    Individuals(usize),
}

/// Computes the pair correlation g(r) of the centres, also called radial distribution function.
///
/// - `bins` annuli of equal width from 0 to below `r_max`, in body sizes; `area`, in squared body
///   sizes, is that over which the n individuals are spread, such as the measure `spread`.
/// - Value: `c_k area / (n² a_k)` for the number `c_k` of ordered pairs in annulus k of area `a_k`, without
///   unit: 1 - 1/n if positions are random and the area has no border. All 0 for an empty group.
/// - Source: freud, `freud.density.RDF` with the normalisation `exact` (Ramasubramani et al., Comput.
///   Phys. Commun. 254, 107275 (2020)). There is no correction for the border of the group.
///
/// # Errors
///
/// [`HistogramError`].
pub fn pair_correlation(
    configuration: &Configuration,
    bins: usize,
    r_max: f64,
    area: f64,
) -> Result<Histogram, HistogramError> {
    check(configuration, bins, &[r_max, area])?;
    let Configuration { x, y, .. } = configuration;
    let mut counts = vec![0; bins];
    PairSearch::default().visit(x, y, r_max, |one, other| {
        let [dx, dy] = between(configuration, [one, other].map(|it| it as usize));
        if let Some(bin) = bin((dx * dx + dy * dy).sqrt() / r_max, bins) {
            counts[bin] += 2;
        }
    });
    let edges = edges(bins, 0.0, r_max);
    let n = configuration.n().max(1) as f64;
    let annuli = edges
        .windows(2)
        .map(|edges| PI * (edges[1] * edges[1] - edges[0] * edges[0]));
    let values = counts
        .iter()
        .zip(annuli)
        .map(|(&count, annulus)| count as f64 * area / (n * n * annulus))
        .collect();
    Ok(Histogram {
        edges,
        counts,
        values,
    })
}

/// Returns the area of the convex hull of the centres, in squared body sizes: that of
/// [`pair_correlation`] in a plane without border. `None` if it is 0, for centres on one line.
pub fn hull_area(configuration: &Configuration) -> Option<f64> {
    let state = State {
        configuration: configuration.clone(),
        ..State::default()
    };
    let past = Past::new(0);
    let spread: Measure = "spread".parse().ok()?;
    spread
        .evaluate(&View::new(&state, &past))
        .filter(|area| *area > 0.0)
}

/// Computes the mean density of neighbours around a body, in the frame of its heading.
///
/// - Shapes: `bins` times `bins` squares over [-reach, reach)², in body sizes. Bin `a * bins + l` has
///   the neighbours whose place ahead of the body is between edges a and a + 1, and whose place to the
///   left of it is between edges l and l + 1; both axes have the same edges.
/// - Value: `c / (n b)` for the number `c` of ordered pairs in a bin of area `b`: neighbours per body and
///   squared body size. All 0 for an empty group.
/// - Source: Katz et al., Proc. Natl. Acad. Sci. 108, 18720 (2011).
///
/// # Errors
///
/// [`HistogramError`]; the limit of bins is that of all squares.
pub fn neighbour_density(
    configuration: &Configuration,
    bins: usize,
    reach: f64,
) -> Result<Histogram, HistogramError> {
    let squares = bins.saturating_mul(bins);
    check(configuration, squares, &[reach])?;
    let Configuration { x, y, alpha, .. } = configuration;
    let headings: Vec<[f64; 2]> = alpha.iter().map(|&alpha| unit_vector(alpha)).collect();
    let mut counts = vec![0; squares];
    // A corner is furthest from the centre.
    PairSearch::default().visit(x, y, reach * SQRT_2 * MARGIN, |one, other| {
        let [one, other] = [one, other].map(|it| it as usize);
        for pair in [[one, other], [other, one]] {
            let ([dx, dy], [cos, sin]) = (between(configuration, pair), headings[pair[0]]);
            let along = [dx * cos + dy * sin, dy * cos - dx * sin];
            let places = along.map(|place| bin((place + reach) / (2.0 * reach), bins));
            if let [Some(ahead), Some(left)] = places {
                counts[ahead * bins + left] += 1;
            }
        }
    });
    let side = 2.0 * reach / bins as f64;
    let scale = 1.0 / (configuration.n().max(1) as f64 * side * side);
    let values = counts.iter().map(|&count: &u64| count as f64 * scale);
    Ok(Histogram {
        edges: edges(bins, -reach, reach),
        values: values.collect(),
        counts,
    })
}

fn check(configuration: &Configuration, bins: usize, sizes: &[f64]) -> Result<(), HistogramError> {
    if !(1..=MAX_BINS).contains(&bins) {
        return Err(HistogramError::Bins(bins));
    }
    let is_bad = |size: &&f64| !(size.is_finite() && **size > 0.0);
    if let Some(&size) = sizes.iter().find(is_bad) {
        return Err(HistogramError::Size(size));
    }
    match configuration.n() {
        n if n > MAX_INDIVIDUALS => Err(HistogramError::Individuals(n)),
        _ => Ok(()),
    }
}

/// Returns the vector from the first individual to the second.
fn between(configuration: &Configuration, [from, to]: [usize; 2]) -> [f64; 2] {
    let Configuration { x, y, .. } = configuration;
    [x[to] - x[from], y[to] - y[from]]
}

/// Returns the bin at `share` of an axis; `None` outside of it.
fn bin(share: f64, bins: usize) -> Option<usize> {
    if !(0.0..1.0).contains(&share) {
        return None;
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "from 0 to the number of bins"
    )]
    let bin = (share * bins as f64) as usize;
    // The product may be rounded up.
    Some(bin.min(bins - 1))
}

fn edges(bins: usize, from: f64, to: f64) -> Vec<f64> {
    let edge = |k: usize| from + (to - from) * (k as f64 / bins as f64);
    (0..=bins).map(edge).collect()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;
    use crate::testing::{discs, state};

    #[test]
    fn the_pair_correlation_of_a_square_lattice_counts_its_shells() {
        let place = |k: u32| [f64::from(k % 20), f64::from(k / 20)];
        let lattice: Vec<[f64; 2]> = (0..400).map(place).collect();
        let g = pair_correlation(&discs(&lattice).configuration, 8, 2.0, 400.0).unwrap();
        assert_eq!(g.edges, [0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0]);
        // Four neighbours at 1 and four at √2, fewer at the border; those at 2 are outside.
        assert_eq!(g.counts, [0, 0, 0, 0, 4 * 20 * 19, 4 * 19 * 19, 0, 0]);
        let annulus = PI * (1.25 * 1.25 - 1.0);
        assert!((g.values[4] - 1520.0 / (400.0 * annulus)).abs() < 1e-12);
    }

    #[test]
    fn the_pair_correlation_of_few_individuals() {
        let count = |places: &[[f64; 2]]| {
            let g = pair_correlation(&discs(places).configuration, 2, 1.0, 3.0).unwrap();
            (g.counts, g.values)
        };
        assert_eq!(count(&[]), (vec![0, 0], vec![0.0, 0.0]));
        assert_eq!(count(&[[1.0, 2.0]]), (vec![0, 0], vec![0.0, 0.0]));
        let (counts, values) = count(&[[1.0, 2.0]; 2]);
        assert_eq!(counts, [2, 0]);
        assert!((values[0] - 2.0 * 3.0 / (4.0 * PI * 0.25)).abs() < 1e-12);
    }

    #[test]
    fn neighbours_are_in_the_frame_of_the_heading() {
        // The second is ahead of the first and to its left; the first is behind the second, which
        // heads along +y, and to its left.
        let pair = state(&[[5.0, 5.0, 0.0], [6.5, 5.5, FRAC_PI_2]]);
        let density = neighbour_density(&pair.configuration, 4, 2.0).unwrap();
        assert_eq!(density.edges, [-2.0, -1.0, 0.0, 1.0, 2.0]);
        let mut counts = [0; 16];
        counts[3 * 4 + 2] = 1;
        counts[4 + 3] = 1;
        assert_eq!(density.counts, counts);
        // One of two bodies, in a bin of area 1.
        assert!((density.values[14] - 0.5).abs() < 1e-12);
        // Turned as a whole, the group has the same density.
        let turned = state(&[[0.0, 0.0, 1.0], {
            let (sin, cos) = 1.0f64.sin_cos();
            [
                1.5 * cos - 0.5 * sin,
                1.5 * sin + 0.5 * cos,
                FRAC_PI_2 + 1.0,
            ]
        }]);
        assert_eq!(
            neighbour_density(&turned.configuration, 4, 2.0).unwrap(),
            density
        );
    }

    #[test]
    fn the_lower_edges_belong_to_the_square_and_the_upper_ones_do_not() {
        let corner = state(&[[0.0, 0.0, 0.0], [2.0, 2.0, 0.0]]);
        let density = neighbour_density(&corner.configuration, 2, 2.0).unwrap();
        assert_eq!(density.counts, [1, 0, 0, 0]);
    }

    #[test]
    fn arguments_have_limits() {
        let one = state(&[[0.0; 3]]).configuration;
        let bins = |bins| neighbour_density(&one, bins, 1.0);
        assert_eq!(bins(0), Err(HistogramError::Bins(0)));
        assert_eq!(bins(1001), Err(HistogramError::Bins(1_002_001)));
        assert!(bins(usize::MAX).is_err());
        for size in [0.0, -1.0, f64::INFINITY, f64::NAN] {
            assert!(pair_correlation(&one, 1, size, 1.0).is_err());
            assert!(pair_correlation(&one, 1, 1.0, size).is_err());
            assert!(neighbour_density(&one, 1, size).is_err());
        }
        let many = state(&vec![[0.0; 3]; MAX_INDIVIDUALS + 1]).configuration;
        let error = HistogramError::Individuals(MAX_INDIVIDUALS + 1);
        assert_eq!(pair_correlation(&many, 1, 1.0, 1.0), Err(error));
    }
}
