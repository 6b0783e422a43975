//! The table in `docs/guarantees.md` equals the table of swarms.

use super::{Table, text_of};

/// The rows of the table on the page, without its head.
fn rows() -> Vec<Vec<&'static str>> {
    let heading = "\n## What starts over and what goes on\n\n";
    let (_, below) = text_of("docs/guarantees.md").split_once(heading).unwrap();
    let lines = below.lines().take_while(|line| line.starts_with('|'));
    let cells = |line: &'static str| line.trim_matches('|').split('|').map(str::trim).collect();
    lines.skip(2).map(cells).collect()
}

/// The wording of a cell on the page.
fn in_words(cell: &'static str) -> &'static str {
    match cell {
        "as made" => "as created",
        "absent" | "[]" | "[null,null,null]" => "none",
        "anew" => "begins anew",
        "starts over" => "from the beginning",
        "\"no reply\"" => "no reply",
        cell if cell.starts_with("n/a ") => "-",
        cell if cell.starts_with("refused ") => "refused",
        cell if cell.starts_with("still ") => "unchanged",
        cell => cell,
    }
}

#[test]
fn the_page_equals_the_table() {
    let table = Table::of("swarms");
    let columns = [
        &["reset"][..],
        &["fork: copy", "restore"],
        &["stop, start", "kill, start"],
    ];
    let rows = rows();
    assert!(rows.len() >= 20, "{rows:?}");
    for row in rows {
        let [name, cells @ ..] = &row[..] else {
            panic!("{row:?}");
        };
        assert_eq!(cells.len(), columns.len(), "{name}");
        for (changes, cell) in columns.iter().zip(cells) {
            for change in *changes {
                assert_eq!(
                    *cell,
                    in_words(table.column(change)[name]),
                    "{name}, {change}"
                );
            }
        }
    }
}
