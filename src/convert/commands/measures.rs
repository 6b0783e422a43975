//! `get/measures`: the measures or the histogram that a request names.

use jostle_convert::measures::{self, MAX_MEASURES, MeasuresError};
use jostle_measures::Measure;
use jostle_proto::contract::selectors;

use crate::convert::commands::{CommandError, selector};

/// The bins and the largest distance of a histogram without `bins` and `max`.
const DEFAULT_BINS: usize = 50;
const DEFAULT_MAX: f64 = 10.0;

/// Maximum number of bins of one axis: a reply has at most 40,000 numbers of a kind.
const MAX_RADIAL_BINS: usize = 10_000;
const MAX_SQUARE_BINS: usize = 200;

/// The longest distance, in body sizes.
const MAX_DISTANCE: f64 = 1e6;

/// What a request names.
#[derive(Clone, Debug, PartialEq)]
pub enum Requested {
    /// These measures; all of one state if `None`.
    Measures(Option<Vec<Measure>>),
    /// A histogram.
    Histogram {
        /// Its kind.
        kind: HistogramKind,
        /// The number of bins of an axis.
        bins: usize,
        /// The largest distance, in body sizes.
        max: f64,
    },
}

/// A histogram of `jostle_measures`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HistogramKind {
    /// By distance.
    PairCorrelation,
    /// By place around a body.
    NeighbourDensity,
}

impl HistogramKind {
    /// Its name on the wire.
    pub fn name(self) -> &'static str {
        match self {
            HistogramKind::PairCorrelation => "pair_correlation",
            HistogramKind::NeighbourDensity => "neighbour_density",
        }
    }
}

/// Parses the parameters of a selector.
pub fn read<'a>(
    parameters: impl Iterator<Item = (&'a str, &'a str)>,
) -> Result<Requested, CommandError> {
    let given = selector(parameters, selectors::MEASURES)?;
    let value = |name: &str| given.iter().find(|it| it.0 == name).map(|it| it.1);
    let Some(histogram) = value("histogram") else {
        if let Some((field, _)) = given.iter().find(|it| it.0 != "names") {
            let problem = "is of a histogram: give histogram=pair_correlation or neighbour_density";
            return Err(CommandError::field(field, problem));
        }
        return Ok(Requested::Measures(value("names").map(parse).transpose()?));
    };
    if value("names").is_some() {
        let problem = "and histogram are alternatives: request them one after the other";
        return Err(CommandError::field("names", problem));
    }
    let (kind, max_bins) = match histogram {
        "pair_correlation" => (HistogramKind::PairCorrelation, MAX_RADIAL_BINS),
        "neighbour_density" => (HistogramKind::NeighbourDensity, MAX_SQUARE_BINS),
        _ => {
            let problem = "is unknown: there are pair_correlation and neighbour_density";
            return Err(CommandError::field("histogram", problem));
        }
    };
    let bins = value("bins").map_or(Some(DEFAULT_BINS), |it| it.parse().ok());
    let Some(bins) = bins.filter(|bins| (1..=max_bins).contains(bins)) else {
        let problem = "must be a whole number from 1 to 10000, or to 200 of neighbour_density";
        return Err(CommandError::field("bins", problem));
    };
    let max = value("max").map_or(Some(DEFAULT_MAX), |it| it.parse().ok());
    let Some(max) = max.filter(|max| *max > 0.0 && *max <= MAX_DISTANCE) else {
        let problem = "must be a distance above 0 and at most 1e6 body sizes";
        return Err(CommandError::field("max", problem));
    };
    Ok(Requested::Histogram { kind, bins, max })
}

fn parse(names: &str) -> Result<Vec<Measure>, MeasuresError> {
    measures::parse(names.split(','), MAX_MEASURES)
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
        assert_eq!(
            read([("_any", "1")].into_iter()).unwrap(),
            Requested::Measures(None)
        );
    }

    #[test]
    fn a_histogram_has_bins_and_a_largest_distance() {
        let of = |text: &'static str| read(text.split(';').map(|it| it.split_once('=').unwrap()));
        let of_kind = |kind, bins, max| Requested::Histogram { kind, bins, max };
        for (text, expected) in [
            (
                "histogram=pair_correlation",
                of_kind(HistogramKind::PairCorrelation, 50, 10.0),
            ),
            (
                "histogram=neighbour_density;max=2.5;bins=200",
                of_kind(HistogramKind::NeighbourDensity, 200, 2.5),
            ),
            (
                "bins=10000;histogram=pair_correlation;max=1e6",
                of_kind(HistogramKind::PairCorrelation, 10_000, 1e6),
            ),
        ] {
            assert_eq!(of(text).unwrap(), expected);
        }
        for (text, part) in [
            ("bins=5", "bins is of a histogram"),
            ("max=5", "max is of a histogram"),
            (
                "histogram=rdf",
                "there are pair_correlation and neighbour_density",
            ),
            ("histogram=pair_correlation;names=order", "are alternatives"),
            ("histogram=pair_correlation;bins=0", "from 1 to 10000"),
            ("histogram=pair_correlation;bins=10001", "from 1 to 10000"),
            ("histogram=pair_correlation;bins=1.5", "from 1 to 10000"),
            ("histogram=neighbour_density;bins=201", "to 200"),
            ("histogram=pair_correlation;max=0", "above 0"),
            ("histogram=pair_correlation;max=NaN", "above 0"),
            ("histogram=pair_correlation;max=inf", "above 0"),
            ("histogram=pair_correlation;max=1e9", "at most 1e6"),
        ] {
            let error = of(text).unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
    }

    #[test]
    fn errors_name_the_remedy() {
        for (names, part) in [
            ("order,ordr", "did you mean `order`?"),
            ("", "there are order, "),
            ("order,", "there are order, "),
            ("msd(5)", "`msd(5)` needs the states of earlier steps"),
            ("turning_rate", "leave it out, use it in a condition, or"),
            ("speed.others", "leave it out, use it in a condition, or"),
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
