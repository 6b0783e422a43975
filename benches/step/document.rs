//! Renews what is measured in `docs/performance.md`; the prose around it is written by hand.

use super::table::{self, Row};

/// Puts the tables between their marks.
pub fn with_tables(page: &str, rows: &[Row]) -> String {
    let page = between(page, "table", &table::markdown(rows));
    between(&page, "errors", &table::errors_markdown(rows))
}

/// Replaces what stands between `<!-- name -->` and `<!-- /name -->`.
fn between(page: &str, name: &str, text: &str) -> String {
    let (open, close) = (format!("<!-- {name} -->"), format!("<!-- /{name} -->"));
    let (before, rest) = page.split_once(&open).expect("the page has the mark");
    let (_, after) = rest.split_once(&close).expect("the mark is closed");
    format!("{before}{open}\n{text}\n{close}{after}")
}
