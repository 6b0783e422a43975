//! The measures of an experiment's runs over time.

use jostle_client::Client;
use jostle_proto::{ErrorCode, SeriesPage};
use jostle_results::ResultRow;
use jostle_results::table::{MeasureSeries, Series, series};

use crate::arguments::ResultsArguments;
use crate::bound::{self, Bound};
use crate::context::Context;
use crate::failure::Failure;
use crate::output;
use crate::verbs::experiment::over_time::Pages;
use crate::verbs::experiment::rows;
use serde_json::json;

/// Prints the measures of a run over time, or those of all finished runs.
pub async fn print(
    context: &Context,
    arguments: &ResultsArguments,
    run: Option<&str>,
) -> Result<(), Failure> {
    let Context { client, output } = context;
    let name = &arguments.name;
    let mut bound = Bound::new(bound::most(output.json, arguments.limit, arguments.all));
    let runs = match run {
        Some(run) => {
            check_run("--series", run)?;
            vec![run.to_owned()]
        }
        None => {
            let rows = rows::fetch(client, name).await?.rows;
            rows.into_iter().map(|row| row.run).collect()
        }
    };
    let mut all = Vec::new();
    for run in &runs {
        let is_counted_only = bound.rest == 0;
        let series = fetch(client, name, run, &mut bound).await?;
        if !is_counted_only {
            all.push(series);
        }
    }
    if output.json {
        let documents: Vec<_> = all.iter().map(document).collect();
        let left_out = bound.left_out;
        let document = json!({"experiment": name, "series": documents, "left_out": left_out});
        return output.document(&document);
    }
    if runs.is_empty() {
        output.note(&format!("no run of {name} is finished so far"));
        return Ok(());
    }
    output::write(&series::csv(&all))?;
    if bound.left_out > 0 {
        output.note(&bound::note(bound.left_out, "row"));
    }
    Ok(())
}

/// Checks the name of a run, which is a parameter of a query.
pub fn check_run(argument: &str, run: &str) -> Result<(), Failure> {
    match run.contains(';') {
        true => Err(Failure::argument(
            argument,
            format!("invalid name of a run {run:?}: `--csv` lists the names"),
        )),
        false => Ok(()),
    }
}

/// Returns the series of the runs of `rows`; none if the experiment has no `series_every`, or the
/// daemon is of a version without it.
pub async fn fetch_all(
    client: &Client,
    name: &str,
    rows: &[ResultRow],
) -> Result<Option<Vec<Series>>, Failure> {
    let mut all = Vec::with_capacity(rows.len());
    for row in rows {
        let mut bound = Bound::new(usize::MAX);
        match fetch(client, name, &row.run, &mut bound).await {
            Ok(series) => all.push(series),
            // An earlier version does not know the query.
            Err(error) if all.is_empty() && is_absent(&error) => return Ok(None),
            Err(error) => return Err(error),
        }
    }
    Ok((!all.is_empty()).then_some(all))
}

fn is_absent(failure: &Failure) -> bool {
    let code = failure.rejection().map(|error| error.code);
    matches!(code, Some(ErrorCode::InvalidArgument | ErrorCode::NotFound))
}

async fn fetch(
    client: &Client,
    name: &str,
    run: &str,
    bound: &mut Bound,
) -> Result<Series, Failure> {
    let mut series = Series {
        run: run.to_owned(),
        ..Series::default()
    };
    let mut pages = Pages::new(client, name, ("series", run, ""));
    while let Some(page) = pages.next(bound).await? {
        append(&mut series, page);
    }
    Ok(series)
}

fn append(series: &mut Series, page: SeriesPage) {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a step is a whole number"
    )]
    series
        .steps
        .extend(page.step.iter().map(|step| *step as u64));
    series.times.extend(page.time);
    if series.measures.is_empty() {
        let names = page.measures.iter().map(|measure| measure.name.clone());
        series.measures = names
            .map(|name| MeasureSeries {
                name,
                values: Vec::new(),
            })
            .collect();
    }
    for (measure, page) in series.measures.iter_mut().zip(page.measures) {
        let values = page.value.into_iter();
        measure
            .values
            .extend(values.map(|it| (!it.is_nan()).then_some(it)));
    }
}

/// Returns the series as JSON.
fn document(series: &Series) -> serde_json::Value {
    let measures = series.measures.iter();
    let measures: serde_json::Map<_, _> = measures
        .map(|measure| (measure.name.clone(), measure.values.clone().into()))
        .collect();
    json!({
        "run": series.run,
        "step": series.steps,
        "time": series.times,
        "measures": measures,
    })
}
