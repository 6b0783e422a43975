//! Neighbours: how near the nearest individual is, by centres and by surfaces, as quantiles over
//! individuals.
//!
//! In a group of given density the cost is of order n log n. That of the Delaunay triangulation of the
//! centres is so for all positions but those exactly on one line, where it is of order n²: a second for
//! 20,000. The search for the smallest gap of an individual ends at the centres that are further away
//! than the smallest gap so far and a body's length, so its cost grows with the number of centres
//! within that distance.

use crate::definition::Definition;
use crate::view::View;

pub(crate) const DEFINITIONS: [Definition; 10] = [
    distance(
        "neighbour_distance.median",
        "median over i of min_j |x_j - x_i|",
        |view, _| quantile(view.nearest_distances()?, 0.5),
    ),
    distance(
        "neighbour_distance.q05",
        "5 % quantile over i of min_j |x_j - x_i|",
        |view, _| quantile(view.nearest_distances()?, 0.05),
    ),
    distance(
        "neighbour_distance.q25",
        "25 % quantile over i of min_j |x_j - x_i|",
        |view, _| quantile(view.nearest_distances()?, 0.25),
    ),
    distance(
        "neighbour_distance.q75",
        "75 % quantile over i of min_j |x_j - x_i|",
        |view, _| quantile(view.nearest_distances()?, 0.75),
    ),
    distance(
        "neighbour_distance.q95",
        "95 % quantile over i of min_j |x_j - x_i|",
        |view, _| quantile(view.nearest_distances()?, 0.95),
    ),
    gap(
        "neighbour_gap.median",
        "median over i of min_j gap(i, j)",
        |view, _| quantile(view.smallest_gaps()?, 0.5),
    ),
    gap(
        "neighbour_gap.q05",
        "5 % quantile over i of min_j gap(i, j)",
        |view, _| quantile(view.smallest_gaps()?, 0.05),
    ),
    gap(
        "neighbour_gap.q25",
        "25 % quantile over i of min_j gap(i, j)",
        |view, _| quantile(view.smallest_gaps()?, 0.25),
    ),
    gap(
        "neighbour_gap.q75",
        "75 % quantile over i of min_j gap(i, j)",
        |view, _| quantile(view.smallest_gaps()?, 0.75),
    ),
    gap(
        "neighbour_gap.q95",
        "95 % quantile over i of min_j gap(i, j)",
        |view, _| quantile(view.smallest_gaps()?, 0.95),
    ),
];

type Evaluate = fn(&View<'_>, f64) -> Option<f64>;

const fn distance(name: &'static str, formula: &'static str, evaluate: Evaluate) -> Definition {
    Definition {
        name,
        unit: "body sizes",
        formula,
        source: "Clark and Evans, Ecology 35, 445 (1954); quantiles of type 7 of Hyndman and Fan, Am. Stat. 50, 361 (1996)",
        range: "at least 0",
        cost: "n log n",
        evaluate,
        ..Definition::PLAIN
    }
}

const fn gap(name: &'static str, formula: &'static str, evaluate: Evaluate) -> Definition {
    Definition {
        name,
        unit: "body sizes",
        formula,
        source: "docs/model.md, Contacts, the gap; quantiles of type 7 of Hyndman and Fan, Am. Stat. 50, 361 (1996)",
        range: "at least minus the width of a body, which is the gap of crossed axes",
        cost: "n log n",
        evaluate,
        ..Definition::PLAIN
    }
}

/// Returns a quantile of ascending values by linear interpolation, the default of numpy; `None`
/// without values.
fn quantile(ascending: &[f64], share: f64) -> Option<f64> {
    let place = share * (ascending.len() as f64 - 1.0);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "below the number of values; a negative place becomes 0"
    )]
    let below = place as usize;
    let low = *ascending.get(below)?;
    let high = *ascending.get(below + 1).unwrap_or(&low);
    Some(low + (high - low) * (place - below as f64))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;
    use crate::testing::{assert_near, discs, state, value};

    #[test]
    fn quantiles_interpolate_linearly() {
        let row = discs(&[0.0, 1.0, 3.0, 7.0].map(|x| [x, 0.0]));
        // The distances are 1, 1, 2 and 4; discs of diameter 1 have gaps 1 smaller.
        for (name, expected) in [
            ("median", 1.5),
            ("q05", 1.0),
            ("q25", 1.0),
            ("q75", 2.5),
            ("q95", 2.0 + 0.85 * 2.0),
        ] {
            assert_near(value(&format!("neighbour_distance.{name}"), &row), expected);
            assert_near(
                value(&format!("neighbour_gap.{name}"), &row),
                expected - 1.0,
            );
        }
        assert_eq!(quantile(&[], 0.5), None);
        assert_eq!(quantile(&[3.0], 0.95), Some(3.0));
    }

    #[test]
    fn overlap_is_negative_and_crossed_axes_have_minus_the_width() {
        let beside = state(&[[0.0, 0.0, 0.0], [0.0, 0.3, 0.0]]);
        assert_near(value("neighbour_gap.median", &beside), -0.1);
        let crossed = state(&[[0.0, 0.0, 0.0], [0.1, 0.1, FRAC_PI_2]]);
        assert_near(value("neighbour_gap.median", &crossed), -0.4);
        let same = state(&[[0.3, 0.4, 0.0]; 5]);
        assert_near(value("neighbour_gap.q95", &same), -0.4);
        assert_near(value("neighbour_distance.q95", &same), 0.0);
    }

    #[test]
    fn a_single_individual_has_no_neighbour() {
        for name in ["neighbour_distance.median", "neighbour_gap.q95"] {
            assert_eq!(value(name, &state(&[[1.0; 3]])), None);
            assert_eq!(value(name, &state(&[])), None);
        }
    }

    #[test]
    fn two_duplicates_and_an_individual_far_away() {
        let places = [[0.0, 0.0], [1e6, 0.0], [0.0, 0.0]];
        assert_near(value("neighbour_distance.median", &discs(&places)), 0.0);
        let largest = value("neighbour_distance.q95", &discs(&places));
        assert!(largest.is_some_and(|it| (it - 0.9 * 1e6).abs() < 1e-6));
    }
}
