//! Observables of configurations: order and drift of one configuration and as running means, and
//! intervals of order. The crate `jostle-measures` has many more, for one state at a time.

pub mod intervals;

use crate::model::heading::unit_vectors;
use crate::model::{Configuration, simd};

/// The informed individuals have a common direction from this strength on: below it, their number and
/// the noise of their weights decide where the sum of their directions points.
pub const MIN_STRENGTH: f64 = 0.1;

/// The strength up to which the sum of directions is a rounding error, and so was the only one without
/// a common direction in [`Definitions::First`].
const CANCELLED: f64 = 1e-12;

/// The definitions of measures. An experiment goes on under those with which it began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Definitions {
    /// The informed have a common direction unless theirs cancel to rounding.
    First,
    /// They have one from [`MIN_STRENGTH`] on.
    #[default]
    Second,
}

impl Definitions {
    /// Returns the definitions with this number; `None` if there are none, or only in a later version.
    #[must_use]
    pub fn of(number: u32) -> Option<Self> {
        [Self::First, Self::Second]
            .into_iter()
            .find(|it| it.number() == number)
    }

    /// Returns their number.
    #[must_use]
    pub fn number(self) -> u32 {
        match self {
            Self::First => 1,
            Self::Second => 2,
        }
    }
}

/// Order and drift of a configuration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Order {
    /// The length of the mean heading, in [0, 1]: the paper's v(t).
    pub order: f64,
    /// The mean heading. It is also the centroid's velocity in free speeds, since contact forces
    /// cancel, unless a controller scales speeds.
    pub velocity: [f64; 2],
    /// How far the informed individuals agree, `|Σ w e| / Σ w`, in [0, 1]; `None` if none is informed.
    pub strength: Option<f64>,
    /// Their common direction, in radians; `None` if none is informed or they agree too little.
    pub direction: Option<f64>,
    /// The component of `velocity` along that direction, in free speeds.
    pub drift: Option<f64>,
}

/// Measures order and drift.
///
/// - Units: free speeds; angles in radians, counter-clockwise from +x.
/// - Source: paper, the integrands of eq. (8) and of the drift in section 3.2. The common direction
///   is that of the sum of the preferred directions' unit vectors, each times its individual's
///   weight; [`Definitions`] say from which strength on.
#[must_use]
pub fn order(configuration: &Configuration, definitions: Definitions) -> Order {
    let mut headings = Vec::new();
    unit_vectors(simd::level(), &configuration.alpha, &mut headings);
    let common = common_direction(configuration, definitions);
    order_of(headings.into_iter(), common)
}

/// The common direction of the informed individuals: the sum of the unit vectors of their preferred
/// directions, each times its individual's weight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommonDirection {
    sum: [f64; 2],
    /// The length of the sum.
    length: f64,
    /// Its share of the sum of the weights.
    strength: f64,
    /// Whether they agree enough to have one.
    is_defined: bool,
}

/// If all weights are smaller, they are divided by the largest one before they are added up.
const MIN_WEIGHT: f64 = 1e-100;

/// Computes the common direction; `None` if no individual is informed.
#[must_use]
pub fn common_direction(
    configuration: &Configuration,
    definitions: Definitions,
) -> Option<CommonDirection> {
    let (mut sum, mut weights) = ([0.0, 0.0], 0.0);
    let largest = configuration.largest_weight();
    // The square of a smaller number would vanish.
    let is_tiny = largest < MIN_WEIGHT && matches!(definitions, Definitions::Second);
    let unit = if is_tiny { largest } else { 1.0 };
    for (&weight, &direction) in configuration.weight.iter().zip(&configuration.direction) {
        if weight > 0.0 {
            let weight = weight / unit;
            let (sin, cos) = libm::sincos(direction);
            sum = [sum[0] + weight * cos, sum[1] + weight * sin];
            weights += weight;
        }
    }
    let length = length(sum);
    // Rounding could make it larger than 1.
    let strength = (length / weights).min(1.0);
    let is_defined = match definitions {
        Definitions::First => length > CANCELLED * weights,
        Definitions::Second => strength >= MIN_STRENGTH,
    };
    (weights > 0.0).then_some(CommonDirection {
        sum,
        length,
        strength,
        is_defined,
    })
}

