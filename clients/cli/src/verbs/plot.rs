//! `plot`: charts of results, the paper's figures, and pictures of the current state of swarms.

use std::path::Path;

use jostle_client::Client;
use jostle_experiment::{Files, Plan, PlannedRun};
use jostle_figures::snapshot as draw_snapshot;
use jostle_figures::{FigureError, Group, Kind, Labels, Member, draw, draw_chart, remarks, save};
use jostle_proto::{NO_UNIT, State, TIME_UNIT};
use jostle_results::chart::{self, Chart, ChartError};
use jostle_results::table::order::ORDER_NAME;
use jostle_results::table::series::{self as series_table, SERIES_NAME};
use jostle_results::table::{self, Series};
use serde_json::json;

use crate::arguments::PlotArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::suggest::did_you_mean;
use crate::units::unit;
use crate::values::{self, Figure};
use crate::verbs::experiment::{rows, series};

/// What an invocation draws.
enum Subject<'a> {
    /// A figure of the paper, from a table.
    Paper(Kind, &'a str),
    /// The current state of these swarms.
    Swarms(&'a [String]),
    /// A chart of a column of results.
    Chart(Source<'a>, &'a str),
}

/// Where the results of a chart are.
enum Source<'a> {
    Files(&'a Path),
    Experiment(&'a str),
}

/// Draws what needs no daemon; returns whether that is all.
pub fn without_daemon(output: Output, arguments: &PlotArguments) -> Result<bool, Failure> {
    match subject(arguments)? {
        Subject::Paper(kind, results) => {
            let path = Path::new(results);
            check_protocol(kind, path)?;
            let mut runs = table::read(path).map_err(Failure::results)?;
            let faulted = chart::remove_faulted(&mut runs).map_err(rejected)?;
            let svg = draw(kind, &runs).map_err(Failure::results)?;
            note_faulted(output, faulted.len());
            let count = format::count(runs.len() as u64, "run");
            let what = format!("figure {} of {count}", kind.number());
            write(output, &arguments.out, &svg, &what)?;
        }
        Subject::Chart(Source::Files(path), y) => {
            let (chart, faulted, missing) = match arguments.over_time {
                true => {
                    let mut all = read_series(path, y)?;
                    let faulted = remove_faulted_series(path, &mut all)?;
                    let missing = note_faulted(output, faulted);
                    (over_time(&all, y)?, faulted, missing)
                }
                false => {
                    let mut rows = table::read(path).map_err(Failure::results)?;
                    let faulted = chart::remove_faulted(&mut rows).map_err(rejected)?.len();
                    let missing = note_faulted(output, faulted);
                    let chart = chart::over_value(&rows, y, arguments.x.as_deref());
                    (chart.map_err(rejected)?, faulted, missing)
                }
            };
            let missing = missing.into_iter().collect();
            write_chart(output, arguments, (&chart, faulted, missing), &title(path))?;
        }
        Subject::Swarms(_) | Subject::Chart(Source::Experiment(_), _) => return Ok(false),
    }
    Ok(true)
}

/// Draws the current state of swarms, or the results of an experiment of the daemon.
pub async fn of_daemon(context: &Context, arguments: &PlotArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    match subject(arguments)? {
        Subject::Swarms(swarms) => snapshot(context, swarms, &arguments.out).await,
        Subject::Chart(Source::Experiment(name), y) => {
            let mut rows = rows::fetch(client, name).await?.rows;
            let unfinished = rows::note_missing(context, name, rows.len()).await?;
            let faulted = chart::remove_faulted(&mut rows).map_err(rejected)?.len();
            let faults = note_faulted(*output, faulted);
            let missing = unfinished.into_iter().chain(faults).collect();
            let chart = match arguments.over_time {
                true => match series::fetch_all(client, name, &rows).await? {
                    Some(all) => over_time(&all, y)?,
                    None if rows.is_empty() => return Err(rejected(ChartError::Empty)),
                    None => return Err(Failure::argument("--over-time", NO_SERIES)),
                },
                false => chart::over_value(&rows, y, arguments.x.as_deref()).map_err(rejected)?,
            };
            write_chart(*output, arguments, (&chart, faulted, missing), name)
        }
        Subject::Paper(..) | Subject::Chart(Source::Files(_), _) => {
            Err(Failure::defect("drawn without a daemon"))
        }
    }
}

const NO_SERIES: &str = "the experiment records no measures over time: run it with series_every and \
                         columns in [measure]";

fn subject(arguments: &PlotArguments) -> Result<Subject<'_>, Failure> {
    let PlotArguments { what, of, y, .. } = arguments;
    let Some(y) = y else {
        return match (values::figure(what), of.as_slice()) {
            (Ok(Figure::Snapshot), []) => {
                Err(Failure::argument("SWARM", "name one or more swarms"))
            }
            (Ok(Figure::Snapshot), swarms) => Ok(Subject::Swarms(swarms)),
            (Ok(Figure::Of(kind)), [results]) => Ok(Subject::Paper(kind, results)),
            (Ok(Figure::Of(_)), _) => Err(Failure::argument(
                "RESULTS",
                "a figure is drawn from one table: name one folder or file",
            )),
            (Err(problem), _) if of.is_empty() => {
                Err(Failure::argument("--y", no_column(what, &problem)))
            }
            (Err(problem), _) => Err(Failure::argument("FIGURE", problem)),
        };
    };
    if let Some(first) = of.first() {
        let problem = "--y draws one experiment or folder: leave this out";
        return Err(Failure::argument(first, problem));
    }
    let is_table = [".csv", ".parquet"].iter().any(|kind| what.ends_with(kind));
    let path = Path::new(what);
    if path.exists() || is_table {
        return Ok(Subject::Chart(Source::Files(path), y));
    }
    let absent = "no such folder or file";
    if what.contains('/') {
        return Err(Failure::argument(what, absent));
    }
    values::name(what).map_err(|problem| {
        let problem = format!("{absent}, and no name of an experiment: {problem}");
        Failure::argument(what, problem)
    })?;
    Ok(Subject::Chart(Source::Experiment(what), y))
}

/// Describes that no column is named, with those that exist if they are known.
fn no_column(what: &str, problem: &str) -> String {
    match table::read(Path::new(what)) {
        Ok(rows) => format!("name a column, one of {}", chart::columns(&rows).join(", ")),
        Err(_) => format!("name a column of the results, such as v; or a figure: {problem}"),
    }
}

/// Reads the series of a folder or a file that have the measure `y`, if any has.
fn read_series(path: &Path, y: &str) -> Result<Vec<Series>, Failure> {
    if !path.is_dir() {
        return series_table::read(path).map_err(Failure::results);
    }
    let found = [SERIES_NAME, ORDER_NAME].map(|name| path.join(name));
    let mut first = None;
    for path in found.iter().filter(|path| path.exists()) {
        let all = series_table::read(path).map_err(Failure::results)?;
        let measures = all.iter().flat_map(|series| &series.measures);
        if measures.clone().any(|measure| measure.name == y) {
            return Ok(all);
        }
        first.get_or_insert(all);
    }
    first.ok_or_else(|| {
        let problem = format!(
            "{} has neither {SERIES_NAME} nor {ORDER_NAME}: ",
            path.display()
        );
        Failure::argument("--over-time", problem + NO_SERIES)
    })
}

/// Removes the series of runs that a fault ended, by the table of results beside them if there is one;
/// returns their number.
fn remove_faulted_series(path: &Path, all: &mut Vec<Series>) -> Result<usize, Failure> {
    let folder = match path.is_dir() {
        true => path,
        false => path.parent().unwrap_or(path),
    };
    let Ok(mut rows) = table::read(folder) else {
        return Ok(0);
    };
    let faulted = chart::remove_faulted(&mut rows).map_err(rejected)?;
    let count = all.len();
    all.retain(|series| !faulted.contains(&series.run));
    Ok(count - all.len())
}

/// Says that faulted runs are left out; returns what a picture says of them.
fn note_faulted(output: Output, faulted: usize) -> Option<String> {
    if faulted == 0 {
        return None;
    }
    let runs = format::count(faulted as u64, "run");
    output.note(&format!("left out: {runs} ended by a fault"));
    Some(format!("Left out: {runs} ended by a fault"))
}

/// The experiment whose results these are, as far as its file is beside them.
fn plan_of(results: &Path) -> Option<Plan> {
    let folder = match results.is_dir() {
        true => results,
        false => results.parent().unwrap_or(results),
    };
    Plan::stored(Files::stored(folder).ok()?).ok()
}

/// The names of the tables in a folder of results. A table of another name may be of another experiment.
const TABLES: [&str; 4] = [
    table::PARQUET_NAME,
    table::CSV_NAME,
    SERIES_NAME,
    ORDER_NAME,
];

/// The name of the experiment whose results these are; that of the folder or the file if it is unknown.
fn title(results: &Path) -> String {
    let whole = results.canonicalize().unwrap_or(results.to_owned());
    let is_folder = whole.is_dir();
    let name = whole.file_name().unwrap_or(whole.as_os_str());
    if (is_folder || TABLES.iter().any(|table| name == *table))
        && let Some(plan) = plan_of(&whole)
    {
        return plan.name;
    }
    let stem = whole.file_stem().filter(|_| !is_folder);
    stem.unwrap_or(name).to_string_lossy().into_owned()
}

/// Rejects the results of an experiment with a protocol.
fn check_protocol(kind: Kind, results: &Path) -> Result<(), Failure> {
    let Some(plan) = plan_of(results) else {
        return Ok(());
    };
    let has_protocol = |run: &&PlannedRun| plan.point(run).protocol.is_some();
    match plan.runs().iter().filter(has_protocol).count() {
        0 => Ok(()),
        runs => Err(Failure::results(FigureError::Protocol { kind, runs })),
    }
}

fn over_time(all: &[Series], y: &str) -> Result<Chart, Failure> {
    chart::over_time(all, y).map_err(rejected)
}

/// Adds a suggestion for a name with a typing error.
fn rejected(error: ChartError) -> Failure {
    match &error {
        ChartError::Unknown {
            option,
            name,
            available,
            kind,
        } => {
            let question = did_you_mean(name, available).map_or_else(String::new, |it| it + " ");
            let names = available.join(", ");
            let problem = format!("no {kind} {name}: {question}use one of {names}");
            Failure::argument(option, problem)
        }
        _ => Failure::results(error),
    }
}

fn write_chart(
    output: Output,
    arguments: &PlotArguments,
    (chart, faulted, missing): (&Chart, usize, Vec<String>),
    title: &str,
) -> Result<(), Failure> {
    let labels = Labels {
        title: title.to_owned(),
        units: (shown_unit(&chart.y), shown_unit(&chart.x)),
        missing,
    };
    let svg = draw_chart(chart, &labels).map_err(Failure::results)?;
    save(&svg, &arguments.out).map_err(Failure::results)?;
    let out = arguments.out.display().to_string();
    let count = format::count(chart.runs as u64, "run");
    let mut text = format!("drew {} over {} of {count} to {out}", chart.y, chart.x);
    for remark in remarks(chart) {
        text.push_str(&format!("\n{remark}"));
    }
    let document = json!({
        "file": out,
        "runs": chart.runs,
        "left_out": chart.left_out,
        "empty": chart.empty,
        "ended_early": chart.ended_early,
        "faulted": faulted,
    });
    output.print(&document, &text)
}

/// The unit that an axis shows; empty if the column has none.
fn shown_unit(column: &str) -> String {
    match unit(column) {
        NO_UNIT => String::new(),
        unit => unit.to_owned(),
    }
}

async fn snapshot(context: &Context, swarms: &[String], out: &Path) -> Result<(), Failure> {
    let mut groups = Vec::new();
    for swarm in swarms {
        values::name(swarm).map_err(|problem| Failure::argument("SWARM", problem))?;
        groups.push(group(&context.client, swarm).await?);
    }
    let svg = draw_snapshot(&groups).map_err(Failure::results)?;
    let what = format!("a snapshot of {}", swarms.join(", "));
    write(context.output, out, &svg, &what)
}

async fn group(client: &Client, swarm: &str) -> Result<Group, Failure> {
    let status = client.status(swarm).await?;
    let state: State = client.state(swarm).await?.read()?;
    let members = (0..state.id.len()).map(|i| Member {
        x: state.x[i],
        y: state.y[i],
        alpha: state.alpha[i],
        weight: state.weight[i],
        direction: state.direction[i],
    });
    Ok(Group {
        title: format!("{swarm}, time {} {TIME_UNIT}", format::time(state.time)),
        pi1: status.result.parameters.pi1,
        members: members.collect(),
    })
}

fn write(output: Output, out: &Path, svg: &str, what: &str) -> Result<(), Failure> {
    save(svg, out).map_err(Failure::results)?;
    let out = out.display().to_string();
    output.print(&json!({"file": out}), &format!("drew {what} to {out}"))
}
