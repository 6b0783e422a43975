//! `experiment results`: the results of an experiment so far, as tables.

use std::collections::HashSet;
use std::fs;
use std::path::Path;

use jostle_client::Client;
use jostle_proto::{OrderPage, Progress};
use jostle_results::table::SeriesWriter;
use jostle_results::table::series::SERIES_NAME;
use jostle_results::{ResultRow, table as tables};
use serde_json::json;

use crate::arguments::ResultsArguments;
use crate::bound::{self, Bound};
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::output;
use crate::verbs::experiment::aggregate::Aggregates;
use crate::verbs::experiment::over_time::Pages;
use crate::verbs::experiment::rows::Table;
use crate::verbs::experiment::{phase, rows, series, trajectory};

/// The failure for the name of a folder of results.
fn of_folder(name: &str) -> Option<Failure> {
    let table = Path::new(name).join("results.csv");
    let problem = format!(
        "{name} is a folder, not an experiment of the daemon: {} is its table, and `jostle plot {name}` \
         draws it",
        table.display()
    );
    table.is_file().then(|| Failure::argument("NAME", problem))
}

/// Shows or writes the results of an experiment.
pub async fn results(context: &Context, arguments: &ResultsArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    let ResultsArguments {
        name,
        out,
        force,
        csv,
        by,
        limit,
        all,
        order,
        series,
        trajectory: of_trajectory,
    } = arguments;
    if output.json && *csv {
        let problem = "prints CSV, and --json JSON: leave out one of them";
        return Err(Failure::argument("--csv", problem));
    }
    if let Some(run) = of_trajectory {
        return trajectory::results(context, arguments, run).await;
    }
    if let Some(run) = order {
        return print_order(context, arguments, run).await;
    }
    if let Some(run) = series {
        return series::print(context, arguments, run.as_deref()).await;
    }
    let fetched = rows::fetch(client, name).await;
    let Table { rows, extra } = fetched.map_err(|error| of_folder(name).unwrap_or(error))?;
    if rows.is_empty() {
        let progress: Progress = client.get_experiment(name, "progress").await?.read()?;
        if progress.finished == progress.runs {
            return Err(without_steps(&progress));
        }
    }
    if let Some(out) = out {
        if !force {
            check_replaceable(out, &rows)?;
        }
        let progress: Progress = client.get_experiment(name, "progress").await?.read()?;
        let mut written = write(out, &rows, &extra)?;
        written.extend(write_series(client, name, out, &rows).await?);
        let document = json!({"experiment": name, "runs": rows.len(), "written": written});
        let written = listed(&written);
        let text = match rows.len() as u64 {
            count if count < progress.runs => {
                let (runs, phase) = (format::count(progress.runs, "run"), phase(progress.phase));
                format!("wrote {count} of {runs} to {written}: {name} is {phase}")
            }
            count => format!("wrote {} to {written}", format::count(count, "run")),
        };
        return output.print(&document, &text);
    }
    if *csv {
        return output::write(&tables::csv(&rows, &extra));
    }
    let most = bound::most(output.json, *limit, *all);
    let aggregates = Aggregates::of(&rows, by.as_deref(), most)?;
    if output.json {
        return output.document(&aggregates.to_json(name, rows.len()));
    }
    if rows.is_empty() {
        output.note(&format!("no run of {name} is finished so far"));
        return Ok(());
    }
    output.data(&aggregates.table())?;
    if aggregates.left_out() > 0 {
        output.note(&bound::note(aggregates.left_out() as u64, "line"));
    }
    rows::note_missing(context, name, rows.len()).await?;
    match rows.iter().filter(|row| row.fault.is_some()).count() as u64 {
        0 => Ok(()),
        count => output.data(&faults(count)),
    }
}

/// No run of those that are over has taken a step.
fn without_steps(progress: &Progress) -> Failure {
    let (name, runs) = (&progress.name, format::count(progress.finished, "run"));
    let problem =
        "ended by a fault at step 0 and without results: `jostled run FILE -o FOLDER` says why";
    Failure::new("incorrect_state", format!("{runs} of {name} {problem}"))
}

