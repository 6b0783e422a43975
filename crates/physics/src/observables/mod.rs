//! What is read off configurations: order and drift, now and as running means, nematic order,
//! clusters, intervals of order.

pub mod clusters;
pub mod intervals;
pub mod nematic;

use crate::model::heading::unit_vectors;
use crate::model::{Configuration, simd};

/// The sum of the informed individuals' weighted unit vectors counts as cancelled below this
/// share of the weights: its direction would be rounding.
const CANCELLED: f64 = 1e-12;

/// Order and drift of a configuration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Order {
    /// The length of the mean heading, in [0, 1]: the paper's v(t).
    pub order: f64,
    /// The mean heading: contacts are internal, so it is the centroid's velocity too.
    pub velocity: [f64; 2],
    /// The informed individuals' common direction; none if nobody is informed, or if their
    /// directions cancel.
    pub direction: Option<f64>,
    /// The velocity along that direction.
    pub drift: Option<f64>,
}

/// Measures order and drift.
///
/// - Units: the free speed; angles counter-clockwise from +x.
/// - Source: paper, the integrand of eq. (8), and of the drift in section 3.2. The common
///   direction is that of the sum of unit vectors, each times its individual's weight.
#[must_use]
pub fn order(configuration: &Configuration) -> Order {
    let mut headings = Vec::new();
    unit_vectors(simd::level(), &configuration.alpha, &mut headings);
    order_of(headings.into_iter(), wish(configuration))
}

/// What the informed individuals want together: the sum of their unit vectors, each times its
/// individual's weight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommonDirection {
    sum: [f64; 2],
    strength: f64,
}

/// Sums what the informed individuals want; none if nobody is informed, or if it cancels.
#[must_use]
pub fn wish(configuration: &Configuration) -> Option<CommonDirection> {
    let (mut sum, mut weights) = ([0.0, 0.0], 0.0);
    for (&weight, &direction) in configuration.weight.iter().zip(&configuration.direction) {
        if weight > 0.0 {
            let (sin, cos) = libm::sincos(direction);
            sum = [sum[0] + weight * cos, sum[1] + weight * sin];
            weights += weight;
        }
    }
    let strength = length(sum);
    (strength > CANCELLED * weights).then_some(CommonDirection { sum, strength })
}

/// Measures order and drift of those whose headings are known as unit vectors.
#[must_use]
pub fn order_of(
    headings: impl ExactSizeIterator<Item = [f64; 2]>,
    wish: Option<CommonDirection>,
) -> Order {
    let share = 1.0 / headings.len().max(1) as f64;
    let sum = headings.fold([0.0, 0.0], |sum, [cos, sin]| [sum[0] + cos, sum[1] + sin]);
    let velocity = sum.map(|sum| sum * share);
    Order {
        // Rounding must not lift it over what it can be.
        order: length(velocity).min(1.0),
        velocity,
        direction: wish.map(|CommonDirection { sum, .. }| libm::atan2(sum[1], sum[0])),
        drift: wish.map(|CommonDirection { sum, strength }| {
            (velocity[0] * sum[0] + velocity[1] * sum[1]) / strength
        }),
    }
}

fn length(vector: [f64; 2]) -> f64 {
    (vector[0] * vector[0] + vector[1] * vector[1]).sqrt()
}

/// Means over steps, of what held at the beginning of each.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RunningMeans {
    /// How many steps were counted.
    pub count: u64,
    /// The sum of their orders.
    pub order: f64,
    /// The sum of their velocities.
    pub velocity: [f64; 2],
    /// How many of them had a common direction.
    pub directed: u64,
    /// The sum of their drifts.
    pub drift: f64,
}

impl RunningMeans {
    /// Counts one step by the order at its beginning.
    pub fn add(&mut self, order: &Order) {
        self.count += 1;
        self.order += order.order;
        self.velocity = [
            self.velocity[0] + order.velocity[0],
            self.velocity[1] + order.velocity[1],
        ];
        if let Some(drift) = order.drift {
            self.directed += 1;
            self.drift += drift;
        }
    }

    /// The mean order, the paper's v, eq. (8).
    #[must_use]
    pub fn mean_order(&self) -> Option<f64> {
        mean(self.order, self.count)
    }

    /// The mean velocity.
    #[must_use]
    pub fn mean_velocity(&self) -> Option<[f64; 2]> {
        Some([
            mean(self.velocity[0], self.count)?,
            mean(self.velocity[1], self.count)?,
        ])
    }

    /// The mean drift over the steps that had a common direction, the paper's `v_pd`.
    #[must_use]
    pub fn mean_drift(&self) -> Option<f64> {
        mean(self.drift, self.directed)
    }
}

fn mean(sum: f64, count: u64) -> Option<f64> {
    (count > 0).then(|| sum / count as f64)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

    use super::*;

    fn heading(angles: &[f64]) -> Configuration {
        let mut configuration = Configuration::default();
        angles.iter().for_each(|&alpha| {
            configuration.push(0.0, 0.0, alpha);
        });
        configuration
    }

    #[test]
    fn order_is_one_when_all_agree_and_zero_when_they_cancel() {
        let all = order(&heading(&[0.3; 7]));
        assert!((all.order - 1.0).abs() < 1e-15 && all.order <= 1.0);
        assert!((all.velocity[0] - 0.3f64.cos()).abs() < 1e-15);
        assert_eq!((all.direction, all.drift), (None, None));
        assert!(order(&heading(&[0.0, PI])).order < 1e-15);
        let half = order(&heading(&[0.0, FRAC_PI_2]));
        assert!((half.order - 0.5f64.sqrt()).abs() < 1e-15);
    }

    #[test]
    fn the_common_direction_is_that_of_the_weighted_sum() {
        let mut configuration = heading(&[0.0, 0.0, FRAC_PI_2]);
        configuration.inform(0, 0.5, 0.0, None);
        configuration.inform(1, 0.5, FRAC_PI_2, None);
        let now = order(&configuration);
        assert!((now.direction.unwrap() - FRAC_PI_4).abs() < 1e-15);
        // The velocity is (2/3, 1/3).
        assert!((now.drift.unwrap() - 0.5f64.sqrt()).abs() < 1e-15);
        configuration.inform(0, 1.5, 0.0, None);
        assert!((order(&configuration).direction.unwrap() - libm::atan2(0.5, 1.5)).abs() < 1e-15);
    }

    #[test]
    fn opposite_wishes_of_one_weight_have_no_direction() {
        let mut configuration = heading(&[0.0, 0.0]);
        configuration.inform(0, 0.5, 0.7, None);
        configuration.inform(1, 0.5, 0.7 + PI, None);
        let now = order(&configuration);
        assert_eq!((now.direction, now.drift), (None, None));
    }

    #[test]
    fn means_count_drift_only_where_there_is_a_direction() {
        let mut means = RunningMeans::default();
        assert_eq!(
            (
                means.mean_order(),
                means.mean_velocity(),
                means.mean_drift()
            ),
            (None, None, None)
        );
        let mut configuration = heading(&[0.0]);
        means.add(&order(&configuration));
        configuration.inform(0, 0.5, PI, None);
        means.add(&order(&configuration));
        assert_eq!(means.mean_order(), Some(1.0));
        assert_eq!(means.mean_velocity(), Some([1.0, 0.0]));
        assert_eq!(means.mean_drift(), Some(-1.0));
        assert_eq!((means.count, means.directed), (2, 1));
    }
}
