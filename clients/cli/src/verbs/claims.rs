//! `claims`: compares results with the claims of the paper, or with bands.

use std::fs;
use std::path::{Path, PathBuf};

use jostle_figures::{Kind, draw, save};
use jostle_results::claims::page::{Origin, page};
use jostle_results::claims::{Evidence, bands, claims, rules};
use jostle_results::contact_statistics::{self, ContactStatistics};
use jostle_results::{ResultRow, table};
use serde_json::json;

use crate::arguments::ClaimsArguments;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::table as columns;

/// The commands that produce the results of a page, in the order of its sections.
const COMMANDS: &str = "\
cargo build --release
export PATH=\"$PWD/target/release:$PATH\"
jostled run paper/series1.toml -o target/reproduction/series1
jostled run paper/series2.toml -o target/reproduction/series2
jostled run paper/animations.toml -o target/reproduction/animations
jostle claims target/reproduction/series1 target/reproduction/series2 \\
  --animations target/reproduction/animations --page docs/reproduction.md";

/// The duration of the paper's runs.
const PAPER_TIME: f64 = 1000.0;

const FIGURES: [Kind; 4] = [Kind::Order, Kind::Intervals, Kind::Clusters, Kind::Drift];

/// Compares results with claims or bands; needs no daemon.
pub fn compare(output: Output, arguments: &ClaimsArguments) -> Result<(), Failure> {
    let mut runs = Vec::new();
    for place in &arguments.results {
        runs.extend(table::read(place).map_err(Failure::results)?);
    }
    if let Some(path) = &arguments.bands {
        let bands = bands::read(path).map_err(Failure::results)?;
        return compare_with_bands(output, &bands, &runs, &contact_rows(&arguments.results)?);
    }
    if let Some(path) = &arguments.make_bands {
        let contact_rows = contact_rows(&arguments.results)?;
        let bands = bands::make(&runs, &contact_rows, arguments.runs.get());
        bands::write(path, &bands).map_err(Failure::results)?;
        return output.data(&format!("{} bands in {}", bands.len(), path.display()));
    }
    let contact_rows = contact_rows(arguments.animations.as_slice())?;
    if let Some(path) = &arguments.page {
        return write_page(output, path, &runs, &contact_rows);
    }
    print_claims(output, &runs, &contact_rows)
}

/// The contact data of those results that have them.
fn contact_rows(places: &[PathBuf]) -> Result<Vec<ContactStatistics>, Failure> {
    let mut contact_rows = Vec::new();
    for place in places {
        contact_rows.extend(contact_statistics::read(place).map_err(Failure::results)?);
    }
    Ok(contact_rows)
}

fn print_claims(
    output: Output,
    runs: &[ResultRow],
    contact_rows: &[ContactStatistics],
) -> Result<(), Failure> {
    let mut documents = Vec::new();
    let mut rows = Vec::new();
    for rule in rules(runs) {
        let evidence = Evidence::new(&rule, runs, contact_rows);
        for claim in claims() {
            let answer = (claim.judge)(&evidence);
            documents.push(json!({
                "claim": claim.name, "says": claim.statement, "criterion": claim.criterion,
                "contacts": rule.contacts, "dt": rule.dt, "measured": answer.measured,
                "verdict": answer.verdict.to_string(),
            }));
            rows.push([
                claim.name.to_owned(),
                rule.contacts.clone(),
                answer.verdict.to_string(),
                answer.measured,
            ]);
        }
    }
    rows.sort_by(|one, other| one[0].cmp(&other[0]));
    let text = columns::table(["claim", "contacts", "verdict", "measured"], rows);
    output.print(&documents, &text)?;
    let short = runs.iter().filter(|run| run.time < PAPER_TIME).count();
    if short > 0 {
        let runs = format::count(runs.len() as u64, "run");
        output.note(&format!(
            "{short} of {runs} are shorter than the paper's {PAPER_TIME} time units: these verdicts \
             are not about the paper's runs"
        ));
    }
    Ok(())
}

fn compare_with_bands(
    output: Output,
    bands: &[bands::Band],
    runs: &[ResultRow],
    contact_rows: &[ContactStatistics],
) -> Result<(), Failure> {
    let judged = bands::judge(bands, runs, contact_rows);
    let outside = judged.iter().filter(|it| !it.is_inside()).count();
    let documents = judged.iter().map(|it| {
        json!({
            "quantity": it.band.quantity, "pi1": it.band.pi1, "n": it.band.n,
            "low": it.band.low, "high": it.band.high, "mean": it.mean,
            "inside": it.is_inside(),
        })
    });
    let text = columns::of(
        &judged,
        [
            ("quantity", |it| it.band.quantity.clone()),
            ("pi1", |it| it.band.pi1.to_string()),
            ("n", |it| it.band.n.to_string()),
            ("low", |it| format::fixed(it.band.low, 4)),
            ("mean", |it| {
                format::or_none(it.mean.map(|mean| format::fixed(mean, 4)))
            }),
            ("high", |it| format::fixed(it.band.high, 4)),
            ("", |it| {
                if it.is_inside() { "" } else { "outside" }.to_owned()
            }),
        ],
    );
    output.print(&documents.collect::<Vec<_>>(), &text)?;
    let count = judged.len();
    let unmeasured = judged.iter().filter(|it| it.mean.is_none()).count();
    if unmeasured > 0 {
        return Err(Failure::new(
            "invalid_argument",
            format!("for {unmeasured} of {count} bands the results have no run"),
        ));
    }
    if outside > 0 {
        return Err(Failure::new(
            "mismatch",
            format!("{outside} of {count} means lie outside their bands"),
        ));
    }
    Ok(())
}

fn write_page(
    output: Output,
    path: &Path,
    runs: &[ResultRow],
    contact_rows: &[ContactStatistics],
) -> Result<(), Failure> {
    let folder = path.with_extension("");
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    let system = |error: std::io::Error| Failure::file(path.display(), error);
    fs::create_dir_all(&folder).map_err(system)?;
    let mut figures = Vec::new();
    for kind in FIGURES {
        // A table may lack the data of a figure.
        if let Ok(svg) = draw(kind, runs) {
            let file = format!("figure{}.svg", kind.number());
            save(&svg, &folder.join(&file)).map_err(Failure::results)?;
            figures.push((
                format!("Figure {}", kind.number()),
                format!("{name}/{file}"),
            ));
        }
    }
    let origin = Origin {
        commands: COMMANDS.to_owned(),
        figures,
    };
    fs::write(path, page(runs, contact_rows, &origin)).map_err(system)?;
    let count = format::count(runs.len() as u64, "run");
    let text = format!("{count} on {}", path.display());
    output.data(&text)
}
