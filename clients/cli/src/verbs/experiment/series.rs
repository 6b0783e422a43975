//! The measures of an experiment's runs over time.

use jostle_client::Client;
use jostle_proto::{ErrorCode, SeriesPage};
use jostle_results::ResultRow;
use jostle_results::table::{MeasureSeries, Series, series};

use crate::context::Context;
use crate::failure::Failure;
use crate::output;
use crate::verbs::experiment::rows;

/// Prints the measures of a run over time, or those of all finished runs.
pub async fn print(context: &Context, name: &str, run: Option<&str>) -> Result<(), Failure> {
    let Context { client, output } = context;
    let all = match run {
        Some(run) => {
            check_run("--series", run)?;
            vec![fetch(client, name, run).await?]
        }
        None => {
            let rows = rows::fetch(client, name).await?;
            let mut all = Vec::with_capacity(rows.len());
            for row in &rows {
                all.push(fetch(client, name, &row.run).await?);
            }
            all
        }
    };
    if output.json {
        let documents: Vec<_> = all.iter().map(document).collect();
        return output.document(&documents);
    }
    if all.is_empty() {
        output.note(&format!("no run of {name} is finished so far"));
        return Ok(());
    }
    output::write(&series::csv(&all))
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
        match fetch(client, name, &row.run).await {
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

async fn fetch(client: &Client, name: &str, run: &str) -> Result<Series, Failure> {
    let mut series = Series {
        run: run.to_owned(),
        ..Series::default()
    };
    let mut after = Some(0);
    while let Some(number) = after {
        let noun = format!("series?run={run};after={number}");
        let page: SeriesPage = client.get_experiment(name, &noun).await?.read()?;
        after = page.next.filter(|next| *next > number);
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
    serde_json::json!({
        "run": series.run,
        "step": series.steps,
        "time": series.times,
        "measures": measures,
    })
}
