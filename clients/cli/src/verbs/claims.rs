//! `claims`: results beside what the paper says, or beside the bands they should fall into.

use std::fs;
use std::path::{Path, PathBuf};

use jostle_figures::{Kind, draw, save};
use jostle_results::claims::page::{Origin, page};
use jostle_results::claims::{Evidence, bands, claims, rules};
use jostle_results::touch::{self, Touch};
use jostle_results::{ResultRow, table};
use serde_json::{Value, json};

use crate::arguments::ClaimsArguments;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::table::table as columns;

/// What a page's results are made by, in the order of its sections.
const COMMANDS: &str = "\
cargo build --release
export PATH=\"$PWD/target/release:$PATH\"
jostled run paper/series1.toml -o target/reproduction/series1
jostled run paper/series2.toml -o target/reproduction/series2
jostled run paper/animations.toml -o target/reproduction/animations
jostle claims target/reproduction/series1 target/reproduction/series2 \\
  --animations target/reproduction/animations --page docs/reproduction.md";

const FIGURES: [Kind; 4] = [Kind::Order, Kind::Intervals, Kind::Clusters, Kind::Drift];

/// Holds results against claims or bands; needs no daemon.
///
/// # Errors
///
/// What cannot be read or written, or [`Failure::OutsideBands`].
pub fn judge(output: Output, arguments: &ClaimsArguments) -> Result<(), Failure> {
    let mut runs = Vec::new();
    for place in &arguments.results {
        runs.extend(table::read(place).map_err(wrong)?);
    }
    if let Some(path) = &arguments.bands {
        let bands = bands::read(path).map_err(wrong)?;
        return against_bands(output, &bands, &runs, &touches(&arguments.results)?);
    }
    if let Some(path) = &arguments.make_bands {
        let touches = touches(&arguments.results)?;
        let bands = bands::make(&runs, &touches, arguments.runs.get());
        bands::write(path, &bands).map_err(wrong)?;
        return output.data(&format!("{} bands in {}", bands.len(), path.display()));
    }
    let touches = touches(arguments.animations.as_slice())?;
    if let Some(path) = &arguments.page {
        return write_page(output, path, &runs, &touches);
    }
    tell(output, &runs, &touches)
}

/// What contacts did, of those results that tell.
fn touches(places: &[PathBuf]) -> Result<Vec<Touch>, Failure> {
    let mut touches = Vec::new();
    for place in places {
        touches.extend(touch::read(place).map_err(wrong)?);
    }
    Ok(touches)
}

fn tell(output: Output, runs: &[ResultRow], touches: &[Touch]) -> Result<(), Failure> {
    let mut rows = Vec::new();
    let mut told = Vec::new();
    for rule in rules(runs) {
        let evidence = Evidence::new(&rule, runs, touches);
        for claim in claims() {
            let answer = (claim.ask)(&evidence);
            told.push(json!({
                "claim": claim.name, "says": claim.says, "criterion": claim.criterion,
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
    if output.json {
        return output.data(&Value::from(told).to_string());
    }
    rows.sort_by(|one, other| one[0].cmp(&other[0]));
    output.data(&columns(["claim", "contacts", "verdict", "measured"], rows))
}

fn against_bands(
    output: Output,
    bands: &[bands::Band],
    runs: &[ResultRow],
    touches: &[Touch],
) -> Result<(), Failure> {
    let judged = bands::judge(bands, runs, touches);
    let outside = judged.iter().filter(|it| !it.is_inside()).count();
    if output.json {
        let told = judged.iter().map(|it| {
            json!({
                "quantity": it.band.quantity, "pi1": it.band.pi1, "n": it.band.n,
                "low": it.band.low, "high": it.band.high, "mean": it.mean,
                "inside": it.is_inside(),
            })
        });
        output.data(&Value::from(told.collect::<Vec<_>>()).to_string())?;
    } else {
        let rows = judged.iter().map(|it| {
            [
                it.band.quantity.clone(),
                it.band.pi1.to_string(),
                it.band.n.to_string(),
                format!("{:.4}", it.band.low),
                it.mean.map_or("-".to_owned(), |mean| format!("{mean:.4}")),
                format!("{:.4}", it.band.high),
                if it.is_inside() { "" } else { "outside" }.to_owned(),
            ]
        });
        let header = ["quantity", "pi1", "n", "low", "mean", "high", ""];
        output.data(&columns(header, rows.collect()))?;
    }
    let count = judged.len();
    let unmeasured = judged.iter().filter(|it| it.mean.is_none()).count();
    if unmeasured > 0 {
        return Err(wrong(format!(
            "for {unmeasured} of {count} bands the results have no run"
        )));
    }
    if outside > 0 {
        return Err(Failure::OutsideBands { outside, count });
    }
    Ok(())
}

fn write_page(
    output: Output,
    path: &Path,
    runs: &[ResultRow],
    touches: &[Touch],
) -> Result<(), Failure> {
    let folder = path.with_extension("");
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    let system = |error: std::io::Error| wrong(format!("{}: {error}", path.display()));
    fs::create_dir_all(&folder).map_err(system)?;
    let mut figures = Vec::new();
    for kind in FIGURES {
        // A table may lack what a figure shows.
        if let Ok(svg) = draw(kind, runs) {
            let file = format!("figure{}.svg", kind.number());
            save(&svg, &folder.join(&file)).map_err(wrong)?;
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
    fs::write(path, page(runs, touches, &origin)).map_err(system)?;
    let count = format::count(runs.len() as u64, "run");
    let told = format!("{count} on {}", path.display());
    output.data(&told)
}

#[expect(clippy::needless_pass_by_value, reason = "`map_err` hands it over")]
fn wrong(error: impl ToString) -> Failure {
    Failure::Results(error.to_string())
}
