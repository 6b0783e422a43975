//! The paper's Figure 6: the drift of groups along the direction of a few informed individuals.

use crate::axis::{Axis, tick_label};
use crate::curves::{axis_at, colour_of, distinct, extents, panels, runs_each};
use crate::plot::{Curve, Mark, Plot, Point, Sample, Style};
use crate::svg::INK;
use jostle_results::statistics::{Condition, Summary};

/// The dashes of the group sizes that the paper shows, and of all others.
const DASHES: [(f64, &str); 3] = [(10.0, ""), (20.0, "1.5 3.5"), (40.0, "8 4")];
const OTHER_DASH: &str = "8 3 1.5 3";

/// The horizontal distance in pixels of curves of neighbouring sizes, and within a size of
/// neighbouring shares.
const ASIDE: (f64, f64) = (9.0, 1.5);

/// Builds the figure.
pub fn plot(summaries: &[Summary]) -> Plot {
    let shares = distinct(summaries, informed_share);
    let sizes = distinct(summaries, |condition| condition.n as f64);
    let mut panels = panels(summaries, |summaries| {
        let mut curves = Vec::new();
        for (size, n) in sizes.iter().enumerate() {
            for (share, value) in shares.iter().enumerate() {
                let points: Vec<Option<Point>> = summaries
                    .iter()
                    .filter(|summary| summary.condition.n as f64 == *n)
                    .filter(|summary| informed_share(&summary.condition) == *value)
                    .map(point)
                    .collect();
                let off_centre =
                    |index: usize, count: usize| index as f64 - (count - 1) as f64 / 2.0;
                curves.push(Curve {
                    label: None,
                    style: Style {
                        colour: colour_of(&shares, *value),
                        dash: dash_of(*n),
                        mark: Mark::Filled,
                    },
                    points,
                    aside: ASIDE.0 * off_centre(size, sizes.len())
                        + ASIDE.1 * off_centre(share, shares.len()),
                    measured: true,
                });
            }
        }
        curves
    });
    for panel in &mut panels {
        panel.marks = shares
            .iter()
            .map(|share| (*share, colour_of(&shares, *share)))
            .collect();
    }
    let extents: Vec<f64> = extents(&panels).chain(shares.iter().copied()).collect();
    let key_row = |samples: Vec<(&'static str, &'static str, String)>| {
        let samples = samples.into_iter().map(|(colour, dash, text)| Sample {
            style: Style {
                colour,
                dash,
                mark: Mark::None,
            },
            text,
        });
        samples.collect()
    };
    let by_share = shares.iter().map(|share| {
        (
            colour_of(&shares, *share),
            "",
            format!("k/n = {}", tick_label(*share)),
        )
    });
    let by_size = sizes.iter().map(|n| (INK, dash_of(*n), format!("n = {n}")));
    Plot {
        title: "Drift towards what the informed prefer (the paper’s Figure 6)".to_owned(),
        x: axis_at(
            "elongation, π_1",
            distinct(summaries, |condition| condition.pi1),
        ),
        y: Axis::around(
            "mean drift, v_{pd} / v_0",
            false,
            extents.into_iter().chain([0.0]),
        ),
        panels,
        key: vec![key_row(by_share.collect()), key_row(by_size.collect())],
        note: format!(
            "Means of {}; bars: their standard deviation (N − 1). Triangles at the right: k/n, the \
             share of informed individuals.",
            runs_each(summaries)
        ),
    }
}

fn dash_of(n: f64) -> &'static str {
    let found = DASHES.iter().find(|(size, _)| *size == n);
    found.map_or(OTHER_DASH, |(_, dash)| dash)
}

/// Returns the share of informed individuals.
fn informed_share(condition: &Condition) -> f64 {
    // Rounded to four digits, so that 4 of 13 and 8 of 26 are one curve.
    (1e4 * condition.informed as f64 / condition.n as f64).round() / 1e4
}

fn point(summary: &Summary) -> Option<Point> {
    let drift = summary.v_pd.filter(|drift| drift.mean.is_finite());
    drift.map(|drift| Point {
        x: summary.condition.pi1,
        y: drift.mean,
        bar: drift.deviation,
    })
}
