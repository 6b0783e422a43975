//! Updates the tables of a step in `docs/performance.md`, of the groups with pi1 = 4; the CSV files
//! beside it have all rows. The prose around the tables is written by hand.

use super::backend::Backend;
use super::table::{self, Row, figures};

/// The length over width of the groups in the tables of the page.
const SHOWN_PI1: f64 = 4.0;

const BACKENDS: [Backend; 6] = [
    Backend::Exact,
    Backend::Fallback,
    Backend::Clarabel,
    Backend::Rapier,
    Backend::Daqp,
    Backend::Piqp,
];

/// Returns the page with new tables between their marks.
pub fn with_tables(page: &str, rows: &[Row]) -> String {
    let times = by_backend(rows, &BACKENDS, |row| figures(row.step_us));
    // The first two solve to the target.
    let errors = by_backend(rows, &BACKENDS[2..], |row| {
        let quality = &row.quality;
        let (worst, mean) = (quality.worst_velocity_error, quality.mean_velocity_error);
        format!("{worst:.1e}, {mean:.1e}")
    });
    let page = replace(page, "table", &times);
    let page = replace(&page, "faster", &faster(rows));
    replace(&page, "errors", &errors)
}

/// Returns a table with a row for each n and a column for each backend.
fn by_backend(rows: &[Row], backends: &[Backend], cell: impl Fn(&Row) -> String) -> String {
    let shown: Vec<&Row> = rows.iter().filter(|row| row.pi1 == SHOWN_PI1).collect();
    let mut counts: Vec<usize> = shown.iter().map(|row| row.n).collect();
    counts.dedup();
    let names: Vec<String> = backends.iter().map(|it| it.name()).collect();
    let rule = "--:|".repeat(1 + backends.len());
    let mut lines = vec![format!("| n | {} |", names.join(" | ")), format!("|{rule}")];
    for n in counts {
        let cells = backends.iter().map(|backend| {
            let row = shown
                .iter()
                .find(|row| (row.n, row.backend) == (n, *backend));
            row.map_or("-".to_owned(), |row| cell(row))
        });
        lines.push(format!(
            "| {n} | {} |",
            cells.collect::<Vec<_>>().join(" | ")
        ));
    }
    lines.join("\n")
}

/// Replaces the text between `<!-- name -->` and `<!-- /name -->`.
fn replace(page: &str, name: &str, text: &str) -> String {
    let (open, close) = (format!("<!-- {name} -->"), format!("<!-- /{name} -->"));
    let (before, rest) = page.split_once(&open).expect("the page has the mark");
    let (_, after) = rest.split_once(&close).expect("the mark is closed");
    format!("{before}{open}\n{text}\n{close}{after}")
}

/// Lists the groups for which the whole step of another solver takes less time than that of the
/// exact solver, with the errors of its velocities.
fn faster(rows: &[Row]) -> String {
    let mut lines = Vec::new();
    for row in table::inexact(rows) {
        let same =
            |ours: &&Row| ours.backend == Backend::Exact && (ours.pi1, ours.n) == (row.pi1, row.n);
        let Some(ours) = rows.iter().find(same) else {
            continue;
        };
        if row.step_us < ours.step_us {
            lines.push(format!(
                "- {} at π1 = {}, n = {}: {} µs a step against our {}. Velocities are off by {} % \
                 at worst, {} % on average.",
                row.backend.name(),
                row.pi1,
                row.n,
                figures(row.step_us),
                figures(ours.step_us),
                percent(row.quality.worst_velocity_error),
                percent(row.quality.mean_velocity_error),
            ));
        }
    }
    if lines.is_empty() {
        return "No other solver is faster in any row of the table.".to_owned();
    }
    lines.join("\n")
}

/// Formats a share in per cent: whole numbers from 1 on, below that two decimals or one figure.
fn percent(share: f64) -> String {
    match 100.0 * share {
        value if value >= 1.0 => format!("{value:.0}"),
        value if value >= 0.01 => format!("{value:.2}"),
        value => format!("{value:.0e}"),
    }
}
