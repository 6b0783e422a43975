//! `results`: what came of an experiment so far, as tables.

use std::fs;
use std::path::Path;

use jostle_proto::OrderPage;
use jostle_results::statistics::{Spread, Summary, summarise};
use jostle_results::{ResultRow, table as tables};
use serde::Deserialize;
use serde_json::json;

use crate::arguments::ResultsArguments;
use crate::bus::Bus;
use crate::failure::Failure;
use crate::format;
use crate::output::{self, Output};
use crate::table;

/// How many rows are asked for at a time; a daemon answers with what fits a message.
const ROWS: usize = 1000;

/// Rows of finished runs, in the words of the tables.
#[derive(Deserialize)]
struct Page {
    rows: Vec<ResultRow>,
    next: Option<u64>,
}

/// Shows or writes the results of an experiment.
///
/// # Errors
///
/// Why there are none, or where they cannot be written.
pub async fn results(
    bus: &Bus,
    output: Output,
    arguments: &ResultsArguments,
) -> Result<(), Failure> {
    let ResultsArguments {
        name,
        out,
        csv,
        order,
    } = arguments;
    if let Some(run) = order {
        return print_order(bus, output, name, run).await;
    }
    let rows = fetch(bus, name).await?;
    if let Some(out) = out {
        let written = write(out, &rows)?;
        if output.json {
            let document = json!({"experiment": name, "runs": rows.len(), "written": written});
            return output.data(&document.to_string());
        }
        let runs = format::count(rows.len() as u64, "run");
        return output.data(&format!("wrote {runs} to {}", written.join(" and ")));
    }
    if output.json {
        return output.data(&serde_json::to_string(&rows).map_err(Failure::defect)?);
    }
    if *csv {
        return output::write(&tables::csv(&rows));
    }
    if rows.is_empty() {
        output.note(&format!("no run of {name} is finished so far"));
        return Ok(());
    }
    output.data(&summary(&summarise(&rows)))
}

/// Every row there is, in the order of the plan.
async fn fetch(bus: &Bus, name: &str) -> Result<Vec<ResultRow>, Failure> {
    let (mut rows, mut after) = (Vec::new(), 0);
    loop {
        let noun = format!("results?after={after};limit={ROWS}");
        let page: Page = bus.get_experiment(name, &noun).await?.read()?;
        rows.extend(page.rows);
        match page.next {
            Some(next) if next > after => after = next,
            _ => return Ok(rows),
        }
    }
}

/// Prints the order of one run over time.
async fn print_order(bus: &Bus, output: Output, name: &str, run: &str) -> Result<(), Failure> {
    if run.contains(';') {
        return Err(Failure::Argument {
            argument: "--order".into(),
            problem: format!("{run:?} is no name of a run"),
        });
    }
    let mut series: Option<OrderPage> = None;
    let mut after = Some(0);
    while let Some(number) = after {
        let noun = format!("order?run={run};after={number}");
        let page: OrderPage = bus.get_experiment(name, &noun).await?.read()?;
        after = page.next;
        match &mut series {
            None => series = Some(page),
            Some(series) => {
                series.time.extend(page.time);
                series.order.extend(page.order);
                series.drift.extend(page.drift);
                series.next = None;
            }
        }
    }
    let Some(series) = series else {
        return Err(Failure::defect("nothing was asked"));
    };
    if output.json {
        return output.data(&serde_json::to_string(&series).map_err(Failure::defect)?);
    }
    let mut text = String::from("time,order,drift\n");
    for (index, (time, order)) in series.time.iter().zip(&series.order).enumerate() {
        let drift = series.drift.get(index).map(f64::to_string);
        text.push_str(&format!("{time},{order},{}\n", drift.unwrap_or_default()));
    }
    output::write(&text)
}

/// Writes both tables into a folder, or one to a file; what was written.
fn write(out: &Path, rows: &[ResultRow]) -> Result<Vec<String>, Failure> {
    let wrong = |error: tables::TableError| Failure::Results(error.to_string());
    match out.extension().and_then(|extension| extension.to_str()) {
        Some("csv") => tables::write_csv(out, rows).map_err(wrong)?,
        Some("parquet") => tables::write_parquet(out, rows).map_err(wrong)?,
        _ => {
            fs::create_dir_all(out).map_err(|error| Failure::File {
                path: out.display().to_string(),
                error,
            })?;
            tables::write(out, rows).map_err(wrong)?;
            let names = [tables::PARQUET_NAME, tables::CSV_NAME];
            return Ok(names
                .map(|name| out.join(name).display().to_string())
                .into());
        }
    }
    Ok(vec![out.display().to_string()])
}

/// A line for each condition.
fn summary(summaries: &[Summary]) -> String {
    let spread = |spread: &Spread| match spread.error {
        Some(error) => format!("{:.4} ± {error:.4}", spread.mean),
        None => format!("{:.4}", spread.mean),
    };
    let rows = summaries.iter().map(|summary| {
        let condition = &summary.condition;
        [
            condition.contacts.clone(),
            format::number(condition.pi1),
            condition.n.to_string(),
            condition.informed.to_string(),
            format::number(condition.pi2),
            summary.runs.to_string(),
            spread(&summary.v),
            summary
                .v_pd
                .as_ref()
                .map_or_else(|| format::NONE.into(), spread),
            format!("{:.4}", summary.crossed_share),
        ]
    });
    let header = [
        "contacts", "pi1", "n", "informed", "pi2", "runs", "v", "v_pd", "crossed",
    ];
    table::table(header, rows.collect())
}
