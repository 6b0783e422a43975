//! The list of finished runs, `runs.jsonl`: a header and a line for each run.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::ops::Range;
use std::path::{Component, Path};

use jostle_physics::model::MODEL_VERSION;
use jostle_results::ResultRow;
use jostle_results::contact_statistics::ContactStatistics;
use jostle_results::table::{MeasureSeries, OrderSeries, Series};
use serde::de::IgnoredAny;
use serde::{Deserialize, Deserializer, Serialize};

use super::error::{FolderError, io_error};
use crate::plan::Plan;

/// The name of the list in its folder.
pub const RUNS: &str = "runs.jsonl";

/// The folder in which earlier versions stored series.
pub const SERIES: &str = "order";

/// The first line of the list of finished runs.
#[derive(Deserialize, Serialize)]
pub struct Header {
    pub experiment: String,
    pub model_version: u32,
}

/// A finished run.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Record {
    pub run: String,
    /// Why the run ended early, if it did.
    pub fault: Option<String>,
    /// The row of the run; none if it ended before its first step.
    pub row: Option<ResultRow>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub touch: Option<ContactStatistics>,
    /// The files of the run beside the list: their paths in the folder, with `/`, and their lengths in
    /// bytes. Earlier versions did not store them.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub files: BTreeMap<String, u64>,
    /// Whether the line contains the order over time.
    #[serde(
        default,
        rename = "order",
        skip_serializing,
        deserialize_with = "is_present"
    )]
    pub has_order: bool,
}

/// Skips a value.
fn is_present<'de, D: Deserializer<'de>>(value: D) -> Result<bool, D::Error> {
    IgnoredAny::deserialize(value).map(|_| true)
}

/// A line of the list, with its time series, which is not kept in memory.
#[derive(Serialize)]
pub struct Line<'a> {
    #[serde(flatten)]
    pub record: &'a Record,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub order: Option<StoredOrder>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub series: Option<StoredSeries>,
}

/// The time series of a line; other fields are skipped.
#[derive(Default, Deserialize)]
struct SeriesOfLine {
    order: Option<StoredOrder>,
    series: Option<StoredSeries>,
}

/// The order parameter every `order_every` steps, and the drift if individuals are informed.
#[derive(Deserialize, Serialize)]
pub struct StoredOrder {
    pub order: Vec<f64>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub drift: Vec<Option<f64>>,
}

impl From<OrderSeries> for StoredOrder {
    fn from(series: OrderSeries) -> Self {
        let drifts = series.drifts.into_iter();
        Self {
            order: series.orders,
            // JSON has no NaN.
            drift: drifts
                .map(|drift| (!drift.is_nan()).then_some(drift))
                .collect(),
        }
    }
}

/// The chosen measures every `series_every` steps and at the last step, in the order of the plan.
#[derive(Deserialize, Serialize)]
pub struct StoredSeries {
    pub step: Vec<u64>,
    pub values: Vec<Vec<Option<f64>>>,
}

impl From<Series> for StoredSeries {
    fn from(series: Series) -> Self {
        let measures = series.measures.into_iter();
        Self {
            step: series.steps,
            values: measures.map(|measure| measure.values).collect(),
        }
    }
}

/// A finished run and the byte range of its line in the list.
#[derive(Clone, Debug)]
pub struct Entry {
    pub record: Record,
    pub line: Range<u64>,
}

/// Converts a byte range of a file to indices into its contents.
pub fn to_range(line: &Range<u64>) -> Range<usize> {
    let index = |at| usize::try_from(at).unwrap_or(usize::MAX);
    index(line.start)..index(line.end)
}

/// Reads a line of the list of a folder.
pub fn read_line(folder: &Path, line: &Range<u64>) -> Result<Vec<u8>, FolderError> {
    let path = folder.join(RUNS);
    let mut bytes = vec![0; to_range(line).len()];
    let mut read = || {
        let mut runs = File::open(&path)?;
        runs.seek(SeekFrom::Start(line.start))?;
        runs.read_exact(&mut bytes)
    };
    read().map_err(|source| io_error(&path, source))?;
    Ok(bytes)
}

fn series_of(line: &[u8]) -> SeriesOfLine {
    serde_json::from_slice(line).unwrap_or_default()
}

/// Reads the chosen measures over time of a run from its line of the list.
pub fn read_series(
    folder: &Path,
    plan: &Plan,
    index: usize,
    line: &[u8],
) -> Result<Series, FolderError> {
    let run = &plan.runs()[index];
    let names = plan.columns.measures.iter().map(ToString::to_string);
    let stored = series_of(line).series.filter(|it| {
        let is_whole = |values: &Vec<_>| values.len() == it.step.len();
        it.values.len() == plan.columns.measures.len() && it.values.iter().all(is_whole)
    });
    let Some(stored) = stored else {
        let reason = format!("run {:?} has no time series of the measures", run.name);
        return Err(io_error(
            &folder.join(RUNS),
            io::Error::new(io::ErrorKind::InvalidData, reason),
        ));
    };
    let dt = plan.point(run).spec.parameters.dt;
    Ok(Series {
        run: run.name.clone(),
        times: stored.step.iter().map(|&step| step as f64 * dt).collect(),
        steps: stored.step,
        measures: names
            .zip(stored.values)
            .map(|(name, values)| MeasureSeries { name, values })
            .collect(),
    })
}

