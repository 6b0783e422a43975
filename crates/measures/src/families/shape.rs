//! The extent of the group.

use crate::definition::Definition;
use crate::view::View;

pub(crate) const DEFINITIONS: [Definition; 2] = [
    Definition {
        name: "radius_of_gyration",
        unit: "body sizes",
        formula: "sqrt((1/n) Σ |x_i - c|²), c the centroid",
        source: "Rubinstein and Colby, Polymer Physics (2003), section 2.4",
        range: "at least 0",
        evaluate: |view, _| Some(radius_of_gyration(view)),
        ..Definition::PLAIN
    },
    Definition {
        name: "spread",
        unit: "body sizes²",
        formula: "area of the convex hull of the centres x_i; 0 if they are on a line",
        source: "de Berg et al., Computational Geometry (2008), section 1.1",
        range: "at least 0",
        cost: "n log n",
        evaluate: |view, _| Some(view.positions()?.hull_area()),
        ..Definition::PLAIN
    },
];

fn radius_of_gyration(view: &View<'_>) -> f64 {
    let squares = view.centred().iter().map(|[x, y]| x * x + y * y);
    (squares.sum::<f64>() / view.count()).sqrt()
}

#[cfg(test)]
mod tests {
    use crate::testing::{assert_near, discs, value};

    #[test]
    fn a_square_has_half_its_diagonal_and_its_area() {
        let square = [[7.0, 1.0], [9.0, 1.0], [9.0, 3.0], [7.0, 3.0]];
        assert_near(value("radius_of_gyration", &discs(&square)), 2.0f64.sqrt());
        assert_near(value("spread", &discs(&square)), 4.0);
        // Points within the hull or on its sides, and duplicates, do not change it.
        let more = [[8.0, 1.0], [8.5, 2.0], [9.0, 3.0], [9.0, 1.5]];
        assert_near(value("spread", &discs(&[square, more].concat())), 4.0);
    }

    #[test]
    fn a_hexagon_has_its_side_as_radius_of_gyration() {
        let corner = |k: u32| {
            let angle = f64::from(k) * std::f64::consts::FRAC_PI_3;
            [2.0 * angle.cos() - 400.0, 2.0 * angle.sin() + 90.0]
        };
        let corners: Vec<[f64; 2]> = (0..6).map(corner).collect();
        assert_near(value("radius_of_gyration", &discs(&corners)), 2.0);
        assert_near(value("spread", &discs(&corners)), 6.0 * 3.0f64.sqrt());
    }

    #[test]
    fn a_line_has_no_area() {
        let spread = |places: &[[f64; 2]]| value("spread", &discs(places));
        assert_eq!(spread(&[]), None);
        assert_eq!(spread(&[[1.0, 2.0]]), Some(0.0));
        assert_eq!(spread(&[[1.0, 2.0], [5.0, -3.0]]), Some(0.0));
        let line: Vec<[f64; 2]> = (0..200).map(f64::from).map(|k| [3.0 * k, -k]).collect();
        assert_eq!(spread(&line), Some(0.0));
        assert_eq!(spread(&[[0.3, 0.7]; 9]), Some(0.0));
        let rest = value("radius_of_gyration", &discs(&[[0.3, 0.7]; 9]));
        assert!(rest.is_some_and(|rest| rest < 1e-15), "{rest:?}");
    }

    #[test]
    fn the_centroid_is_exact_far_from_the_origin() {
        let places: Vec<[f64; 2]> = (0..1000)
            .map(|k| [500.0 + f64::from(k % 2) * 1e-9, 512.0])
            .collect();
        let radius = value("radius_of_gyration", &discs(&places));
        // The spacing of doubles at 500 is 1e-13.
        assert!(
            radius.is_some_and(|radius| (radius - 5e-10).abs() < 1e-13),
            "{radius:?}"
        );
        // Each of these sums has a rounding error.
        let radius = value("radius_of_gyration", &discs(&vec![[510.1, 0.3]; 100_000]));
        assert!(radius.is_some_and(|radius| radius < 1e-13), "{radius:?}");
    }
}