/// Measures order and drift from n headings, as unit vectors, and the common direction.
#[must_use]
pub fn order_of(
    headings: impl ExactSizeIterator<Item = [f64; 2]>,
    common: Option<CommonDirection>,
) -> Order {
    let share = 1.0 / headings.len().max(1) as f64;
    let sum = headings.fold([0.0, 0.0], |sum, [cos, sin]| [sum[0] + cos, sum[1] + sin]);
    let velocity = sum.map(|sum| sum * share);
    let defined = common.filter(|it| it.is_defined);
    Order {
        // Rounding could make it larger than 1.
        order: length(velocity).min(1.0),
        velocity,
        strength: common.map(|it| it.strength),
        direction: defined.map(|CommonDirection { sum, .. }| libm::atan2(sum[1], sum[0])),
        drift: defined.map(|CommonDirection { sum, length, .. }| {
            (velocity[0] * sum[0] + velocity[1] * sum[1]) / length
        }),
    }
}

fn length(vector: [f64; 2]) -> f64 {
    (vector[0] * vector[0] + vector[1] * vector[1]).sqrt()
}

/// Running means over steps, of the values at the start of each step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RunningMeans {
    /// Number of steps counted.
    pub count: u64,
    /// Sum of the orders.
    pub order: f64,
    /// Sum of the velocities.
    pub velocity: [f64; 2],
    /// Number of steps with a common direction.
    pub directed: u64,
    /// Sum of the drifts.
    pub drift: f64,
}

impl RunningMeans {
    /// Counts one step; `order` is that at its start.
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

    /// Returns the mean order, the paper's v, eq. (8); `None` without a step.
    #[must_use]
    pub fn mean_order(&self) -> Option<f64> {
        mean(self.order, self.count)
    }

    /// Returns the mean velocity; `None` without a step.
    #[must_use]
    pub fn mean_velocity(&self) -> Option<[f64; 2]> {
        Some([
            mean(self.velocity[0], self.count)?,
            mean(self.velocity[1], self.count)?,
        ])
    }

    /// Returns the mean drift over the steps with a common direction, the paper's `v_pd`; `None`
    /// without such a step.
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

    fn order(configuration: &Configuration) -> Order {
        super::order(configuration, Definitions::default())
    }

    fn heading(angles: &[f64]) -> Configuration {
        let mut configuration = Configuration::default();
        angles.iter().for_each(|&alpha| {
            configuration.push(0.0, 0.0, alpha);
        });
        configuration
    }

    #[test]
    fn order_is_one_for_equal_headings_and_zero_if_they_cancel() {
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
    fn opposite_directions_of_equal_weight_cancel() {
        let mut configuration = heading(&[0.0, 0.0]);
        configuration.inform(0, 0.5, 0.7, None);
        configuration.inform(1, 0.5, 0.7 + PI, None);
        for definitions in [Definitions::First, Definitions::Second] {
            let now = super::order(&configuration, definitions);
            assert_eq!((now.direction, now.drift), (None, None));
            assert!(now.strength.unwrap() < 1e-15);
        }
    }

    #[test]
    fn directions_that_hardly_agree_have_no_common_one() {
        // What is left of 0 and 3.1416 is a rounding of π.
        let mut configuration = heading(&[2.1, 2.2]);
        configuration.inform(0, 0.5, 0.0, None);
        configuration.inform(1, 0.5, 31_416.0 / 10_000.0, None);
        let now = order(&configuration);
        assert_eq!((now.direction, now.drift), (None, None));
        assert!((now.strength.unwrap() - 3.673_205e-6).abs() < 1e-11);
        let before = super::order(&configuration, Definitions::First);
        assert!(before.direction.is_some() && before.drift.is_some());

        // A sum of 1.1 and -0.9 of a total of 2 is at the limit.
        for (weight, is_defined) in [(1.1 + 1e-9, true), (1.1 - 1e-9, false)] {
            configuration.inform(0, weight, 0.0, None);
            configuration.inform(1, 2.0 - weight, PI, None);
            let now = order(&configuration);
            assert_eq!(now.direction.is_some(), is_defined, "{weight}");
            assert_eq!(now.drift.is_some(), is_defined, "{weight}");
            assert!((now.strength.unwrap() - 0.1).abs() < 2e-9);
        }
        configuration.inform(1, 0.3, 0.0, None);
        assert!((order(&configuration).strength.unwrap() - 1.0).abs() < 1e-15);
        assert_eq!(order(&heading(&[0.0])).strength, None);

        // Weights of which the squares vanish.
        configuration.inform(0, 3e-200, 0.0, None);
        configuration.inform(1, 4e-200, PI / 2.0, None);
        let now = order(&configuration);
        assert!((now.strength.unwrap() - 5.0 / 7.0).abs() < 1e-15);
        assert!((now.direction.unwrap() - 4.0_f64.atan2(3.0)).abs() < 1e-15);
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