/// Reads the order over time of a run from its line of the list, or from the file in which earlier
/// versions stored it.
pub fn read_order(
    folder: &Path,
    plan: &Plan,
    index: usize,
    line: &[u8],
) -> Result<OrderSeries, FolderError> {
    let run = &plan.runs()[index];
    let point = plan.point(run);
    let every = plan.order_every.unwrap_or(1);
    let series = match series_of(line).order {
        Some(series) => series,
        None => read_order_file(folder, index, point.informed > 0)?,
    };
    let orders = series.order;
    let drifts = series.drift.into_iter();
    let steps: Vec<u64> = (0..orders.len() as u64)
        .map(|entry| entry * every)
        .collect();
    let dt = point.spec.parameters.dt;
    Ok(OrderSeries {
        run: run.name.clone(),
        times: steps.iter().map(|&step| step as f64 * dt).collect(),
        steps,
        orders,
        drifts: drifts.map(|drift| drift.unwrap_or(f64::NAN)).collect(),
    })
}

/// Returns the path of the file of a run's order over time in folders of earlier versions.
pub fn order_file(index: usize) -> String {
    format!("{SERIES}/{index:06}")
}

/// Reads the file of a run's order over time: the orders and then the drifts, if the series has drifts, as
/// little-endian doubles without a header.
pub fn read_order_file(
    folder: &Path,
    index: usize,
    has_drift: bool,
) -> Result<StoredOrder, FolderError> {
    let path = folder.join(order_file(index));
    let bytes = fs::read(&path).map_err(|source| io_error(&path, source))?;
    let (numbers, _) = bytes.as_chunks();
    let mut order: Vec<f64> = numbers.iter().copied().map(f64::from_le_bytes).collect();
    let drift = match has_drift {
        true => order.split_off(order.len() / 2),
        false => Vec::new(),
    };
    let drift = drift.into_iter().map(Some).collect();
    Ok(StoredOrder { order, drift })
}

/// The parsed list of runs.
pub struct List {
    /// The finished runs by their index in the plan.
    pub finished: BTreeMap<usize, Entry>,
    /// The number of bytes in complete lines.
    pub length: u64,
    /// The version of the model that executed the runs.
    pub model_version: u32,
}

/// Parses the list of runs. Of several lines of one run the last one is valid: a run whose files were
/// missing was executed again.
pub fn parse_runs(folder: &Path, plan: &Plan, bytes: &[u8]) -> Result<List, FolderError> {
    let damaged = |line: usize, reason: String| FolderError::Damaged {
        path: folder.join(RUNS),
        line: line + 1,
        reason,
    };
    let (mut finished, mut length) = (BTreeMap::new(), 0);
    let mut model_version = MODEL_VERSION;
    for (number, line) in bytes.split_inclusive(|&byte| byte == b'\n').enumerate() {
        let is_last = length + line.len() == bytes.len();
        if number == 0 {
            let header: Header = match serde_json::from_slice(line) {
                Ok(header) if line.ends_with(b"\n") => header,
                _ if is_last => break,
                Ok(_) => unreachable!("only the last line can lack a newline"),
                Err(error) => return Err(damaged(number, error.to_string())),
            };
            model_version = header.model_version;
        } else {
            let mut record: Record = match serde_json::from_slice(line) {
                Ok(record) if line.ends_with(b"\n") => record,
                // The process ended while it wrote the line.
                _ if is_last => break,
                Ok(_) => unreachable!("only the last line can lack a newline"),
                Err(error) => return Err(damaged(number, error.to_string())),
            };
            let Some(index) = plan.index(&record.run) else {
                let reason = format!("the experiment has no run {:?}", record.run);
                return Err(damaged(number, reason));
            };
            let planned = plan.runs()[index].seed;
            if let Some(row) = &record.row
                && row.seed != planned
            {
                let (run, seed) = (&record.run, row.seed);
                let reason = format!("run {run:?} has seed {seed}, expected {planned}");
                return Err(damaged(number, reason));
            }
            if let Some(path) = record.files.keys().find(|path| !is_inside(path)) {
                let reason = format!("invalid file name {path:?}");
                return Err(damaged(number, reason));
            }
            // Earlier versions stored the reason beside the row alone.
            if let Some(row) = &mut record.row {
                row.fault.clone_from(&record.fault);
            }
            let line = length as u64..(length + line.len()) as u64;
            finished.insert(index, Entry { record, line });
        }
        length += line.len();
    }
    Ok(List {
        finished,
        length: length as u64,
        model_version,
    })
}

/// Returns whether a path is relative and stays in its folder.
fn is_inside(path: &str) -> bool {
    let is_normal = |component| matches!(component, Component::Normal(_));
    !path.is_empty() && Path::new(path).components().all(is_normal)
}

pub fn to_line(value: &impl Serialize) -> Vec<u8> {
    let mut line = serde_json::to_vec(value).expect("names and numbers are valid JSON");
    line.push(b'\n');
    line
}

/// Reads a file; empty if it does not exist.
pub fn read_or_empty(path: &Path) -> Result<Vec<u8>, FolderError> {
    match fs::read(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        read => read.map_err(|source| io_error(path, source)),
    }
}
