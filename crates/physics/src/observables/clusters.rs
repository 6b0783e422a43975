//! Clusters: groups of individuals connected by contact.

use crate::model::body::{Body, near_pairs};
use crate::model::{Configuration, Parameters};

/// The largest gap that counts as touching, in body sizes. Bodies that push each other overlap by
/// up to some thousandths or leave a gap of the same order, since a step is exact to `dt²`. Bodies
/// that only pass each other are much further apart for most of the time.
pub const TOUCHING: f64 = 1e-3;

/// Margin of the search distance, in body sizes: far above the rounding error of a distance.
const MARGIN: f64 = 1e-6;

/// Computes the sizes of the clusters, the largest first; they add up to n.
///
/// A cluster is a maximal set of individuals that are connected by gaps of at most `touching` body
/// sizes. [`near_pairs`] measures the gaps, independently of the stepper's contacts.
#[must_use]
pub fn cluster_sizes(
    parameters: &Parameters,
    configuration: &Configuration,
    touching: f64,
) -> Vec<usize> {
    let mut parent: Vec<usize> = (0..configuration.n()).collect();
    // The search distance has a margin, since pairs exactly at that distance may be omitted.
    for (i, j, nearness) in near_pairs(Body::new(parameters), configuration, touching + MARGIN) {
        if nearness.gap > touching {
            continue;
        }
        let [one, other] = [i, j].map(|index| root(&mut parent, index as usize));
        parent[one.max(other)] = one.min(other);
    }
    let mut sizes = vec![0; configuration.n()];
    for index in 0..configuration.n() {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_of_discs_falls_apart_where_the_gap_is_wide() {
        let parameters = Parameters {
            pi1: 1.0,
            ..Parameters::default()
        };
        let mut configuration = Configuration::default();
        // Discs of diameter 1: gaps of 0, 0.0005, 0.01 and an overlap of 0.1.
        for x in [0.0, 1.0, 2.0005, 3.0105, 3.9105] {
            configuration.push(x, 0.0, 0.0);
        }
        let sizes = |touching| cluster_sizes(&parameters, &configuration, touching);
        assert_eq!(sizes(TOUCHING), [3, 2]);
        assert_eq!(sizes(0.0), [2, 2, 1]);
        assert_eq!(sizes(0.02), [5]);
        assert!(cluster_sizes(&parameters, &Configuration::default(), 0.0).is_empty());
    }

    #[test]
    fn a_row_is_one_cluster_in_any_order_of_its_members() {
        let parameters = Parameters::default();
        let mut configuration = Configuration::default();
        // Six bodies side by side, 0.4 wide, in no order; the last one is turned and far above.
        for place in [5.0, 0.0, 3.0, 1.0, 4.0, 2.0] {
            configuration.push(0.0, 0.4 * place, 0.0);
        }
        configuration.push(0.0, 9.0, 1.0);
        assert_eq!(cluster_sizes(&parameters, &configuration, TOUCHING), [6, 1]);
    }
}
