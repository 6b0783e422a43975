//! The page about the measures has a row for each, as the registry describes it.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use jostle_measures::definitions;

#[test]
fn the_page_has_the_row_of_each_measure() {
    let mut table = String::new();
    for it in definitions() {
        let argument = it.argument.map_or(String::new(), |argument| {
            let default = argument.default.map(|value| format!(" = {value}"));
            format!("({}{})", argument.name, default.unwrap_or_default())
        });
        let (name, unit, formula) = (it.name, it.unit, it.formula.replace('|', "\\|"));
        let (range, cost, source) = (it.range, it.cost, it.source);
        writeln!(
            table,
            "| `{name}{argument}` | {unit} | {formula} | {range} | {cost} | {source} |"
        )
        .expect("a string");
    }
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/measures.md");
    let page = fs::read_to_string(page).expect("the page");
    for row in table.lines() {
        assert!(
            page.lines().any(|line| line == row),
            "no row:\n{row}\n\nAll of them:\n{table}"
        );
    }
    let rows = page.lines().filter(|line| line.starts_with("| `")).count();
    assert_eq!(rows, table.lines().count(), "rows of no measure");
}
