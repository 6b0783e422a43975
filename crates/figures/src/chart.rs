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
                .map(|(index, curve)| band(index, curve, scale))
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
        note: literal(&note(chart)),
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
fn note(chart: &Chart) -> String {
    let remarks = remarks(chart).into_iter();
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
    let points = curve.points.iter().map(|mean| {
        Some(Point {
            x: mean.x,
            y: mean.spread.mean / scale,
            bar: mean.half_width().filter(|_| has_bars).map(|it| it / scale),
        })
    });
    points.collect()
}

fn band(index: usize, curve: &MeanCurve, scale: f64) -> Band {
    let bounds = |mean: &Mean| {
        let half = mean.half_width().unwrap_or(0.0);
        let [low, high] = [-half, half].map(|by| (mean.spread.mean + by) / scale);
        (mean.x, low, high)
    };
    Band {
        colour: PALETTE[colour(index)],
        points: curve.points.iter().map(bounds).collect(),
    }
}

/// Returns the power of ten by which the values of the vertical axis are divided: 1 for values that
/// tick labels show well.
fn scale(chart: &Chart) -> f64 {
    let points = chart.curves.iter().flat_map(|curve| &curve.points);
    let largest = points.fold(0.0_f64, |largest, mean| largest.max(mean.spread.mean.abs()));
    match largest {
        0.0 => 1.0,
        1e-3..1e5 => 1.0,
        _ => libm::pow(10.0, libm::floor(libm::log10(largest))),
    }
}

