//! Charts of any column of results over a varied value, and of a measure over time.

use jostle_results::TIME_UNIT;
use jostle_results::chart::{Chart, Mean, MeanCurve};

use crate::axis::Axis;
use crate::plot::{Band, Curve, Mark, Panel, Plot, Point, Sample, Style};
use crate::svg::{PALETTE, literal};

/// The dashes of the curves: the first is of those that have the first colours, and so on.
const DASHES: [&str; 3] = ["", "8 4", "2 3"];

/// The most curves with a style of their own.
pub const MAX_CURVES: usize = PALETTE.len() * DASHES.len();

/// The most values of a horizontal axis that each have a tick.
const MAX_TICKS: usize = 8;

/// The ratio of the largest to the smallest value above which a horizontal axis is logarithmic.
const LOGARITHMIC_FROM: f64 = 20.0;

/// The horizontal distance of neighbouring curves in pixels, so that their bars do not cover each
/// other.
const ASIDE: f64 = 3.0;

/// An error of drawing a chart.
#[derive(Debug, thiserror::Error)]
#[error(
    "draw a chart: {curves} curves, the limit is {MAX_CURVES}: choose as --x the value that varies most, \
     or draw results with fewer varied values"
)]
pub struct TooManyCurves {
    /// The number of curves.
    pub curves: usize,
}

/// What a chart says in addition to its data.
#[derive(Clone, Debug, Default)]
pub struct Labels {
    /// The title, such as the name of the experiment.
    pub title: String,
    /// The units of the vertical axis, and of a horizontal one that is not time; empty if it has none.
    pub units: (String, String),
    /// What the note says of runs that the data does not contain, without the full stops.
    pub missing: Vec<String>,
}

/// Draws a chart as SVG.
///
/// # Errors
///
/// [`TooManyCurves`].
pub fn draw_chart(chart: &Chart, labels: &Labels) -> Result<String, TooManyCurves> {
    if chart.curves.len() > MAX_CURVES {
        let curves = chart.curves.len();
        return Err(TooManyCurves { curves });
    }
    let is_time = chart.x == "time";
    let scale = scale(chart);
    let curves = chart.curves.iter().enumerate();
    let panel = Panel {
        title: String::new(),
        remark: explanation(chart),
        curves: curves
            .clone()
            .map(|(index, curve)| Curve {
                label: None,
                style: style(index, is_time),
                points: points(curve, scale, !is_time),
                aside: match is_time {
                    true => 0.0,
                    false => ASIDE * (index as f64 - (chart.curves.len() - 1) as f64 / 2.0),
                },
                measured: true,
            })
            .collect(),
        bands: match is_time {
            true => curves
                .flat_map(|(index, curve)| bands(index, curve, scale))
                .collect(),
            false => Vec::new(),
        },
        marks: Vec::new(),
    };
    let plot = Plot {
        title: literal(&title(chart, labels)),
        x: x_axis(chart, &labels.units.1),
        y: y_axis(chart, &labels.units.0, scale),
        panels: vec![panel],
        key: key(chart),
        note: literal(&note(chart, labels)),
    };
    Ok(plot.draw())
}

fn title(chart: &Chart, labels: &Labels) -> String {
    let x = if chart.x == "time" { "time" } else { &chart.x };
    match labels.title.as_str() {
        "" => format!("{} over {x}", chart.y),
        title => format!("{title}: {} over {x}", chart.y),
    }
}

/// Describes what points and bars are.
fn explanation(chart: &Chart) -> String {
    let shown = match chart.x.as_str() {
        "time" => "means over runs; bands: 95 % interval of the mean (Student’s t)",
        _ => "means over runs; bars: 95 % interval of the mean (Student’s t)",
    };
    let points = chart.curves.iter().flat_map(|curve| &curve.points);
    let counts = points.map(|point| point.runs);
    let (least, most) = (counts.clone().min().unwrap_or(0), counts.max().unwrap_or(0));
    let runs = match least == most {
        true => format!("{most} runs each"),
        false => format!("{least} to {most} runs each"),
    };
    let runs = if most == 1 {
        "1 run each".to_owned()
    } else {
        runs
    };
    format!("{shown}; {runs}")
}

/// Most conditions without a value that are named each.
const MAX_EMPTY: usize = 3;

/// Describes what is left out.
fn note(chart: &Chart, labels: &Labels) -> String {
    let remarks = labels.missing.iter().cloned().chain(remarks(chart));
    let sentences: Vec<String> = remarks.map(|remark| remark + ".").collect();
    sentences.join(" ")
}

/// Returns the remarks on the runs that a chart does not show, or not to the end.
#[must_use]
pub fn remarks(chart: &Chart) -> Vec<String> {
    let mut remarks = Vec::new();
    if chart.left_out > 0 {
        let all_of = match &chart.empty[..] {
            [] => String::new(),
            [one] => format!(", all of {one}"),
            [one, .., last] if chart.empty.len() > MAX_EMPTY => {
                let count = chart.empty.len();
                format!(", all of {count} conditions, {one} to {last}")
            }
            several => format!(", all of {}", several.join(" and of ")),
        };
        remarks.push(format!(
            "{} of {} runs without {} are left out{all_of}",
            chart.left_out, chart.runs, chart.y
        ));
    }
    if chart.ended_early > 0 {
        remarks.push(format!(
            "{} of {} runs end before others",
            chart.ended_early, chart.runs
        ));
    }
    remarks
}

fn style(index: usize, is_time: bool) -> Style {
    Style {
        colour: PALETTE[colour(index)],
        dash: DASHES[index / PALETTE.len() % DASHES.len()],
        mark: if is_time { Mark::None } else { Mark::Filled },
    }
}

