//! The shape of a body, and gaps between bodies measured independently of the stepper's contacts.
//!
//! A check computed from the stepper's list of contacts could not detect a contact that is
//! missing from it. So this module measures with parry and uses no code of the stepper.

use parry2d_f64::math::Vector;
use parry2d_f64::query::PointQuery;
use parry2d_f64::shape::Segment;
use parry2d_f64::utils::segments_intersection2d;

use super::heading::unit_vector;
use super::pairs::pairs_within;
use super::{Configuration, Parameters};

/// A position and a heading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Centre.
    pub x: f64,
    /// Centre.
    pub y: f64,
    /// Heading, counter-clockwise from +x.
    pub alpha: f64,
}

/// A capsule: a segment swept by a disc.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// Half the length of the segment.
    pub half_length: f64,
    /// The disc's radius.
    pub radius: f64,
}

/// The gap between two bodies, and whether their axes cross.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearness {
    /// Signed distance of the surfaces, in body sizes; if the axes cross, minus the width.
    pub gap: f64,
    /// Whether the axes cross.
    pub crossed: bool,
}

/// The smallest gap and the crossed pairs of a configuration, measured independently of the
/// stepper.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gaps {
    /// The smallest gap of all pairs, in body sizes; none if no gap is below [`HORIZON`].
    pub worst_gap: Option<f64>,
    /// Number of pairs with crossed axes.
    pub crossed: usize,
}

/// Larger gaps, in body sizes, are not measured: no rule depends on them.
pub const HORIZON: f64 = 1.0;

/// Square of the largest centre distance at which axes cross, in half-lengths, with a margin for
/// rounding.
const CROSSING: f64 = 4.0 * (1.0 + 1e-9);

/// [`gaps`] first measures the pairs with a gap below this, in body sizes. In a group such pairs
/// exist, and the smallest gap is among them.
const CLOSE: f64 = 0.01;

/// A bound of the rounding error of a distance between neighbouring bodies, relative to their size.
const ROUNDING: f64 = 1e-9;

impl Body {
    /// Returns the body that every individual has under `parameters`.
    #[must_use]
    pub fn new(parameters: &Parameters) -> Self {
        Self {
            half_length: parameters.half_length(),
            radius: parameters.radius(),
        }
    }

    /// Returns the distance of centres beyond which the gap exceeds `gap` for all headings.
    #[must_use]
    pub fn centre_distance(&self, gap: f64) -> f64 {
        2.0 * (self.half_length + self.radius) + gap
    }

    /// Measures the gap between the bodies at two poses, in body sizes.
    ///
    /// Two segments that do not cross are nearest at an end of one of them, so parry computes
    /// the intersection and the four distances of an end from the other segment. Its input is
    /// scaled to half-lengths, so that its tolerances are relative.
    #[must_use]
    pub fn nearness(&self, first: Pose, second: Pose) -> Nearness {
        let apart = [second.x - first.x, second.y - first.y];
        self.nearness_of(apart, [first.alpha, second.alpha].map(unit_vector))
    }

    /// Returns whether a strip along one of two bodies separates them by more than `gap`.
    ///
    /// That is so for most neighbours that do not touch, and the check costs less than a
    /// measurement of the gap.
    fn are_separated_by(&self, gap: f64, [dx, dy]: [f64; 2], units: [[f64; 2]; 2]) -> bool {
        let [one, two] = units;
        let across = (one[0] * two[1] - one[1] * two[0]).abs() * self.half_length;
        let beside = |unit: [f64; 2]| (unit[0] * dy - unit[1] * dx).abs();
        let between = beside(one).max(beside(two)) - across;
        between - 2.0 * self.radius > gap + ROUNDING * (self.half_length + self.radius)
    }

    /// Measures the gap between two bodies with the unit vectors `units`, the second of which is
    /// displaced from the first by `(dx, dy)`.
    fn nearness_of(&self, [dx, dy]: [f64; 2], units: [[f64; 2]; 2]) -> Nearness {
        let apart = |distance: f64| distance - 2.0 * self.radius;
        if self.half_length == 0.0 {
            let distance = (dx * dx + dy * dy).sqrt();
            return Nearness {
                gap: apart(distance),
                crossed: distance == 0.0,
            };
        }
        let one = axis(0.0, 0.0, units[0]);
        let two = axis(dx / self.half_length, dy / self.half_length, units[1]);
        let is_within_reach = dx * dx + dy * dy <= CROSSING * self.half_length * self.half_length;
        if is_within_reach && segments_intersection2d(one.a, one.b, two.a, two.b, 0.0).is_some() {
            return Nearness {
                gap: apart(0.0),
                crossed: true,
            };
        }
        let distance = one
            .distance_to_local_point(two.a, true)
            .min(one.distance_to_local_point(two.b, true))
            .min(two.distance_to_local_point(one.a, true))
            .min(two.distance_to_local_point(one.b, true));
        Nearness {
            gap: apart(distance * self.half_length),
            crossed: distance == 0.0,
        }
    }
}

