//! Draws time against the number of individuals, as an SVG for light and dark pages.

use std::fmt::Write;

use super::backend::Backend;
use super::table::{Row, figures};

/// The length over width that is drawn, if it was measured.
const DRAWN: f64 = 4.0;

/// Coordinates of the frame: left, top, right, bottom.
const FRAME: [f64; 4] = [72.0, 56.0, 552.0, 400.0];

/// Minimum distance of two labels, each of two lines.
const MIN_LABEL_DISTANCE: f64 = 36.0;

/// Colours with similar contrast on white and near-black, distinguishable with colour blindness.
const STYLE: &str = "\
text { font: 13px system-ui, sans-serif; fill: #24292f } .small { font-size: 11px; fill: #57606a } \
.title { font-size: 15px; font-weight: 600 } .grid { stroke: #d8dee4; stroke-width: 1 } \
path { fill: none; stroke-width: 2.5; stroke-linejoin: round } .thin { stroke-width: 1.5; stroke-dasharray: 5 4 } \
.exact { stroke: #2f81d6 } .clarabel { stroke: #d9772b } .rapier { stroke: #a86bc7 } \
circle.exact { fill: #2f81d6 } circle.clarabel { fill: #d9772b } circle.rapier { fill: #a86bc7 } \
text.exact { fill: #2f81d6 } text.clarabel { fill: #d9772b } text.rapier { fill: #a86bc7 } \
text.exact, text.clarabel, text.rapier { stroke: none; font-weight: 600 } \
@media (prefers-color-scheme: dark) { text { fill: #e6edf3 } .small { fill: #9198a1 } .grid { stroke: #30363d } }";

/// A curve, its CSS class, and the label at its end.
struct Curve {
    class: &'static str,
    /// Dashed and without a label.
    thin: bool,
    /// Number of individuals and time in µs.
    points: Vec<(f64, f64)>,
    label: String,
    remark: String,
}

/// Draws the step without attraction of three backends, and the exact solver's solution of the
/// program alone. Empty if no row has the aspect ratio [`DRAWN`].
pub fn svg(rows: &[Row]) -> String {
    let drawn = |row: &&Row| row.pi1 == DRAWN;
    let rows: Vec<&Row> = match rows.iter().filter(drawn).collect::<Vec<_>>() {
        rows if rows.is_empty() => return String::new(),
        rows => rows,
    };
    let curves = curves(&rows);
    let (mut low, mut high) = (f64::INFINITY, 0.0f64);
    for (_, cost) in curves.iter().flat_map(|curve| &curve.points) {
        (low, high) = (low.min(*cost), high.max(*cost));
    }
    let (low, high) = (low.log10().floor(), high.log10().ceil());
    let counts: Vec<f64> = curves[0].points.iter().map(|point| point.0).collect();
    let (first, last) = (counts[0].log10(), counts[counts.len() - 1].log10());
    let [left, top, right, bottom] = FRAME;
    let across = |n: f64| left + (right - left) * (n.log10() - first) / (last - first).max(1e-9);
    let up = |cost: f64| bottom - (bottom - top) * (cost.log10() - low) / (high - low);

    let mut out = String::from(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 760 456\" role=\"img\">\n",
    );
    let mut put = |line: String| writeln!(out, "{line}").expect("writing to a string succeeds");
    put(format!("<style>{STYLE}</style>"));
    put(
        "<title>CPU time of a step against the number of individuals, both logarithmic</title>"
            .to_owned(),
    );
    put(format!(
        "<text class=\"title\" x=\"{left}\" y=\"24\">A step without attraction, µs of CPU time</text>"
    ));
    put(format!(
        "<text class=\"small\" x=\"{left}\" y=\"42\">settled groups, π1 = {DRAWN}, dt = {}; dashed: our program alone</text>",
        rows[0].dt
    ));
    #[expect(clippy::cast_possible_truncation, reason = "a few decades")]
    for decade in low as i32..=high as i32 {
        let y = up(10f64.powi(decade));
        put(format!(
            "<line class=\"grid\" x1=\"{left}\" x2=\"{right}\" y1=\"{y:.1}\" y2=\"{y:.1}\"/>"
        ));
        let name = grouped(10f64.powi(decade));
        put(format!(
            "<text class=\"small\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{name}</text>",
            left - 8.0,
            y + 4.0
        ));
    }
    for &n in &counts {
        let (x, below) = (across(n), bottom + 18.0);
        put(format!(
            "<line class=\"grid\" x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{top}\" y2=\"{bottom}\"/>"
        ));
        put(format!(
            "<text class=\"small\" x=\"{x:.1}\" y=\"{below}\" text-anchor=\"middle\">{}</text>",
            grouped(n)
        ));
    }
    put(format!(
        "<text class=\"small\" x=\"{:.1}\" y=\"{}\" text-anchor=\"middle\">individuals</text>",
        (left + right) / 2.0,
        bottom + 40.0
    ));
    for curve in &curves {
        let class = curve.class;
        let path: Vec<String> = curve
            .points
            .iter()
            .map(|&(n, cost)| format!("{:.1} {:.1}", across(n), up(cost)))
            .collect();
        let thin = if curve.thin { " thin" } else { "" };
        put(format!(
            "<path class=\"{class}{thin}\" d=\"M{}\"/>",
            path.join(" L")
        ));
        for &(n, cost) in curve.points.iter().filter(|_| !curve.thin) {
            let (x, y) = (across(n), up(cost));
            put(format!(
                "<circle class=\"{class}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3\"/>"
            ));
        }
    }
    for (curve, y) in placed(&curves, up) {
        let (x, class) = (right + 12.0, curve.class);
        put(format!(
            "<text class=\"{class}\" x=\"{x}\" y=\"{y:.1}\">{}</text>",
            curve.label
        ));
        put(format!(
            "<text class=\"small\" x=\"{x}\" y=\"{:.1}\">{}</text>",
            y + 14.0,
            curve.remark
        ));
    }
    out + "</svg>\n"
}

