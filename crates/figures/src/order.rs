//! The paper's Figure 2: the mean order over n, beside that of independent headings.

use crate::axis::Axis;
use crate::curves::{axis_at, distinct, extents, guide, guide_numbers, over_n, panels, runs_each};
use crate::plot::{Mark, Plot};
use jostle_results::disorder::v_ind;
use jostle_results::statistics::Summary;

/// Lower ends of error bars, which may be near 0, extend the logarithmic axis at most to this
/// multiple of the smallest value.
const ROOM_BELOW: f64 = 0.7;

/// Builds the figure.
pub fn plot(summaries: &[Summary]) -> Plot {
    let elongations = distinct(summaries, |condition| condition.pi1);
    let disorder: Vec<(f64, f64)> = guide_numbers(summaries)
        .into_iter()
        .map(|n| (n as f64, v_ind(n)))
        .collect();
    let panels = panels(summaries, |summaries| {
        let mut curves = vec![guide("v_{ind}(n)", disorder.iter().copied())];
        curves.extend(over_n(&elongations, summaries, Mark::Filled, |summary| {
            Some((summary.v.mean, summary.v.deviation))
        }));
        curves
    });
    let means = panels.iter().flat_map(|panel| &panel.curves);
    let least = means
        .flat_map(|curve| curve.points.iter().flatten())
        .map(|point| point.y)
        .fold(f64::INFINITY, f64::min);
    let y = Axis::around(
        "mean speed of the centroid, v / v_0",
        true,
        extents(&panels).filter(|value| *value >= least * ROOM_BELOW),
    );
    Plot {
        title: "Order of a group without preferences (the paper’s Figure 2)".to_owned(),
        x: axis_at(
            "individuals, n",
            distinct(summaries, |condition| condition.n as f64),
        ),
        y,
        panels,
        key: Vec::new(),
        note: format!(
            "Means of {}; bars: their standard deviation (N − 1). Dashed: independent headings, \
             v_{{ind}}. Grey: the bodies.",
            runs_each(summaries)
        ),
    }
}
