//! The rows of an experiment's results.

use jostle_client::Client;
use jostle_results::ResultRow;
use serde::Deserialize;

use crate::failure::Failure;

/// The most rows per query; a daemon returns as many as fit a message.
const ROWS: usize = 1000;

/// Rows of finished runs.
#[derive(Deserialize)]
struct Page {
    rows: Vec<ResultRow>,
    next: Option<u64>,
}

/// Fetches the rows of the finished runs, page by page.
pub async fn fetch(client: &Client, name: &str) -> Result<Vec<ResultRow>, Failure> {
    let (mut rows, mut after) = (Vec::new(), 0);
    loop {
        let noun = format!("results?after={after};limit={ROWS}");
        let page: Page = client.get_experiment(name, &noun).await?.read()?;
        rows.extend(page.rows);
        match page.next {
            Some(next) if next > after => after = next,
            _ => return Ok(rows),
        }
    }
}