fn axis(x: f64, y: f64, [cos, sin]: [f64; 2]) -> Segment {
    Segment::new(Vector::new(x - cos, y - sin), Vector::new(x + cos, y + sin))
}

/// Returns individual `index`'s pose, relative to the origin.
#[must_use]
pub fn pose(configuration: &Configuration, index: usize) -> Pose {
    let (x, y) = (configuration.x[index], configuration.y[index]);
    Pose {
        x,
        y,
        alpha: configuration.alpha[index],
    }
}

/// Measures all pairs with a gap below `gap`, in body sizes; returns them ordered by (i, j).
#[must_use]
pub fn near_pairs(
    body: Body,
    configuration: &Configuration,
    gap: f64,
) -> Vec<(u32, u32, Nearness)> {
    let Configuration { x, y, alpha, .. } = configuration;
    let units: Vec<[f64; 2]> = alpha.iter().map(|&alpha| unit_vector(alpha)).collect();
    pairs_within(x, y, body.centre_distance(gap))
        .into_iter()
        .filter_map(|(i, j)| {
            let [first, second] = [i as usize, j as usize];
            let apart = [x[second] - x[first], y[second] - y[first]];
            let units = [units[first], units[second]];
            if body.are_separated_by(gap, apart, units) {
                return None;
            }
            let nearness = body.nearness_of(apart, units);
            (nearness.gap < gap).then_some((i, j, nearness))
        })
        .collect()
}

/// Measures the worst gap and counts the crossed pairs.
#[must_use]
pub fn gaps(parameters: &Parameters, configuration: &Configuration) -> Gaps {
    let body = Body::new(parameters);
    let mut near = near_pairs(body, configuration, CLOSE);
    if near.is_empty() {
        near = near_pairs(body, configuration, HORIZON);
    }
    Gaps {
        worst_gap: near
            .iter()
            .map(|(_, _, nearness)| nearness.gap)
            .reduce(f64::min),
        crossed: near
            .iter()
            .filter(|(_, _, nearness)| nearness.crossed)
            .count(),
    }
}