async fn print_order(
    context: &Context,
    arguments: &ResultsArguments,
    run: &str,
) -> Result<(), Failure> {
    let Context { client, output } = context;
    series::check_run("--order", run)?;
    let mut bound = Bound::new(bound::most(output.json, arguments.limit, arguments.all));
    let mut pages = Pages::new(client, &arguments.name, ("order", run, ""));
    let mut series: Option<OrderPage> = None;
    while let Some(page) = pages.next::<OrderPage>(&mut bound).await? {
        match &mut series {
            None => series = Some(page),
            Some(series) => {
                series.time.extend(page.time);
                series.order.extend(page.order);
                series.drift.extend(page.drift);
            }
        }
    }
    let Some(OrderPage {
        name,
        run,
        time,
        order,
        drift,
        ..
    }) = series
    else {
        return Err(Failure::defect("no page was queried"));
    };
    let drift: Vec<_> = drift
        .into_iter()
        .map(|it| (!it.is_nan()).then_some(it))
        .collect();
    if output.json {
        return output.document(&json!({
            "name": name, "run": run, "time": time, "order": order, "drift": drift,
            "left_out": bound.left_out,
        }));
    }
    let mut text = String::from("time,order,drift\n");
    for (index, (time, order)) in time.iter().zip(&order).enumerate() {
        let drift = drift.get(index).copied().flatten();
        let drift = drift.map(|it| it.to_string());
        text.push_str(&format!("{time},{order},{}\n", drift.unwrap_or_default()));
    }
    output::write(&text)?;
    if bound.left_out > 0 {
        output.note(&bound::note(bound.left_out, "row"));
    }
    Ok(())
}

/// Rejects to replace tables unless `rows` have all of their runs.
fn check_replaceable(out: &Path, rows: &[ResultRow]) -> Result<(), Failure> {
    let names = [tables::PARQUET_NAME, tables::CSV_NAME];
    if !out.is_file() && !names.iter().any(|name| out.join(name).exists()) {
        return Ok(());
    }
    let rejected = |problem: String| {
        let problem = format!("{problem}: name another, or --force replaces it");
        Err(Failure::argument(out.display(), problem))
    };
    let Ok(existing) = tables::read(out) else {
        return rejected("is no table of results".to_owned());
    };
    // A result is determined by the run and its seed.
    let runs: HashSet<_> = rows.iter().map(identity).collect();
    let others = existing.iter().filter(|row| !runs.contains(&identity(row)));
    match others.count() {
        0 => Ok(()),
        others => rejected(format!(
            "has {} that these results do not have",
            format::count(others as u64, "run")
        )),
    }
}

fn identity(row: &ResultRow) -> (&str, u64, &str) {
    (&row.run, row.seed, &row.state_hash)
}

/// Writes both tables into a folder, or one to a file, and returns the paths.
fn write(out: &Path, rows: &[ResultRow], extra: &[String]) -> Result<Vec<String>, Failure> {
    jostle_atomic_file::remove_abandoned(out);
    match out.extension().and_then(|extension| extension.to_str()) {
        Some("csv") => tables::write_csv(out, rows, extra).map_err(Failure::results)?,
        Some("parquet") => tables::write_parquet(out, rows, extra).map_err(Failure::results)?,
        _ => {
            fs::create_dir_all(out).map_err(|error| Failure::file(out.display(), error))?;
            tables::write(out, rows, extra).map_err(Failure::results)?;
            let paths = [tables::PARQUET_NAME, tables::CSV_NAME].map(|name| out.join(name));
            for path in &paths {
                jostle_atomic_file::remove_abandoned(path);
            }
            return Ok(paths.map(|path| path.display().to_string()).into());
        }
    }
    Ok(vec![out.display().to_string()])
}

/// Writes the series of all runs into a folder, if the experiment has them; returns the path.
async fn write_series(
    client: &Client,
    name: &str,
    out: &Path,
    rows: &[ResultRow],
) -> Result<Option<String>, Failure> {
    if !out.is_dir() {
        return Ok(None);
    }
    let Some(all) = series::fetch_all(client, name, rows).await? else {
        return Ok(None);
    };
    let path = out.join(SERIES_NAME);
    jostle_atomic_file::remove_abandoned(&path);
    let names = all.first().into_iter().flat_map(|it| &it.measures);
    let names = names.map(|measure| measure.name.clone());
    let mut writer = SeriesWriter::begin(&path, names).map_err(Failure::results)?;
    for series in &all {
        writer.append(series).map_err(Failure::results)?;
        // An interruption ends it here, and the temporary file is removed.
        tokio::task::yield_now().await;
    }
    writer.finish().map_err(Failure::results)?;
    Ok(Some(path.display().to_string()))
}

/// Describes how many runs ended by a fault.
fn faults(count: u64) -> String {
    let runs = format::count(count, "run");
    format!("{runs} ended by a fault, counted up to it: --csv has the reasons")
}

/// Joins texts as `a, b and c`.
fn listed(texts: &[String]) -> String {
    match texts {
        [first @ .., last] if !first.is_empty() => format!("{} and {last}", first.join(", ")),
        _ => texts.join(""),
    }
}
