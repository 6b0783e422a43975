//! Tables that fit a width: long names and reasons are elided, and columns of less use left out.

use crate::stdout;
use crate::table;

/// What a column gives up for the width of a table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Room {
    /// Nothing.
    Keep,
    /// The middle of its longest cells.
    Elide,
    /// All of it, the columns of the lowest number first.
    Drop(u8),
}

/// The name of a column, its cell in a row, and what it gives up.
pub type Column<T> = (&'static str, fn(&T) -> String, Room);

/// A column with its cells.
type Cells = (&'static str, Vec<String>, Room);

/// The least width of an elided cell, first and once no column is left to leave out.
const ELIDED: [usize; 2] = [20, 8];
/// The blanks between columns.
const BETWEEN: usize = 2;

/// The width of the terminal; none if standard output is none.
pub fn terminal_width() -> Option<usize> {
    stdout::is_terminal().then(|| usize::from(console::Term::stdout().size().1))
}

/// A table with a line for each of `rows`, as wide as `width` at most if that is given.
pub fn of<T, const COLUMNS: usize>(
    rows: &[T],
    columns: [Column<T>; COLUMNS],
    width: Option<usize>,
) -> String {
    let mut columns: Vec<Cells> = columns
        .map(|(name, cell, room)| (name, rows.iter().map(cell).collect(), room))
        .into();
    if let Some(width) = width {
        fit(&mut columns, width);
    }
    let columns = columns.into_iter().map(|(name, cells, _)| (name, cells));
    table::columns(&columns.collect::<Vec<_>>())
}

fn fit(columns: &mut Vec<Cells>, width: usize) {
    let [roomy, least] = ELIDED;
    elide(columns, width, roomy);
    while excess(columns, width) > 0 {
        let places = columns.iter().enumerate();
        let places = places.filter_map(|(index, (_, _, room))| match room {
            Room::Drop(place) => Some((*place, index)),
            Room::Keep | Room::Elide => None,
        });
        let Some((_, index)) = places.min() else {
            break;
        };
        columns.remove(index);
    }
    elide(columns, width, least);
}

/// The width of a column.
fn wide((name, cells, _): &Cells) -> usize {
    let cells = cells.iter().map(|cell| console::measure_text_width(cell));
    cells.max().unwrap_or(0).max(name.len())
}

/// By how much the table is too wide.
fn excess(columns: &[Cells], width: usize) -> usize {
    let whole: usize = columns.iter().map(|it| wide(it) + BETWEEN).sum();
    whole.saturating_sub(width + BETWEEN)
}

/// Elides the longest cells, the widest column first, to `least` at the narrowest.
fn elide(columns: &mut [Cells], width: usize, least: usize) {
    loop {
        let excess = excess(columns, width);
        let elidable = columns.iter_mut().filter(|it| it.2 == Room::Elide);
        let Some(widest) = elidable.max_by_key(|it| wide(it)) else {
            return;
        };
        let now = wide(widest);
        let least = least.max(widest.0.len());
        if excess == 0 || now <= least {
            return;
        }
        let to = now.saturating_sub(excess).max(least);
        for cell in &mut widest.1 {
            *cell = elided(cell, to);
        }
    }
}

/// A text without its middle: names often differ at their end.
fn elided(text: &str, width: usize) -> String {
    if console::measure_text_width(text) <= width {
        return text.to_owned();
    }
    let characters: Vec<char> = text.chars().collect();
    let end = width.saturating_sub(1) / 3;
    let start = width.saturating_sub(1 + end);
    let tail = characters.len().saturating_sub(end);
    let (start, tail) = (&characters[..start.min(tail)], &characters[tail..]);
    start.iter().chain(&['…']).chain(tail).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    type Row = (&'static str, &'static str, u64);

    const ROWS: [Row; 2] = [
        ("demo", "-", 12),
        (
            "a-school-with-a-name-that-is-as-long-as-names-may-be-00000000017",
            "step 12 was not solved: the residual is 3e-4, the limit 1e-6",
            123_456,
        ),
    ];

    fn table(width: Option<usize>) -> String {
        let columns: [Column<Row>; 5] = [
            ("swarm", |it| it.0.into(), Room::Elide),
            ("reason", |it| it.1.into(), Room::Elide),
            ("step", |it| it.2.to_string(), Room::Keep),
            ("time", |it| it.2.to_string(), Room::Drop(1)),
            ("order", |it| it.2.to_string(), Room::Drop(2)),
        ];
        of(&ROWS, columns, width)
    }

    #[test]
    fn a_line_is_never_wider_than_the_width_while_there_is_something_to_give_up() {
        for width in 26..150 {
            let table = table(Some(width));
            assert_eq!(table.lines().count(), 3, "{table}");
            for line in table.lines() {
                assert!(
                    console::measure_text_width(line) <= width,
                    "{width}:\n{table}"
                );
            }
            assert!(table.contains("step") && table.contains('…'), "{table}");
        }
    }

    #[test]
    fn names_and_reasons_are_elided_before_columns_are_left_out() {
        let names = |width| {
            let table = table(Some(width));
            let header = table.lines().next().unwrap_or_default().split_whitespace();
            header.map(str::to_owned).collect::<Vec<_>>()
        };
        assert_eq!(names(80), ["swarm", "reason", "step", "time", "order"]);
        assert_eq!(names(60), ["swarm", "reason", "step", "order"]);
        assert_eq!(names(30), ["swarm", "reason", "step"]);
        let narrow = table(Some(80));
        assert!(narrow.contains("017"), "the end of a name stays: {narrow}");
        let whole = table(None);
        assert!(whole.contains(ROWS[1].0) && whole.contains(ROWS[1].1));
        assert_eq!(table(Some(500)), whole);
    }
}