/// Measures the smallest gap, in body sizes; none if no gap is below [`HORIZON`].
#[must_use]
pub fn worst_gap(parameters: &Parameters, configuration: &Configuration) -> Option<f64> {
    gaps(parameters, configuration).worst_gap
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use super::*;
    use crate::model::random::{Purpose, Stream};

    const BODY: Body = Body {
        half_length: 0.6,
        radius: 0.2,
    };

    fn between(dx: f64, dy: f64, alpha: f64) -> Nearness {
        BODY.nearness(
            Pose {
                x: 3.0,
                y: -2.0,
                alpha: 0.0,
            },
            Pose {
                x: 3.0 + dx,
                y: -2.0 + dy,
                alpha,
            },
        )
    }

    #[test]
    fn bodies_end_to_end_touch_at_their_caps() {
        assert!((between(1.6, 0.0, 0.0).gap).abs() < 1e-15);
        assert!((between(1.7, 0.0, 0.0).gap - 0.1).abs() < 1e-15);
        assert!(
            (between(0.3, 0.5, 0.0).gap - 0.1).abs() < 1e-15,
            "side by side"
        );
        assert!(
            (between(1.2 + 0.3, 0.4, 0.0).gap - 0.1).abs() < 1e-15,
            "cap to cap"
        );
    }

    #[test]
    fn an_end_above_a_side_is_measured_perpendicularly() {
        let nearness = between(0.2, 1.3, FRAC_PI_2);
        assert!((nearness.gap - (1.3 - 0.6 - 0.4)).abs() < 1e-15 && !nearness.crossed);
    }

    #[test]
    fn crossing_is_detected_at_any_angle_but_not_between_parallels() {
        assert_eq!(
            between(0.0, 0.0, FRAC_PI_2),
            Nearness {
                gap: -0.4,
                crossed: true
            }
        );
        assert!(between(0.0, 1e-13, 1e-12).crossed);
        assert!(
            between(1e-3, 0.0, 0.0).crossed,
            "axes along one line overlap"
        );
        assert!(!between(0.0, 1e-9, 0.0).crossed);
        assert!(!between(1.2 + 1e-9, 0.0, 0.0).crossed);
        let touching = between(0.0, 0.6, FRAC_PI_2);
        assert!(
            (touching.gap + 0.4).abs() < 1e-15,
            "an end on the other axis has distance 0"
        );
    }

    #[test]
    fn nearly_parallel_bodies_are_measured_at_the_nearer_end() {
        // The pair query of parry treats these as parallel and measures the wrong end.
        let alpha = -1.4e-8;
        assert!((between(0.0, 0.5, alpha).gap - (0.5 - 0.6 * 1.4e-8 - 0.4)).abs() < 1e-15);
    }

    #[test]
    fn discs_and_almost_discs_agree() {
        let disc = Body {
            half_length: 0.0,
            radius: 0.5,
        };
        let almost = Body {
            half_length: 1e-9,
            radius: 0.5,
        };
        let (first, second) = (
            Pose {
                x: 0.0,
                y: 0.0,
                alpha: 0.3,
            },
            Pose {
                x: 0.6,
                y: 0.9,
                alpha: 2.0,
            },
        );
        let (one, two) = (disc.nearness(first, second), almost.nearness(first, second));
        assert!((one.gap - two.gap).abs() < 3e-9);
        assert!((one.gap - (0.6f64.hypot(0.9) - 1.0)).abs() < 1e-15);
        assert!(disc.nearness(first, first).crossed);
    }

    #[test]
    fn separated_bodies_exceed_the_gap_and_most_distant_bodies_are_separated() {
        let mut stream = Stream::new(1, 0, 0, Purpose::Start);
        let (mut apart, mut separated) = (0, 0);
        for _ in 0..100_000 {
            let mut draw = |size: f64| size * (2.0 * stream.uniform() - 1.0);
            let (dx, dy, gap) = (draw(1.6), draw(1.6), draw(0.1));
            let (one, two) = (draw(PI), draw(PI));
            let first = Pose {
                x: 0.0,
                y: 0.0,
                alpha: one,
            };
            let second = Pose {
                x: dx,
                y: dy,
                alpha: two,
            };
            let is_apart = BODY.nearness(first, second).gap > gap;
            let units = [one, two].map(unit_vector);
            let is_separated = BODY.are_separated_by(gap, [dx, dy], units);
            assert!(is_apart || !is_separated, "{first:?} {second:?} {gap}");
            apart += u32::from(is_apart);
            separated += u32::from(is_separated);
        }
        assert!(
            f64::from(separated) > 0.5 * f64::from(apart),
            "{separated} of {apart}"
        );
    }

    #[test]
    fn pairs_are_near_at_gaps_below_the_limit_only() {
        // Discs of diameter 1 in a row, and bodies of width 1/2 abreast.
        for (pi1, places, gaps) in [
            (1.0, [[0.0, 0.0], [1.5, 0.0], [4.0, 0.0]], [0.5, 1.5]),
            (3.0, [[0.0, 0.0], [0.0, 1.0], [0.0, 3.0]], [0.5, 1.5]),
        ] {
            let parameters = Parameters {
                pi1,
                ..Parameters::default()
            };
            let mut configuration = Configuration::default();
            for [x, y] in places {
                configuration.push(x, y, 0.0);
            }
            let near = |gap| -> Vec<_> {
                let near = near_pairs(Body::new(&parameters), &configuration, gap);
                let gaps = near.into_iter();
                gaps.map(|(i, j, nearness)| (i, j, nearness.gap)).collect()
            };
            assert_eq!(near(gaps[0]), [], "{pi1}");
            assert_eq!(near(gaps[0] + 0.125), [(0, 1, gaps[0])]);
            assert_eq!(near(gaps[1]), [(0, 1, gaps[0])]);
            assert_eq!(near(gaps[1] + 0.125), [(0, 1, gaps[0]), (1, 2, gaps[1])]);
        }
    }

    #[test]
    fn the_worst_gap_and_the_crossings_are_those_of_all_pairs() {
        let parameters = Parameters::default();
        let mut configuration = Configuration::default();
        assert_eq!(gaps(&parameters, &configuration), Gaps::default());
        configuration.push(0.0, 0.0, 0.0);
        configuration.push(9.0, 0.0, 0.0);
        assert_eq!(worst_gap(&parameters, &configuration), None);
        configuration.push(0.0, 0.45, 0.0);
        assert!((worst_gap(&parameters, &configuration).unwrap() - 0.05).abs() < 1e-15);
        configuration.push(9.0, 0.0, 1.0);
        let gaps = gaps(&parameters, &configuration);
        assert_eq!((gaps.crossed, gaps.worst_gap), (1, Some(-0.4)));
    }
}
