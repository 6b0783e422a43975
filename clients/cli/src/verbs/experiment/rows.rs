//! The rows of an experiment's results.

use jostle_client::Client;
use jostle_proto::{OccasionalColumns, Progress};
use jostle_results::ResultRow;
use jostle_results::table::occasional;
use serde::Deserialize;

use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::verbs::experiment::phase;

/// The most rows per query; a daemon returns as many as fit a message.
const ROWS: usize = 1000;

/// Rows of finished runs.
#[derive(Deserialize)]
struct Page {
    rows: Vec<ResultRow>,
    next: Option<u64>,
    columns: Option<OccasionalColumns>,
}

/// The table of results.
pub struct Table {
    /// The rows of the finished runs.
    pub rows: Vec<ResultRow>,
    /// The columns that only some experiments have; none of an earlier version, if there is no row.
    pub extra: Vec<String>,
}

/// Fetches the table, page by page.
pub async fn fetch(client: &Client, name: &str) -> Result<Table, Failure> {
    let (mut rows, mut after) = (Vec::new(), 0);
    loop {
        let noun = format!("results?after={after};limit={ROWS}");
        let page: Page = client.get_experiment(name, &noun).await?.read()?;
        rows.extend(page.rows);
        match page.next {
            Some(next) if next > after => after = next,
            _ => {
                let extra = occasional(&page.columns.unwrap_or_default());
                return Ok(Table { rows, extra });
            }
        }
    }
}

/// Says that the results lack runs, if `count` is not their number; returns what it says.
pub async fn note_missing(
    context: &Context,
    name: &str,
    count: usize,
) -> Result<Option<String>, Failure> {
    let Context { client, output } = context;
    let progress: Progress = client.get_experiment(name, "progress").await?.read()?;
    if count as u64 >= progress.runs {
        return Ok(None);
    }
    let (runs, phase) = (format::count(progress.runs, "run"), phase(progress.phase));
    let others = match progress.finished == progress.runs {
        true => {
            "; the others ended by a fault at step 0 and have no results, so that conditions may be \
             missing"
        }
        false => "",
    };
    let text = format!("{count} of {runs}: {name} is {phase}{others}");
    output.note(&text);
    Ok(Some(text))
}
