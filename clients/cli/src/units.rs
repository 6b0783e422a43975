//! The units of the columns of results.

use jostle_measures::Measure;
use jostle_proto::{NO_UNIT, unit_of_column};

/// Returns the unit of a column, a chosen measure or a variable; `1` if it has none.
pub fn unit(column: &str) -> &'static str {
    unit_of_column(column).unwrap_or_else(|| match column.parse::<Measure>() {
        Ok(measure) => measure.definition().unit,
        Err(_) => NO_UNIT,
    })
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::collections::BTreeSet;

    use jostle_measures::definitions;
    use jostle_proto::{COLUMNS, LENGTH_UNIT, SPEED_UNIT, TIME_UNIT};

    use super::*;

    #[test]
    fn columns_and_measures_have_the_units_of_their_definitions() {
        for (column, expected) in [
            ("v", "v0"),
            ("dt", "s/v0"),
            ("time", "s/v0"),
            ("stopped_at", "s/v0"),
            ("worst_overlap", "body sizes"),
            ("pi3", "1"),
            ("order", "1"),
            ("drift", "v0"),
            ("turning_rate", "rad/(s/v0)"),
            ("msd(5)", "body sizes²"),
            ("share", "1"),
        ] {
            assert_eq!(unit(column), expected, "{column}");
        }
    }

    #[test]
    fn the_docs_have_these_units() {
        let page = include_str!("../../../docs/experiments.md");
        let (_, results) = page.split_once("## The results").unwrap();
        let mut found = BTreeSet::new();
        for row in results.lines().filter(|line| line.starts_with("| `")) {
            let cells: Vec<&str> = row.split('|').map(str::trim).collect();
            let columns = cells[1].split(", ").map(|name| name.trim_matches('`'));
            for column in columns.filter(|_| cells[2] != "as above") {
                let unit = Some(cells[2]).filter(|unit| !unit.is_empty());
                if let Some(expected) = unit_of_column(column) {
                    assert_eq!(unit.unwrap_or(NO_UNIT), expected, "{column}");
                    found.insert(column);
                }
            }
        }
        assert!(found.len() > 12, "{found:?}");
    }

    #[test]
    fn tables_and_measures_word_a_unit_alike() {
        let of_measures: BTreeSet<&str> = definitions().iter().map(|it| it.unit).collect();
        for unit in [LENGTH_UNIT, SPEED_UNIT, NO_UNIT] {
            assert!(of_measures.contains(unit), "{unit}: {of_measures:?}");
        }
        assert!(of_measures.contains(&*format!("rad/({TIME_UNIT})")));
        let of_columns: BTreeSet<&str> = COLUMNS.iter().map(|it| it.unit).collect();
        let all = BTreeSet::from([LENGTH_UNIT, SPEED_UNIT, TIME_UNIT, NO_UNIT]);
        assert_eq!(of_columns, all);
    }
}
