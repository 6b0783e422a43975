//! Panels, curves and axes from summaries, shared by the figures.

use crate::axis::{Axis, tick_label};
use crate::plot::{Curve, Mark, Panel, Point, Style};
use crate::svg::{GREY, PALETTE, literal};
use jostle_results::statistics::{Condition, Summary, compare_others};

/// The approximate maximum number of points of a guide over n.
const GUIDE_POINTS: u64 = 150;

/// Builds a panel for each contact rule and time step, for each `pi2`, `pi3` and `pi4` if the table holds
/// several, and for each combination of the other values that vary. The summaries must be ordered by these
/// parameters first.
pub fn panels(summaries: &[Summary], curves: impl Fn(&[Summary]) -> Vec<Curve>) -> Vec<Panel> {
    let family = |summary: &Summary| {
        let Condition {
            dt, pi2, pi3, pi4, ..
        } = summary.condition;
        (summary.condition.contacts.clone(), dt, [pi2, pi3, pi4])
    };
    let (_, _, first) = family(&summaries[0]);
    let several = summaries.iter().any(|summary| family(summary).2 != first);
    let mut groups: Vec<Vec<Summary>> = Vec::new();
    for summaries in summaries.chunk_by(|one, two| family(one) == family(two)) {
        // The other values are the last in the order of conditions: without panels of their own a curve
        // would have several points at one place.
        let mut all = summaries.to_vec();
        all.sort_by(|one, two| compare_others(&one.condition.others, &two.condition.others));
        let same = |one: &Summary, two: &Summary| one.condition.others == two.condition.others;
        groups.extend(all.chunk_by(same).map(<[Summary]>::to_vec));
    }
    let panels = groups.iter().map(|summaries| {
        let (contacts, dt, others) = family(&summaries[0]);
        let mut title = format!("{contacts}, dt = {}", tick_label(dt));
        if several {
            let [pi2, pi3, pi4] = others.map(tick_label);
            // Without informed individuals it has no meaning.
            if summaries[0].condition.informed > 0 {
                title += &format!(", π_2 = {pi2}");
            }
            title += &format!(", π_3 = {pi3}, π_4 = {pi4}");
        }
        for other in summaries[0].condition.others.split_whitespace() {
            title += &literal(&format!(", {}", other.replace('=', " = ")));
        }
        Panel {
            title,
            remark: crossed(summaries),
            curves: curves(summaries),
            bands: Vec::new(),
            marks: Vec::new(),
        }
    });
    panels.collect()
}

/// Describes for how long bodies were crossed, which limits the validity of a contact rule.
fn crossed(summaries: &[Summary]) -> String {
    let shares = summaries
        .iter()
        .map(|summary| 100.0 * summary.crossed_share);
    let worst = shares.clone().fold(0.0, f64::max);
    if worst == 0.0 {
        return "no bodies ever crossed".to_owned();
    }
    let mean = shares.sum::<f64>() / summaries.len() as f64;
    format!("some bodies crossed {mean:.1} % of the time, {worst:.1} % at the worst point")
}

/// Builds one curve over n for each `pi1`, in the colours of [`elongation_style`].
pub fn over_n(
    all: &[f64],
    summaries: &[Summary],
    mark: Mark,
    value: impl Fn(&Summary) -> Option<(f64, Option<f64>)>,
) -> Vec<Curve> {
    summaries
        .chunk_by(|one, two| one.condition.pi1 == two.condition.pi1)
        .map(|summaries| {
            let pi1 = summaries[0].condition.pi1;
            let points = summaries.iter().map(|summary| {
                let (y, bar) = value(summary).filter(|(y, _)| *y > 0.0 && y.is_finite())?;
                let x = summary.condition.n as f64;
                Some(Point { x, y, bar })
            });
            Curve {
                label: Some((format!("π_1 = {}", tick_label(pi1)), Some(pi1))),
                style: elongation_style(all, pi1, mark),
                points: points.collect(),
                aside: 0.0,
                measured: true,
            }
        })
        .collect()
}

/// Returns the style of a `pi1`; `all` are the values in the table.
pub fn elongation_style(all: &[f64], pi1: f64, mark: Mark) -> Style {
    Style {
        colour: colour_of(all, pi1),
        dash: "",
        mark,
    }
}

/// Returns the colour of `value` by its index in `all`.
pub fn colour_of(all: &[f64], value: f64) -> &'static str {
    let index = all.iter().position(|other| *other == value).unwrap_or(0);
    PALETTE[index % PALETTE.len()]
}

/// Creates a dashed guide, a curve without measurements.
pub fn guide(label: &str, points: impl IntoIterator<Item = (f64, f64)>) -> Curve {
    let points = points.into_iter();
    Curve {
        label: Some((label.to_owned(), None)),
        style: Style {
            colour: GREY,
            dash: "7 4",
            mark: Mark::None,
        },
        points: points
            .map(|(x, y)| Some(Point { x, y, bar: None }))
            .collect(),
        aside: 0.0,
        measured: false,
    }
}

/// Lists whole numbers from the smallest to the largest n of `summaries`, for a guide.
pub fn guide_numbers(summaries: &[Summary]) -> Vec<u64> {
    let numbers = summaries.iter().map(|summary| summary.condition.n);
    let first = numbers.clone().min().unwrap_or(1).max(1);
    let last = numbers.max().unwrap_or(1).max(1);
    let step = (last - first).div_ceil(GUIDE_POINTS).max(1);
    let mut numbers: Vec<u64> = (first..last)
        .step_by(usize::try_from(step).unwrap_or(usize::MAX))
        .collect();
    numbers.push(last);
    numbers
}

/// Returns the distinct values of `pick`, ascending.
pub fn distinct(summaries: &[Summary], pick: impl Fn(&Condition) -> f64) -> Vec<f64> {
    let mut values: Vec<f64> = summaries
        .iter()
        .map(|summary| pick(&summary.condition))
        .collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    values
}

/// Creates a logarithmic axis with a tick at each of `values`.
pub fn axis_at(label: &str, values: Vec<f64>) -> Axis {
    let mut axis = Axis::around(label, true, values.iter().copied());
    axis.values = values;
    axis
}

/// Returns the value of every point and the ends of its error bar. A logarithmic axis ignores those
/// that are not positive.
pub fn extents(panels: &[Panel]) -> impl Iterator<Item = f64> {
    let curves = panels.iter().flat_map(|panel| &panel.curves);
    let points = curves.flat_map(|curve| curve.points.iter().flatten());
    points.flat_map(|point| {
        let bar = point.bar.unwrap_or(0.0);
        [point.y, point.y + bar, point.y - bar]
    })
}

/// Describes the number of runs of a point.
pub fn runs_each(summaries: &[Summary]) -> String {
    let runs = summaries.iter().map(|summary| summary.runs);
    let (least, most) = (runs.clone().min().unwrap_or(0), runs.max().unwrap_or(0));
    match (least, most) {
        (1, 1) => "1 run".to_owned(),
        _ if least == most => format!("{most} runs"),
        _ => format!("{least} to {most} runs"),
    }
}