fn curves(rows: &[&Row]) -> Vec<Curve> {
    let of = |backend: Backend| rows.iter().filter(move |row| row.backend == backend);
    let worst = |backend: Backend, what: fn(&Row) -> f64| {
        of(backend).map(|row| what(row)).fold(0.0, f64::max)
    };
    let mut curves = Vec::new();
    for (backend, class, label) in [
        (Backend::Exact, "exact", "jostle"),
        (Backend::Clarabel, "clarabel", "Clarabel"),
        (Backend::Rapier, "rapier", "rapier"),
    ] {
        let points: Vec<_> = of(backend).map(|row| (row.n as f64, row.step_us)).collect();
        if points.is_empty() {
            continue;
        }
        let residual = worst(backend, |row| row.quality.worst_residual);
        let error = 100.0 * worst(backend, |row| row.quality.worst_velocity_error);
        let remark = match backend {
            Backend::Rapier => format!("velocities off by up to {} %", figures(error)),
            _ => format!("residuals up to {residual:.0e}"),
        };
        curves.push(Curve {
            class,
            thin: false,
            points,
            label: label.to_owned(),
            remark,
        });
    }
    let program = of(Backend::Exact).filter_map(|row| Some((row.n as f64, row.qp_us?)));
    let points: Vec<_> = program.collect();
    if !points.is_empty() {
        curves.push(Curve {
            class: "exact",
            thin: true,
            points,
            label: String::new(),
            remark: String::new(),
        });
    }
    curves
}

/// Returns the curves with labels and the y of each label: the end of the curve, moved down if two
/// labels would overlap.
fn placed(curves: &[Curve], up: impl Fn(f64) -> f64) -> Vec<(&Curve, f64)> {
    let end = |curve: &Curve| up(curve.points[curve.points.len() - 1].1);
    let labelled = curves.iter().filter(|curve| !curve.thin);
    let mut placed: Vec<(&Curve, f64)> = labelled.map(|curve| (curve, end(curve))).collect();
    placed.sort_by(|a, b| a.1.total_cmp(&b.1));
    for k in 1..placed.len() {
        placed[k].1 = placed[k].1.max(placed[k - 1].1 + MIN_LABEL_DISTANCE);
    }
    placed
}

/// Formats a number. From 10,000 on thousands are separated by commas; then it must be whole.
fn grouped(value: f64) -> String {
    let digits = value.to_string();
    if value < 10_000.0 {
        return digits;
    }
    let mut grouped = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            grouped.push(',');
        }
        grouped.push(digit);
    }
    grouped
}
