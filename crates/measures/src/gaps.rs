//! Gaps: the pairs of individuals with small ones, the clusters that these connect, and the smallest
//! gap of each individual.

use jostle_physics::model::body::{Body, near_pairs, pose};
use jostle_physics::model::{Configuration, Parameters};

use crate::positions::{Positions, Search};

/// The largest gap that counts as touching, in body sizes. Bodies that push each other overlap by
/// up to some thousandths or leave a gap of the same order, since a step is exact to `dt²`. Bodies
/// that only pass each other are much further apart for most of the time.
pub const TOUCHING: f64 = 1e-3;

/// Margin of the search distance, in body sizes: far above the rounding error of a distance.
const MARGIN: f64 = 1e-6;

/// Computes the sizes of the clusters, the largest first; they add up to n.
///
/// A cluster is a maximal set of individuals that are connected by gaps of at most `gap` body sizes.
/// [`near_pairs`] measures the gaps, independently of the stepper's contacts.
#[must_use]
pub fn cluster_sizes(
    parameters: &Parameters,
    configuration: &Configuration,
    gap: f64,
) -> Vec<usize> {
    let pairs = near_pairs_within(parameters, configuration, gap);
    sizes(configuration.n(), pairs.into_iter().map(|it| it.pair))
}

/// Two individuals and the gap between them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NearPair {
    /// Their indices.
    pub(crate) pair: (u32, u32),
    /// The gap, in body sizes.
    pub(crate) gap: f64,
}

/// Returns all pairs of individuals with a gap of at most `gap` body sizes.
pub(crate) fn near_pairs_within(
    parameters: &Parameters,
    configuration: &Configuration,
    gap: f64,
) -> Vec<NearPair> {
    // The search distance has a margin, since pairs exactly at that distance may be omitted.
    near_pairs(Body::new(parameters), configuration, gap + MARGIN)
        .into_iter()
        .filter(|(_, _, nearness)| nearness.gap <= gap)
        .map(|(one, other, nearness)| NearPair {
            pair: (one, other),
            gap: nearness.gap,
        })
        .collect()
}

/// Returns the sizes of the sets of n individuals that `pairs` connect, the largest first.
pub(crate) fn sizes(n: usize, pairs: impl Iterator<Item = (u32, u32)>) -> Vec<usize> {
    let mut parent: Vec<usize> = (0..n).collect();
    for (one, other) in pairs {
        let [one, other] = [one, other].map(|index| root(&mut parent, index as usize));
        parent[one.max(other)] = one.min(other);
    }
    let mut sizes = vec![0; n];
    for index in 0..n {
        sizes[root(&mut parent, index)] += 1;
    }
    sizes.retain(|&size| size > 0);
    sizes.sort_unstable_by(|one, other| other.cmp(one));
    sizes
}

/// Returns the representative of the cluster of `index`; halves the paths on the way.
fn root(parent: &mut [usize], mut index: usize) -> usize {
    while parent[index] != index {
        parent[index] = parent[parent[index]];
        index = parent[index];
    }
    index
}

/// Measures for each individual the gap to the individual with the smallest gap, in body sizes;
/// infinity if there is no other.
pub(crate) fn smallest_gaps(
    body: Body,
    configuration: &Configuration,
    positions: &Positions,
) -> Vec<f64> {
    // No gap is smaller than that of crossed axes.
    let crossed = -2.0 * body.radius;
    let mut gaps = vec![f64::INFINITY; configuration.n()];
    let mut search = Search::new(positions);
    for vertex in 0..positions.vertices() {
        for &individual in positions.members(vertex) {
            let (here, smallest) = (pose(configuration, individual), &mut gaps[individual]);
            positions.outwards(vertex, &mut search, |distance, others| {
                // From this distance on gaps are larger for all headings.
                if distance > body.centre_distance(*smallest) {
                    return false;
                }
                for &other in others.iter().filter(|&&other| other != individual) {
                    let nearness = body.nearness(here, pose(configuration, other));
                    *smallest = smallest.min(nearness.gap);
                    if *smallest <= crossed {
                        return false;
                    }
                }
                true
            });
        }
    }
    gaps
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::testing::{discs, state};

    #[test]
    fn a_row_of_discs_falls_apart_where_the_gap_is_wide() {
        // Discs of diameter 1: gaps of 0, 0.0005, 0.01 and an overlap of 0.1.
        let row = discs(&[0.0, 1.0, 2.0005, 3.0105, 3.9105].map(|x| [x, 0.0]));
        let sizes = |gap| cluster_sizes(&row.parameters, &row.configuration, gap);
        assert_eq!(sizes(TOUCHING), [3, 2]);
        assert_eq!(sizes(0.0), [2, 2, 1]);
        assert_eq!(sizes(0.02), [5]);
        assert!(cluster_sizes(&row.parameters, &Configuration::default(), 0.0).is_empty());
    }

    #[test]
    fn a_row_is_one_cluster_in_any_order_of_its_members() {
        // Six bodies side by side, 0.4 wide, in no order; the last one is turned and far above.
        let places = [5.0, 0.0, 3.0, 1.0, 4.0, 2.0];
        let mut poses: Vec<[f64; 3]> = places.map(|place| [0.0, 0.4 * place, 0.0]).to_vec();
        poses.push([0.0, 9.0, 1.0]);
        let row = state(&poses);
        let sizes = cluster_sizes(&row.parameters, &row.configuration, TOUCHING);
        assert_eq!(sizes, [6, 1]);
    }

    #[test]
    fn the_smallest_gap_may_be_to_another_than_the_nearest_centre() {
        // Beside the first, at a distance of 0.9, with a gap of 0.5; ahead, 1.65 and 0.05.
        let bodies = state(&[[0.0, 0.0, 0.0], [0.0, 0.9, 0.0], [1.65, 0.0, 0.0]]);
        let positions = Positions::new(&bodies.configuration).unwrap();
        let body = Body::new(&bodies.parameters);
        let gaps = smallest_gaps(body, &bodies.configuration, &positions);
        assert_eq!(gaps.len(), 3);
        for (gap, expected) in gaps.iter().zip([0.05, 0.5, 0.05]) {
            assert!((gap - expected).abs() < 1e-12, "{gaps:?}");
        }
    }
}
