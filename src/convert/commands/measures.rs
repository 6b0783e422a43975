//! `get/measures`: the measures that a request names.

use jostle_measures::Measure;

use crate::convert::commands::{CommandError, selector, truncate};
use crate::convert::error::measures::{MAX_MEASURES, MeasuresError};

/// Parses the names of measures from the parameters of a selector; `None` if none are given.
pub fn read<'a>(
    parameters: impl Iterator<Item = (&'a str, &'a str)>,
) -> Result<Option<Vec<Measure>>, CommandError> {
    match selector(parameters, &["names"])?.first() {
        Some((_, names)) => Ok(Some(parse(names)?)),
        None => Ok(None),
    }
}

fn parse(names: &str) -> Result<Vec<Measure>, MeasuresError> {
    let mut measures = Vec::new();
    for text in names.split(',') {
        let measure: Measure = truncate(text).parse().map_err(Box::new)?;
        if measure.definition().needs_past() {
            return Err(MeasuresError::NeedsPast(measure.to_string()));
        }
        if measures.contains(&measure) {
            return Err(MeasuresError::Twice(measure.to_string()));
        }
        measures.push(measure);
        if measures.len() > MAX_MEASURES {
            return Err(MeasuresError::TooMany);
        }
    }
    Ok(measures)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    fn error(names: &str) -> String {
        parse(names).unwrap_err().to_string()
    }

    #[test]
    fn names_are_separated_by_commas_and_keep_their_order() {
        let measures = parse("milling, clusters.count(0.1),clusters.count").unwrap();
        let names: Vec<String> = measures.iter().map(ToString::to_string).collect();
        assert_eq!(names, ["milling", "clusters.count(0.1)", "clusters.count"]);
        assert_eq!(read([("_any", "1")].into_iter()).unwrap(), None);
    }

    #[test]
    fn errors_name_the_remedy() {
        for (names, part) in [
            ("order,ordr", "did you mean `order`?"),
            ("", "there are order, "),
            ("order,", "there are order, "),
            ("msd(5)", "`msd(5)` needs the states of earlier steps"),
            ("turning_rate", "leave it out, or"),
            ("speed.others", "leave it out, or"),
            ("order, order", "`order` is named twice: name it once"),
            ("clusters.count,clusters.count(0.001)", "twice"),
            ("clusters.count(NaN)", "no finite number"),
            ("clusters.count(1e9)", "it must be 0 to 2 body sizes"),
        ] {
            assert!(error(names).contains(part), "{names}: {}", error(names));
        }
        let many: Vec<String> = (0..=MAX_MEASURES)
            .map(|k| format!("clusters.count({})", k as f64 / 100.0))
            .collect();
        assert!(error(&many.join(",")).contains("at most 64 measures"));
        assert!(parse(&many[1..].join(",")).is_ok());
        let long = "x".repeat(100_000);
        assert!(error(&long).len() < 1000);
        let twice = [("names", "order"), ("names", "order")];
        assert!(read(twice.into_iter()).is_err());
    }
}