fn y_axis(chart: &Chart, unit: &str, scale: f64) -> Axis {
    let factor = match scale {
        1.0 => String::new(),
        _ => format!("{scale:e} "),
    };
    let label = with_unit(&chart.y, &format!("{factor}{unit}"));
    let means = chart.curves.iter().flat_map(|curve| &curve.points);
    let ends = means.flat_map(|mean| {
        let half = mean.half_width().unwrap_or(0.0);
        [-half, half].map(|by| (mean.spread.mean + by) / scale)
    });
    linear(&label, ends)
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
    Axis {
        label: label.to_owned(),
        logarithmic: false,
        ends: (low - room, high + room),
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
mod tests {
    use super::*;
    use jostle_results::statistics::Spread;

    fn mean(x: f64, mean: f64, error: Option<f64>, runs: usize) -> Mean {
        let deviation = error.map(|error| error * (runs as f64).sqrt());
        let spread = Spread {
            mean,
            deviation,
            error,
        };
        Mean { x, spread, runs }
    }

    fn chart(x: &str, y: &str, curves: Vec<(&str, Vec<Mean>)>) -> Chart {
        Chart {
            x: x.to_owned(),
            y: y.to_owned(),
            curves: curves
                .into_iter()
                .map(|(label, points)| MeanCurve {
                    label: label.to_owned(),
                    points,
                })
                .collect(),
            runs: 9,
            left_out: 0,
            empty: Vec::new(),
            ended_early: 0,
        }
    }

    fn svg(chart: &Chart) -> String {
        let svg = draw_chart(chart, &Labels::default()).unwrap();
        assert!(!svg.contains("NaN") && !svg.contains("inf\""), "{svg}");
        svg
    }

    #[test]
    fn points_and_bars_are_where_their_values_are_on_the_axes() {
        let points = vec![mean(0.0, 1.0, None, 1), mean(10.0, 3.0, None, 1)];
        let svg_of_two = svg(&chart("share", "v", vec![("", points)]));
        // The axes are from -0.5 to 10.5 and 0.9 to 3.1.
        let (left, top, right, bottom) = frame(&svg_of_two);
        let x = |share: f64| left + share * (right - left);
        let y = |share: f64| bottom - share * (bottom - top);
        for (x, y) in [
            (x(0.5 / 11.0), y(0.1 / 2.2)),
            (x(10.5 / 11.0), y(2.1 / 2.2)),
        ] {
            let near = svg_of_two.lines().any(|line| {
                let number = |name| attribute(line, name).unwrap_or(f64::NAN);
                (number("cx") - x).abs() < 0.01 && (number("cy") - y).abs() < 0.01
            });
            assert!(near, "{x} {y}: {svg_of_two}");
        }
        assert!(svg_of_two.contains("1 run each"), "{svg_of_two}");
        // t(0.975, 1) = 12.706205: a bar of 2 · 12.706205, and axes of 1.1 times that.
        let one = svg(&chart(
            "share",
            "v",
            vec![("", vec![mean(1.0, 5.0, Some(1.0), 2)])],
        ));
        let (left, top, right, bottom) = frame(&one);
        let (x, middle) = (f64::midpoint(left, right), f64::midpoint(top, bottom));
        let half = (bottom - top) / 2.0 / 1.1;
        let bar = format!("{x} {:.2} {x} {:.2}", middle + half, middle - half);
        let bars: Vec<String> = lines(&one).map(|it| it.join(" ")).collect();
        let rounded = |it: &String| {
            let numbers = it.split(' ').map(|it| it.parse::<f64>().unwrap());
            numbers.map(|it| format!("{it:.2}")).collect::<Vec<_>>()
        };
        let bar = rounded(&bar);
        assert!(bars.iter().any(|it| rounded(it) == bar), "{bar:?}: {one}");
    }

    fn attribute(line: &str, name: &str) -> Option<f64> {
        let (_, after) = line.split_once(&format!(" {name}=\""))?;
        after.split_once('"')?.0.parse().ok()
    }

    /// The coordinates of each line, x and y by turns.
    fn lines(svg: &str) -> impl Iterator<Item = Vec<&str>> {
        let lines = svg.lines().filter(|it| it.starts_with("<polyline"));
        lines.map(|it| it.split('"').nth(1).unwrap().split([' ', ',']).collect())
    }

    /// The left, top, right and bottom of the frame: the line with three points that is a corner.
    fn frame(svg: &str) -> (f64, f64, f64, f64) {
        let frame = lines(svg).find(|it| it.len() == 6 && it[0] == it[2] && it[3] == it[5]);
        let numbers = frame.unwrap().into_iter().map(|it| it.parse().unwrap());
        let numbers: Vec<f64> = numbers.collect();
        (numbers[0], numbers[1], numbers[4], numbers[3])
    }

    #[test]
    fn three_quarters_of_the_width_and_of_the_height_are_the_frame() {
        let points = || vec![mean(1.0, 1e-7, Some(1e-8), 3), mean(2.0, 3e-7, None, 1)];
        let plain = chart("dt", "worst_overlap", vec![("", points())]);
        let mut with_key = chart(
            "dt",
            "worst_overlap",
            vec![("pi1=4", points()), ("pi1=8", points())],
        );
        with_key.left_out = 3;
        let large = vec![mean(0.0, -54_321.5, None, 1), mean(99_999.0, 2.0, None, 1)];
        let wide = chart("time", "drift", vec![("", large)]);
        for chart in [plain, with_key, wide] {
            let svg = svg(&chart);
            let header = svg.lines().next().unwrap();
            let [width, height] = ["width", "height"].map(|it| attribute(header, it).unwrap());
            let (left, top, right, bottom) = frame(&svg);
            assert!(right - left >= 0.75 * width, "{} of {width}", right - left);
            assert!(
                bottom - top >= 0.75 * height,
                "{} of {height}",
                bottom - top
            );
        }
    }

    #[test]
    fn axes_have_units_and_long_titles_several_lines() {
        let points = vec![mean(0.0, 1.0, None, 1), mean(0.1, 3.0, None, 1)];
        let labels = Labels {
            title: "a_name".repeat(10),
            units: ("v0".to_owned(), "s/v0".to_owned()),
        };
        let draw = |x| draw_chart(&chart(x, "v_pd", vec![("", points.clone())]), &labels).unwrap();
        let over_dt = draw("dt");
        for text in [">v_pd (v0)<", ">dt (s/v0)<", ">over dt<"] {
            assert!(over_dt.contains(text), "{text}: {over_dt}");
        }
        let title = format!(">{}: v_pd<", labels.title);
        assert!(over_dt.contains(&title), "{over_dt}");
        let over_time = draw("time");
        assert!(over_time.contains(">time (s/v0)<"), "{over_time}");
    }

    #[test]
    fn a_chart_names_its_curves_its_interval_and_what_is_left_out() {
        let points = || {
            vec![
                mean(2.0, 3e-12, Some(1e-12), 4),
                mean(300.0, 4e-12, None, 1),
            ]
        };
        let mut data = chart(
            "n",
            "worst_residual",
            vec![("pi1=4 share=0.1", points()), ("pi1=8 share=0.1", points())],
        );
        (data.left_out, data.ended_early) = (3, 2);
        data.empty = ["n=400", "n=500"].map(str::to_owned).to_vec();
        let labels = Labels {
            title: "my_runs".to_owned(),
            units: ("body sizes".to_owned(), String::new()),
        };
        let svg = draw_chart(&data, &labels).unwrap();
        for text in [
            ">my_runs: worst_residual over n<",
            ">worst_residual (1e-12 body sizes)<",
            "95 % interval of the mean",
            "1 to 4 runs each",
            "3 of 9 runs without worst_residual are left out, all of n=400 and of n=500. \
             2 of 9 runs end before others.",
            "pi1 = 4, share = 0.1",
            "pi1 = 8, share = 0.1",
        ] {
            assert!(svg.contains(text), "{text}: {svg}");
        }
    }

    #[test]
    fn over_time_the_interval_is_a_band() {
        let points = vec![mean(0.0, 0.0, Some(1.0), 2), mean(5.0, 1.0, Some(0.0), 2)];
        let svg = svg(&chart("time", "order", vec![("", points)]));
        assert!(svg.contains("fill-opacity"), "{svg}");
        assert!(!svg.contains("<circle"), "{svg}");
        // The time axis has no margin.
        let (left, ..) = frame(&svg);
        assert!(svg.contains(&format!("<polygon points=\"{left},")), "{svg}");
    }

    #[test]
    fn more_curves_than_styles_are_rejected() {
        let curves = |count: usize| {
            let curve = |_| ("a=1", vec![mean(1.0, 1.0, None, 1)]);
            chart("n", "v", (0..count).map(curve).collect())
        };
        svg(&curves(MAX_CURVES));
        let rejected = draw_chart(&curves(MAX_CURVES + 1), &Labels::default()).unwrap_err();
        assert_eq!(rejected.curves, 22);
        let styles = (0..MAX_CURVES).map(|index| {
            let style = style(index, false);
            (style.colour, style.dash)
        });
        let distinct: std::collections::BTreeSet<_> = styles.collect();
        assert_eq!(distinct.len(), MAX_CURVES);
    }
}
