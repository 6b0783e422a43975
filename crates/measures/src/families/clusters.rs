//! Clusters: groups of individuals connected by contact.

use std::ops::Bound;

use crate::definition::{Argument, Definition};
use crate::gaps::TOUCHING;
use crate::view::View;

/// The largest gap that these measures accept, in body sizes. The number of pairs grows with its
/// square.
pub const LARGEST_GAP: f64 = 2.0;

const GAP: Option<Argument> = Some(Argument {
    name: "gap",
    unit: "body sizes",
    default: Some(TOUCHING),
    range: (Bound::Included(0.0), Bound::Included(LARGEST_GAP)),
});

pub(crate) const DEFINITIONS: [Definition; 4] = [
    Definition {
        name: "clusters.count",
        unit: "clusters",
        formula: "number of sets of individuals connected by gaps of at most `gap`",
        source: "Peruani, Deutsch and Bär, Phys. Rev. E 74, 030904 (2006)",
        range: "1 to n",
        cost: "n log n",
        argument: GAP,
        evaluate: |view, gap| Some(view.clusters(gap).len() as f64),
        ..Definition::PLAIN
    },
    Definition {
        name: "clusters.largest",
        unit: "individuals",
        formula: "max_c s_c, s_c the number of individuals of cluster c",
        source: "Peruani, Deutsch and Bär, Phys. Rev. E 74, 030904 (2006)",
        range: "1 to n",
        cost: "n log n",
        argument: GAP,
        evaluate: |view, gap| view.clusters(gap).first().map(|&size| size as f64),
        ..Definition::PLAIN
    },
    Definition {
        name: "clusters.n_eff",
        unit: "individuals",
        formula: "Σ s_c²/n, s_c the number of individuals of cluster c",
        source: "mean cluster size of Stauffer and Aharony, Introduction to Percolation Theory (1994), section 2.3; compare n_eff in docs/model.md, Observables",
        range: "1 to n",
        cost: "n log n",
        argument: GAP,
        evaluate: |view, gap| Some(effective_size(view, gap)),
        ..Definition::PLAIN
    },
    Definition {
        name: "contacts_per_body",
        unit: "individuals",
        formula: "2 N/n, N the number of pairs with a gap of at most `gap`",
        source: "van Hecke, J. Phys.: Condens. Matter 22, 033101 (2010), the contact number z",
        range: "0 to n - 1",
        cost: "n log n",
        argument: GAP,
        evaluate: |view, gap| Some(2.0 * view.count_pairs(gap) as f64 / view.count()),
        ..Definition::PLAIN
    },
];

/// Returns the size m of equal clusters with the same mean squared order.
///
/// If the members of a cluster head in one direction and those of clusters are independent, the
/// mean of `|Σ e_i|²` is `Σ s_c²`; n/m clusters of size m have `n m`. The `n_eff` of docs/model.md is
/// the size of such clusters as well, but from the measured mean order rather than from contacts.
fn effective_size(view: &View<'_>, gap: f64) -> f64 {
    let sizes = view.clusters(gap);
    let squares = sizes.iter().map(|&size| size as f64 * size as f64);
    squares.sum::<f64>() / view.count()
}

#[cfg(test)]
mod tests {
    use crate::testing::{assert_near, discs, value};

    /// Discs of diameter 1: gaps of 0, 0.0005, 0.01 and an overlap of 0.1.
    const ROW: [[f64; 2]; 5] = [
        [0.0, 0.0],
        [1.0, 0.0],
        [2.0005, 0.0],
        [3.0105, 0.0],
        [3.9105, 0.0],
    ];

    #[test]
    fn measures_of_a_row_of_discs_by_gap() {
        let row = discs(&ROW);
        for (argument, count, largest, squares, pairs) in [
            ("", 2.0, 3.0, 13.0, 3.0),
            ("(0)", 3.0, 2.0, 9.0, 2.0),
            ("(0.02)", 1.0, 5.0, 25.0, 4.0),
        ] {
            let value = |name: &str| value(&format!("{name}{argument}"), &row);
            assert_near(value("clusters.count"), count);
            assert_near(value("clusters.largest"), largest);
            assert_near(value("clusters.n_eff"), squares / 5.0);
            assert_near(value("contacts_per_body"), 2.0 * pairs / 5.0);
        }
        let alone = discs(&ROW[..1]);
        assert_near(value("clusters.n_eff", &alone), 1.0);
        assert_near(value("contacts_per_body", &alone), 0.0);
        assert_eq!(value("clusters.count", &discs(&[])), None);
    }
}