/// Returns the index of a curve's colour: neighbouring curves have colours that differ clearly.
fn colour(index: usize) -> usize {
    const ORDER: [usize; 7] = [4, 0, 2, 5, 1, 3, 6];
    ORDER[index % PALETTE.len()]
}

fn points(curve: &MeanCurve, scale: f64, has_bars: bool) -> Vec<Option<Point>> {
    let mut points = Vec::new();
    for mean in &curve.points {
        if mean.after_gap {
            points.push(None);
        }
        points.push(Some(Point {
            x: mean.x,
            y: mean.spread.mean / scale,
            bar: mean.half_width().filter(|_| has_bars).map(|it| it / scale),
        }));
    }
    points
}

/// Returns the bands of a curve, one for each stretch of it.
fn bands(index: usize, curve: &MeanCurve, scale: f64) -> Vec<Band> {
    let bounds = |mean: &Mean| {
        let half = mean.half_width().unwrap_or(0.0);
        let [low, high] = [-half, half].map(|by| (mean.spread.mean + by) / scale);
        (mean.x, low, high)
    };
    let stretches = curve.points.chunk_by(|_, mean| !mean.after_gap);
    let bands = stretches.map(|points| Band {
        colour: PALETTE[colour(index)],
        points: points.iter().map(bounds).collect(),
    });
    bands.collect()
}

/// Returns the power of ten by which the values of the vertical axis are divided: 1 for values that
/// tick labels show well.
fn scale(chart: &Chart) -> f64 {
    let ends = ends(chart);
    let largest = ends.fold(0.0_f64, |largest, value| largest.max(value.abs()));
    match largest {
        0.0 => 1.0,
        1e-3..1e5 => 1.0,
        // Smaller powers are no normal doubles.
        _ => libm::pow(10.0, libm::floor(libm::log10(largest)).max(-300.0)),
    }
}

/// The lower and the upper end of each mean's interval.
fn ends(chart: &Chart) -> impl Iterator<Item = f64> {
    let means = chart.curves.iter().flat_map(|curve| &curve.points);
    means.flat_map(|mean| {
        let half = mean.half_width().unwrap_or(0.0);
        [-half, half].map(|by| mean.spread.mean + by)
    })
}

fn y_axis(chart: &Chart, unit: &str, scale: f64) -> Axis {
    let factor = match scale {
        1.0 => String::new(),
        _ => format!("{scale:e} "),
    };
    let label = with_unit(&chart.y, &format!("{factor}{unit}"));
    linear(&label, ends(chart).map(|value| value / scale))
}

/// Returns the label of an axis: the name of a quantity, and its unit if it has one.
fn with_unit(name: &str, unit: &str) -> String {
    match unit.trim() {
        "" => literal(name),
        unit => literal(&format!("{name} ({unit})")),
    }
}

/// Creates a linear axis around values, also around a single one.
fn linear(label: &str, values: impl Iterator<Item = f64>) -> Axis {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for value in values {
        (low, high) = (low.min(value), high.max(value));
    }
    let length = high - low;
    let room = match length > 1e-9 * low.abs().max(high.abs()) {
        true => 0.05 * length,
        false => (0.1 * low.abs()).max(0.01),
    };
    let ends = (low - room, (high + room).min(f64::MAX));
    Axis {
        label: label.to_owned(),
        logarithmic: false,
        ends: match (ends.1 - ends.0).is_finite() {
            true => ends,
            false => (low, high),
        },
        values: Vec::new(),
    }
}

fn x_axis(chart: &Chart, unit: &str) -> Axis {
    let points = chart.curves.iter().flat_map(|curve| &curve.points);
    let mut values: Vec<f64> = points.map(|mean| mean.x).collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    if chart.x == "time" {
        let ends = (values[0], values[values.len() - 1]);
        let mut axis = linear(&with_unit("time", TIME_UNIT), values.into_iter());
        if ends.0 < ends.1 {
            axis.ends = ends;
        }
        return axis;
    }
    let (first, last) = (values[0], values[values.len() - 1]);
    let is_logarithmic = values.len() > 2 && first > 0.0 && last / first >= LOGARITHMIC_FROM;
    let label = with_unit(&chart.x, unit);
    let mut axis = match is_logarithmic {
        true => Axis::around(
            &format!("{label} (logarithmic)"),
            true,
            values.iter().copied(),
        ),
        false => linear(&label, values.iter().copied()),
    };
    if values.len() <= MAX_TICKS {
        axis.values = values;
    }
    axis
}

/// The width of a row of the key, in pixels, unless a single sample is wider.
const KEY_WIDTH: f64 = 740.0;

/// Returns the key, in rows; empty for a single curve without a label.
fn key(chart: &Chart) -> Vec<Vec<Sample>> {
    let is_time = chart.x == "time";
    let mut rows: Vec<Vec<Sample>> = Vec::new();
    let mut width = f64::INFINITY;
    for (index, curve) in chart.curves.iter().enumerate() {
        if curve.label.is_empty() {
            continue;
        }
        let text = curve.label.replace(' ', ", ").replace('=', " = ");
        let sample = Sample {
            style: style(index, is_time),
            text: literal(&text),
        };
        let more = sample.width();
        if width + more > KEY_WIDTH {
            rows.push(Vec::new());
            width = 0.0;
        }
        width += more;
        if let Some(row) = rows.last_mut() {
            row.push(sample);
        }
    }
    rows
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
pub(crate) mod readback;
#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
