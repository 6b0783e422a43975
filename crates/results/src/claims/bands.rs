//! Bands for the means of quick runs: the mean of many runs, plus and minus a statistical error.

use std::io::Write as _;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::contact_statistics::ContactStatistics;
use crate::table::TableError;
use crate::{Measure, ResultRow};

/// The half-width of a band in standard errors of the difference between few and many runs. With a
/// hundred bands, one of them is left by chance in one of about a hundred and fifty tries.
const ERRORS: f64 = 4.0;

/// The tolerance for rounding in values that are otherwise zero, such as the overlap of discs.
const ROUNDING: f64 = 1e-6;

/// A measured quantity: a value of each run, or of each run's contacts.
enum Quantity {
    OfRun(Measure),
    OfContacts(fn(&ContactStatistics) -> f64),
}

const QUANTITIES: [(&str, Quantity); 8] = [
    ("v", Quantity::OfRun(Measure::V)),
    ("ordered_time", Quantity::OfRun(Measure::ORDERED_TIME)),
    ("worst_overlap", Quantity::OfRun(Measure::WORST_OVERLAP)),
    ("crossed_share", Quantity::OfRun(Measure::CROSSED_SHARE)),
    ("listed", Quantity::OfContacts(|it| it.listed)),
    ("pushing", Quantity::OfContacts(|it| it.pushing)),
    ("turned", Quantity::OfContacts(|it| it.turned)),
    ("beside", Quantity::OfContacts(|it| it.beside)),
];

/// The interval that should contain the mean of a quantity over the runs of one condition.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Band {
    /// A column of the results or of the measurements of contacts.
    pub quantity: String,
    /// Length over width of a body.
    pub pi1: f64,
    /// Number of individuals.
    pub n: u64,
    /// The smallest mean inside the band.
    pub low: f64,
    /// The largest mean inside the band.
    pub high: f64,
}

/// A band and the measured mean.
#[derive(Clone, Debug, PartialEq)]
pub struct BandResult {
    /// The band.
    pub band: Band,
    /// The measured mean; none without runs of the condition.
    pub mean: Option<f64>,
}

impl BandResult {
    /// Returns whether the mean is inside the band.
    #[must_use]
    pub fn is_inside(&self) -> bool {
        let Band { low, high, .. } = self.band;
        self.mean.is_some_and(|mean| (low..=high).contains(&mean))
    }
}

/// Measures the mean of each band's quantity.
#[must_use]
pub fn judge(
    bands: &[Band],
    runs: &[ResultRow],
    contact_rows: &[ContactStatistics],
) -> Vec<BandResult> {
    let judged = bands.iter().map(|band| {
        let values = values(&band.quantity, band.pi1, band.n, runs, contact_rows);
        BandResult {
            band: band.clone(),
            mean: mean_and_variance(&values).map(|(mean, _)| mean),
        }
    });
    judged.collect()
}

/// Computes the bands for the means of `count` runs of a condition from many `runs` and `contact_rows`.
#[must_use]
pub fn make(runs: &[ResultRow], contact_rows: &[ContactStatistics], count: usize) -> Vec<Band> {
    let mut conditions: Vec<(f64, u64)> = runs.iter().map(|run| (run.pi1, run.n)).collect();
    conditions.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    conditions.dedup();
    let mut bands = Vec::new();
    for (pi1, n) in conditions {
        for (quantity, _) in &QUANTITIES {
            let values = values(quantity, pi1, n, runs, contact_rows);
            if let Some((mean, variance)) = mean_and_variance(&values) {
                let shares = 1.0 / values.len() as f64 + 1.0 / count as f64;
                let width = ERRORS * (variance * shares).sqrt() + ROUNDING;
                bands.push(Band {
                    quantity: (*quantity).to_owned(),
                    pi1,
                    n,
                    low: mean - width,
                    high: mean + width,
                });
            }
        }
    }
    bands
}

/// Reads bands as CSV.
///
/// # Errors
///
/// [`TableError::Malformed`], also if the file has no bands.
pub fn read(path: &Path) -> Result<Vec<Band>, TableError> {
    let explain = |reason: String| TableError::Malformed {
        path: path.to_owned(),
        reason,
    };
    let mut reader = csv::Reader::from_path(path).map_err(|error| explain(error.to_string()))?;
    let bands: Result<Vec<Band>, csv::Error> = reader.deserialize().collect();
    let bands = bands.map_err(|error| explain(error.to_string()))?;
    let is_known = |band: &Band| QUANTITIES.iter().any(|(name, _)| *name == band.quantity);
    if let Some(band) = bands.iter().find(|band| !is_known(band)) {
        return Err(explain(format!("no quantity is called {}", band.quantity)));
    }
    if bands.is_empty() {
        return Err(explain("it has no bands".to_owned()));
    }
    Ok(bands)
}

