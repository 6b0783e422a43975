//! The paper's Figure 4: the times of build-up and breakdown of order.

use crate::axis::Axis;
use crate::curves::{axis_at, distinct, extents, over_n, panels, runs_each};
use crate::plot::{Curve, Mark, Plot, Sample, Style};
use crate::svg::INK;
use jostle_results::TIME_UNIT;
use jostle_results::statistics::{Interval, Summary};

/// Builds the figure.
pub fn plot(summaries: &[Summary]) -> Plot {
    let elongations = distinct(summaries, |condition| condition.pi1);
    let value = |interval: Option<Interval>| interval.map(|it| (it.mean, it.error));
    let panels = panels(summaries, |summaries| {
        let build_up = over_n(&elongations, summaries, Mark::Filled, |summary| {
            value(summary.build_up)
        });
        let breakdown = over_n(&elongations, summaries, Mark::Empty, |summary| {
            value(summary.breakdown)
        });
        build_up
            .into_iter()
            .zip(breakdown)
            .flat_map(label_once)
            .collect()
    });
    let sample = |mark, text: &str| {
        let (colour, dash) = (INK, dash_of(mark));
        Sample {
            style: Style { colour, dash, mark },
            text: text.to_owned(),
        }
    };
    Plot {
        title: "How long order takes to build up and to break down (the paper’s Figure 4)"
            .to_owned(),
        x: axis_at(
            "individuals, n",
            distinct(summaries, |condition| condition.n as f64),
        ),
        y: Axis::around(
            &format!("mean length of an interval ({TIME_UNIT})"),
            true,
            extents(&panels),
        ),
        panels,
        key: vec![vec![
            sample(Mark::Filled, "build-up: v(t) below 2/3"),
            sample(Mark::Empty, "breakdown: v(t) at or above 2/3"),
        ]],
        note: format!(
            "{} each; only where every run reached order. Bars: standard error over the runs.",
            runs_each(summaries)
        ),
    }
}

/// Keeps one label for the two curves of a `pi1`, which have the same colour: that of the curve
/// that extends further.
fn label_once((mut build_up, mut breakdown): (Curve, Curve)) -> [Curve; 2] {
    let end = |curve: &Curve| {
        let last = curve.points.iter().flatten().next_back();
        last.map_or(f64::NEG_INFINITY, |point| point.x)
    };
    if end(&build_up) < end(&breakdown) {
        build_up.label = None;
    } else {
        breakdown.label = None;
    }
    breakdown.style.dash = dash_of(Mark::Empty);
    [build_up, breakdown]
}

fn dash_of(mark: Mark) -> &'static str {
    if mark == Mark::Empty { "4 3" } else { "" }
}
