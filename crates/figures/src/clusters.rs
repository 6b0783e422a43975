//! The paper's Figure 5: the effective size of ordered clusters.

use crate::axis::Axis;
use crate::curves::{axis_at, distinct, extents, guide, guide_numbers, over_n, panels, runs_each};
use crate::plot::{Mark, Plot};
use jostle_results::statistics::Summary;

/// Builds the figure.
pub fn plot(summaries: &[Summary]) -> Plot {
    let elongations = distinct(summaries, |condition| condition.pi1);
    let ends = guide_numbers(summaries);
    let whole = [ends.first(), ends.last()].map(|end| end.map_or(1.0, |n| *n as f64));
    let panels = panels(summaries, |summaries| {
        let mut curves = vec![guide("n_{eff} = n", whole.map(|n| (n, n)))];
        curves.extend(over_n(&elongations, summaries, Mark::Filled, |summary| {
            summary.n_eff.map(|n_eff| (n_eff, None))
        }));
        curves
    });
    Plot {
        title: "Effective size of ordered clusters (the paper’s Figure 5)".to_owned(),
        x: axis_at(
            "individuals, n",
            distinct(summaries, |condition| condition.n as f64),
        ),
        y: Axis::around("effective cluster size, n_{eff}", true, extents(&panels)),
        panels,
        key: Vec::new(),
        note: format!(
            "From the mean speed of {}: v_{{ind}}(n / n_{{eff}}) = v. No point where v is below \
             v_{{ind}}(n). Dashed: all as one.",
            runs_each(summaries)
        ),
    }
}