/// Writes bands as CSV.
///
/// # Errors
///
/// [`TableError::Io`].
pub fn write(path: &Path, bands: &[Band]) -> Result<(), TableError> {
    let io = |source| TableError::Io {
        path: path.to_owned(),
        source,
    };
    let mut file = jostle_atomic_file::begin(path).map_err(io)?;
    writeln!(file, "quantity,pi1,n,low,high").map_err(io)?;
    for band in bands {
        let Band {
            quantity,
            pi1,
            n,
            low,
            high,
        } = band;
        writeln!(file, "{quantity},{pi1},{n},{low:.7},{high:.7}").map_err(io)?;
    }
    jostle_atomic_file::publish(file, path).map_err(io)
}

fn values(
    quantity: &str,
    pi1: f64,
    n: u64,
    runs: &[ResultRow],
    contact_rows: &[ContactStatistics],
) -> Vec<f64> {
    let of = QUANTITIES.iter().find(|(name, _)| *name == quantity);
    match of.map(|(_, of)| of) {
        Some(Quantity::OfRun(measure)) => {
            let runs = runs.iter().filter(|run| run.pi1 == pi1 && run.n == n);
            runs.map(|run| run.number(*measure)).collect()
        }
        Some(Quantity::OfContacts(of)) => {
            let contact_rows = contact_rows.iter().filter(|it| it.pi1 == pi1 && it.n == n);
            contact_rows.map(of).collect()
        }
        None => Vec::new(),
    }
}

fn mean_and_variance(values: &[f64]) -> Option<(f64, f64)> {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|it| (it - mean) * (it - mean)).sum();
    (!values.is_empty()).then(|| (mean, squares / f64::max(count - 1.0, 1.0)))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::samples::{sample, with};

    fn with_v(v: f64) -> ResultRow {
        with(sample(), Measure::V, v)
    }

    #[test]
    fn a_band_is_four_standard_errors_wide_each_way() {
        let many: Vec<ResultRow> = [0.4, 0.6].repeat(50).into_iter().map(with_v).collect();
        let bands = make(&many, &[], 25);
        let band = bands.iter().find(|it| it.quantity == "v").unwrap();
        // The variance is 0.01 · 100 / 99; that of the difference is 1/100 + 1/25 of it.
        let width = 4.0 * (0.01 * 100.0 / 99.0 * 0.05f64).sqrt();
        assert!((band.low - (0.5 - width)).abs() < 1.1e-6);
        assert!((band.high - (0.5 + width)).abs() < 1.1e-6);
        let inside = |v: f64| judge(std::slice::from_ref(band), &[with_v(v)], &[])[0].is_inside();
        assert!(inside(0.5) && !inside(0.6) && !inside(0.4));
        let elsewhere = ResultRow {
            n: 3,
            ..with_v(0.5)
        };
        assert!(
            !judge(&bands, &[elsewhere], &[])[0].is_inside(),
            "no such runs"
        );
    }

    #[test]
    fn a_contact_band_uses_only_runs_of_its_condition() {
        let n = sample().n;
        let touch = |pi1: f64, n: u64, pushing: f64| ContactStatistics {
            pi1,
            n,
            pushing,
            ..ContactStatistics::default()
        };
        let pi1 = sample().pi1;
        let contact_rows = [
            touch(pi1, n, 0.5),
            touch(pi1, n + 1, 7.0),
            touch(pi1 + 1.0, n, 9.0),
        ];
        let bands = make(&[sample()], &contact_rows, 4);
        let band = bands.iter().find(|it| it.quantity == "pushing").unwrap();
        assert!((band.low - 0.5).abs() < 1.1e-6 && (band.high - 0.5).abs() < 1.1e-6);
    }

    #[test]
    fn bands_round_trip_and_invalid_files_are_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bands.csv");
        let bands = make(&[with_v(0.5), with_v(0.75)], &[], 4);
        write(&path, &bands).unwrap();
        let read_back = read(&path).unwrap();
        assert_eq!(read_back.len(), bands.len());
        assert!((read_back[0].low - bands[0].low).abs() < 1e-6);
        for text in [
            "quantity,pi1,n,low,high\n",
            "quantity,pi1,n,low,high\nw,4,3,0,1\n",
            "a\n1\n",
        ] {
            std::fs::write(&path, text).unwrap();
            assert!(read(&path).is_err(), "{text}");
        }
    }
}
