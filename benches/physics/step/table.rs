//! Formats the results as text, JSON and CSV.

use jostle_physics::model::State;
use serde_json::json;

use super::backend::{Backend, Quality};

/// Measurements of one backend on one group. Times are in µs per step.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Length over width of a body.
    pub pi1: f64,
    /// Number of individuals.
    pub n: usize,
    /// Duration of a step.
    pub dt: f64,
    /// The solver.
    pub backend: Backend,
    /// Solution of the program alone; none if the backend's step cannot be separated into phases.
    pub qp_us: Option<f64>,
    /// The step without attraction.
    pub step_us: f64,
    /// Attraction alone.
    pub attraction_us: f64,
    /// Trigonometry, neighbours, contacts and the guess of their multipliers; none as for `qp_us`.
    pub contacts_us: Option<f64>,
    /// Quality of the answers.
    pub quality: Quality,
    /// Quality along the backend's own trajectory, where errors add up.
    pub alone: Option<Quality>,
}

impl Row {
    /// Returns a row without times.
    pub fn new(state: &State, backend: Backend, quality: Quality) -> Self {
        Self {
            pi1: state.parameters.pi1,
            n: state.configuration.n(),
            dt: state.parameters.dt,
            backend,
            qp_us: None,
            step_us: f64::NAN,
            attraction_us: f64::NAN,
            contacts_us: None,
            quality,
            alone: None,
        }
    }

    /// Returns the cells of the row, in the order of [`COLUMNS`].
    fn cells(&self) -> [String; 12] {
        let quality = &self.quality;
        let or_dash = |value: Option<f64>| value.map_or("-".to_owned(), figures);
        [
            self.pi1.to_string(),
            self.n.to_string(),
            self.backend.name(),
            or_dash(self.qp_us),
            figures(self.step_us),
            figures(self.attraction_us),
            or_dash(self.contacts_us),
            format!("{:.1}", quality.active),
            format!("{:.1}", quality.iterations),
            quality.fallbacks.to_string(),
            format!("{:.1e}", quality.worst_residual),
            format!("{:.1e}", quality.worst_overlap),
        ]
    }
}

/// Names and widths of the columns. `dt` is the same in all rows and only in JSON.
const COLUMNS: [(&str, usize); 12] = [
    ("pi1", 3),
    ("n", 5),
    ("backend", 9),
    ("qp_us", 9),
    ("step_us", 9),
    ("attraction_us", 13),
    ("contacts_us", 11),
    ("active", 7),
    ("iterations", 10),
    ("fallbacks", 9),
    ("worst_residual", 14),
    ("worst_overlap", 13),
];

/// Formats a number: three figures from 1 on, and always all digits before the point.
pub fn figures(value: f64) -> String {
    match value.abs() {
        size if size < 10.0 => format!("{value:.2}"),
        size if size < 100.0 => format!("{value:.1}"),
        _ => format!("{value:.0}"),
    }
}

/// Returns the heading of the table.
pub fn heading() -> String {
    aligned(&COLUMNS.map(|(name, _)| name.to_owned()))
}

/// Returns one line of the table.
pub fn text(row: &Row) -> String {
    aligned(&row.cells())
}

fn aligned(cells: &[String; 12]) -> String {
    let padded = cells.iter().zip(COLUMNS).map(|(cell, (name, width))| {
        if name == "backend" {
            format!("{cell:<width$}")
        } else {
            format!("{cell:>width$}")
        }
    });
    padded.collect::<Vec<_>>().join("  ")
}

/// Returns a row as one JSON object.
pub fn json(row: &Row) -> String {
    let quality = &row.quality;
    json!({
        "pi1": row.pi1,
        "n": row.n,
        "dt": row.dt,
        "backend": row.backend.name(),
        "qp_us": row.qp_us,
        "step_us": row.step_us,
        "attraction_us": row.attraction_us,
        "contacts_us": row.contacts_us,
        "active": quality.active,
        "iterations": quality.iterations,
        "fallbacks": quality.fallbacks,
        "worst_residual": quality.worst_residual,
        "worst_overlap": quality.worst_overlap,
    })
    .to_string()
}

/// Returns the table of errors of the backends that do not solve to the target.
pub fn errors(rows: &[Row]) -> String {
    let mut lines = vec![format!(
        "{:>3}  {:>5}  {:<13}  {:>12}  {:>12}",
        "pi1", "n", "backend", "worst_error", "mean_error"
    )];
    lines.extend(errors_of(rows).map(|[pi1, n, name, worst, mean]| {
        format!("{pi1:>3}  {n:>5}  {name:<13}  {worst:>12}  {mean:>12}")
    }));
    lines.push("errors are distances from the exact step, over dt v0".to_owned());
    lines.join("\n")
}

/// Returns the cells of the table of errors.
fn errors_of(rows: &[Row]) -> impl Iterator<Item = [String; 5]> {
    inexact(rows).flat_map(|row| {
        let name = row.backend.name();
        let alone = row.alone.map(|quality| (format!("{name} alone"), quality));
        let both = [Some((name, row.quality)), alone];
        both.into_iter().flatten().map(|(name, quality)| {
            [
                row.pi1.to_string(),
                row.n.to_string(),
                name,
                format!("{:.1e}", quality.worst_velocity_error),
                format!("{:.1e}", quality.mean_velocity_error),
            ]
        })
    })
}

/// Returns the rows of the backends that do not solve to the target of a step.
pub fn inexact(rows: &[Row]) -> impl Iterator<Item = &Row> {
    rows.iter()
        .filter(|row| !matches!(row.backend, Backend::Exact | Backend::Fallback))
}

/// Returns the table as CSV; a cell without a value is empty.
pub fn csv(rows: &[Row]) -> String {
    let mut lines = vec![COLUMNS.map(|(name, _)| name).join(",")];
    lines.extend(rows.iter().map(|row| {
        let cells = row.cells();
        cells
            .map(|cell| if cell == "-" { String::new() } else { cell })
            .join(",")
    }));
    lines.join("\n") + "\n"
}

/// Returns the table of errors as CSV.
pub fn errors_csv(rows: &[Row]) -> String {
    let mut lines = vec!["pi1,n,backend,worst_error,mean_error".to_owned()];
    lines.extend(errors_of(rows).map(|cells| cells.join(",")));
    lines.join("\n") + "\n"
}
