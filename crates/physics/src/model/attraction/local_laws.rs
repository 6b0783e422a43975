//! Attraction laws that are computed pair by pair: plain sums in the order of individuals.

use crate::model::Configuration;

/// Returns the unit vector from `from` to `to` and their distance; at the same point both are 0.
pub(super) fn towards(configuration: &Configuration, from: usize, to: usize) -> ([f64; 2], f64) {
    let Configuration { x, y, .. } = configuration;
    let (dx, dy) = (x[to] - x[from], y[to] - y[from]);
    let distance = (dx * dx + dy * dy).sqrt();
    if distance == 0.0 {
        return ([0.0; 2], 0.0);
    }
    ([dx / distance, dy / distance], distance)
}

/// Returns the mean of the unit vectors from `from` to `others`; 0 if `others` is empty.
pub(super) fn mean(
    configuration: &Configuration,
    from: usize,
    others: impl Iterator<Item = usize>,
) -> [f64; 2] {
    let (mut sum, mut count) = ([0.0; 2], 0.0);
    for other in others {
        let (unit, _) = towards(configuration, from, other);
        sum = [sum[0] + unit[0], sum[1] + unit[1]];
        count += 1.0;
    }
    if count == 0.0 {
        return sum;
    }
    sum.map(|component| component / count)
}

/// Returns all indices below `n` but one.
fn others(n: usize, one: usize) -> impl Iterator<Item = usize> {
    (0..n).filter(move |&other| other != one)
}

/// Computes the mean over all others at a distance of at most `radius`.
pub(super) fn metric(configuration: &Configuration, radius: f64, pull: &mut [[f64; 2]]) {
    let n = pull.len();
    for (one, pull) in pull.iter_mut().enumerate() {
        let is_near = |&other: &usize| towards(configuration, one, other).1 <= radius;
        *pull = mean(configuration, one, others(n, one).filter(is_near));
    }
}

/// Computes the mean over the `neighbours` nearest others; of several at one distance those with
/// the lower indices.
pub(super) fn topological(configuration: &Configuration, neighbours: u32, pull: &mut [[f64; 2]]) {
    let (n, neighbours) = (pull.len(), neighbours as usize);
    let mut by_distance = Vec::with_capacity(n);
    for (one, pull) in pull.iter_mut().enumerate() {
        let Configuration { x, y, .. } = configuration;
        by_distance.clear();
        by_distance.extend(others(n, one).map(|other| {
            let (dx, dy) = (x[other] - x[one], y[other] - y[one]);
            (dx * dx + dy * dy, other)
        }));
        if neighbours < by_distance.len() {
            by_distance.select_nth_unstable_by(neighbours - 1, |a, b| {
                a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))
            });
            by_distance.truncate(neighbours);
        }
        by_distance.sort_unstable_by_key(|&(_, other)| other);
        *pull = mean(
            configuration,
            one,
            by_distance.iter().map(|&(_, other)| other),
        );
    }
}

/// Computes the mean over all others, each unit vector times the distance to the power `exponent`.
pub(super) fn power(configuration: &Configuration, exponent: f64, pull: &mut [[f64; 2]]) {
    let n = pull.len();
    let share = 1.0 / (n as f64 - 1.0);
    for (one, pull) in pull.iter_mut().enumerate() {
        let mut sum = [0.0; 2];
        for other in others(n, one) {
            let (unit, distance) = towards(configuration, one, other);
            if distance > 0.0 {
                let weight = libm::pow(distance, exponent);
                sum = [sum[0] + weight * unit[0], sum[1] + weight * unit[1]];
            }
        }
        *pull = sum.map(|component| component * share);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Attraction;
    use crate::model::attraction::AttractionWorkspace;

    fn pull(attraction: Attraction, places: &[[f64; 2]]) -> Vec<[f64; 2]> {
        let mut configuration = Configuration::default();
        for [x, y] in places {
            configuration.push(*x, *y, 0.0);
        }
        let mut pull = Vec::new();
        AttractionWorkspace::default().compute(attraction, &configuration, &mut pull);
        pull
    }

    /// Points on a line, at 0, 1, 3 and 7.
    const LINE: [[f64; 2]; 4] = [[0.0, 0.0], [1.0, 0.0], [3.0, 0.0], [7.0, 0.0]];

    #[test]
    fn the_radius_itself_counts_and_larger_distances_do_not() {
        let right: Vec<f64> = pull(Attraction::Metric { radius: 3.0 }, &LINE)
            .iter()
            .map(|pull| pull[0])
            .collect();
        assert_eq!(right, [1.0, 0.0, -1.0, 0.0]);
    }

    #[test]
    fn the_nearest_are_taken_and_ties_go_to_the_first() {
        let cross = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]];
        let nearest = |neighbours| pull(Attraction::Topological { neighbours }, &cross)[0];
        assert_eq!(nearest(1), [1.0, 0.0]);
        assert_eq!(nearest(2), [0.5, 0.5]);
        assert_eq!(nearest(3), [0.0, 1.0 / 3.0]);
        assert_eq!((nearest(4), nearest(9)), ([0.0, 0.0], [0.0, 0.0]));
    }

    #[test]
    fn a_power_weights_by_distance_and_exponent_zero_is_the_plain_mean() {
        let right = |exponent| pull(Attraction::Power { exponent }, &LINE)[1][0];
        assert!((right(1.0) - (-1.0 + 2.0 + 6.0) / 3.0).abs() < 1e-15);
        assert!((right(-1.0) - (-1.0 + 0.5 + 1.0 / 6.0) / 3.0).abs() < 1e-15);
        let plain = pull(Attraction::default(), &LINE)[1][0];
        assert!((right(0.0) - plain).abs() < 1e-15);
    }

    #[test]
    fn an_individual_at_the_same_point_counts_and_contributes_zero() {
        let places = [[0.0, 0.0], [0.0, 0.0], [2.0, 0.0]];
        for (attraction, expected) in [
            (Attraction::Metric { radius: 5.0 }, 0.5),
            (Attraction::Topological { neighbours: 2 }, 0.5),
            (Attraction::Power { exponent: -1.0 }, 0.25),
            (Attraction::Voronoi, 0.5),
        ] {
            assert_eq!(pull(attraction, &places)[0], [expected, 0.0]);
        }
    }
}
