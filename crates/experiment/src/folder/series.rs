//! The time series of the finished runs of a folder: in a run's line of the list, in a file of the run,
//! or, the order only, in a file of an earlier version.

use std::fs;
use std::io::{self, BufWriter, Write as _};
use std::ops::Range;
use std::path::{Path, PathBuf};

use jostle_results::table::series::read_part;
use jostle_results::table::{MeasureSeries, Series, SeriesPart};
use serde::Deserialize;

use super::copy::copy;
use super::error::{FolderError, io_error};
use super::list::{
    Entry, Header, Line, List, RUNS, Record, line_reader, read_line, read_runs, to_line,
};
use super::stored::{StoredOrder, StoredSeries, read_raw};
use super::{FinishedRuns, Folder};
use crate::plan::Plan;
use crate::series::{MAX_INLINE, SeriesKind, bytes_of};

/// The folder in which earlier versions stored the order over time.
pub const RAW: &str = "order";

/// Returns the path of the order over time of a run in folders of earlier versions.
pub fn raw_file(index: usize) -> String {
    format!("{RAW}/{index:06}")
}

/// Where a series of a finished run is.
#[derive(Clone, Debug)]
pub enum SeriesSource {
    /// In its line of the list of runs.
    Line {
        /// The byte range of the line.
        line: Range<u64>,
        /// The bytes of its rows: 8 for the step and for each value.
        bytes: u64,
    },
    /// In a Parquet file of the run.
    File(PathBuf),
    /// In a file of an earlier version.
    Raw {
        /// Its path.
        path: PathBuf,
        /// Whether it has the drift.
        has_drift: bool,
    },
}

impl SeriesSource {
    /// Returns whether it is a line that only earlier versions wrote.
    pub fn is_long_line(&self) -> bool {
        matches!(self, Self::Line { bytes, .. } if *bytes > MAX_INLINE)
    }
}

impl Folder {
    /// Returns where a series of a finished run is, by its index in the plan.
    ///
    /// # Errors
    ///
    /// [`FolderError::Io`] if the run is not finished.
    pub fn find_series(
        path: &Path,
        plan: &Plan,
        finished: &FinishedRuns,
        (index, kind): (usize, SeriesKind),
    ) -> Result<SeriesSource, FolderError> {
        let entry = finished.entries.get(&index);
        let entry = entry.ok_or_else(|| {
            let missing = io::ErrorKind::NotFound;
            io_error(&path.join(RUNS), missing.into())
        })?;
        Ok(find(path, plan, index, kind, entry))
    }

    /// Reads a series of a finished run as a whole.
    ///
    /// # Errors
    ///
    /// [`FolderError`], if the run has no such series, too.
    pub fn read_series(
        path: &Path,
        plan: &Plan,
        finished: &FinishedRuns,
        of: (usize, SeriesKind),
    ) -> Result<Series, FolderError> {
        let source = Self::find_series(path, plan, finished, of)?;
        read(path, plan, of, &source)
    }

    /// Reads at most `limit` rows of a series after the first `after` from its file. None if it has no
    /// file of its own: it is read as a whole.
    ///
    /// # Errors
    ///
    /// [`FolderError`].
    pub fn read_series_part(
        source: &SeriesSource,
        after: u64,
        limit: usize,
    ) -> Result<Option<SeriesPart>, FolderError> {
        match source {
            SeriesSource::File(path) => Ok(Some(read_part(path, after, limit)?)),
            SeriesSource::Line { .. } | SeriesSource::Raw { .. } => Ok(None),
        }
    }
}

/// Finds a series of a finished run that has a row.
pub fn find(
    folder: &Path,
    plan: &Plan,
    index: usize,
    kind: SeriesKind,
    entry: &Entry,
) -> SeriesSource {
    let inline = match kind {
        SeriesKind::Order => entry.record.order,
        SeriesKind::Measures => entry.record.series,
    };
    let file = kind.file(index);
    match inline {
        Some(bytes) => SeriesSource::Line {
            line: entry.line.clone(),
            bytes,
        },
        None if kind == SeriesKind::Order && !entry.record.files.contains_key(&file) => {
            SeriesSource::Raw {
                path: folder.join(raw_file(index)),
                has_drift: plan.point(&plan.runs()[index]).informed > 0,
            }
        }
        None => SeriesSource::File(folder.join(file)),
    }
}

/// Reads a series that is not in a file of its own.
pub fn read(
    folder: &Path,
    plan: &Plan,
    (index, kind): (usize, SeriesKind),
    source: &SeriesSource,
) -> Result<Series, FolderError> {
    let stored = match source {
        SeriesSource::Line { line, .. } => read_from_line(folder, line)?,
        SeriesSource::File(path) => {
            return jostle_results::table::series::read(path)?
                .pop()
                .ok_or_else(|| {
                    io_error(path, io::Error::new(io::ErrorKind::InvalidData, "no rows"))
                });
        }
        SeriesSource::Raw { path, has_drift } => SeriesOfLine {
            order: Some(read_raw(path, *has_drift)?),
            series: None,
        },
    };
    let run = &plan.runs()[index];
    let (steps, values) = match kind {
        SeriesKind::Order => stored.order.map(|order| order.columns(plan)),
        SeriesKind::Measures => stored.series.map(|series| (series.step, series.values)),
    }
    .filter(|(steps, values)| {
        let is_whole = |values: &Vec<_>| values.len() == steps.len();
        values.len() == kind.measures(plan).len() && values.iter().all(is_whole)
    })
    .ok_or_else(|| {
        let reason = format!("run {:?} has no time series of the measures", run.name);
        io_error(
            &folder.join(RUNS),
            io::Error::new(io::ErrorKind::InvalidData, reason),
        )
    })?;
    let dt = plan.point(run).spec.parameters.dt;
    Ok(Series {
        run: run.name.clone(),
        times: steps.iter().map(|&step| step as f64 * dt).collect(),
        steps,
        measures: kind
            .measures(plan)
            .into_iter()
            .zip(values)
            .map(|(name, values)| MeasureSeries { name, values })
            .collect(),
    })
}

/// The time series of a line; other fields are skipped.
#[derive(Default, Deserialize)]
struct SeriesOfLine {
    order: Option<StoredOrder>,
    series: Option<StoredSeries>,
}

/// Reads the series of a line without its text in memory.
fn read_from_line(folder: &Path, line: &Range<u64>) -> Result<SeriesOfLine, FolderError> {
    let path = folder.join(RUNS);
    let reader = line_reader(&path, line).map_err(|source| io_error(&path, source))?;
    Ok(serde_json::from_reader(reader).unwrap_or_default())
}

/// Returns the line of a finished run for the list of the folder `to`, and puts there the files that it
/// names. A series that only an earlier version would have stored as it is stored in `from`, moves to
/// where this version stores it.
///
/// # Errors
///
/// [`FolderError`].
pub fn settle(
    (from, to): (&Path, &Path),
    plan: &Plan,
    index: usize,
    entry: &Entry,
) -> Result<Vec<u8>, FolderError> {
    let kinds = SeriesKind::ALL.map(|kind| {
        let has_series = kind.is_in(plan) && entry.record.row.is_some();
        has_series.then(|| find(from, plan, index, kind, entry))
    });
    let is_old = |source: &Option<SeriesSource>| match source {
        Some(source) => source.is_long_line() || matches!(source, SeriesSource::Raw { .. }),
        None => false,
    };
    let is_moved = kinds.iter().any(is_old);
    let mut record = entry.record.clone();
    let mut inline = [None, None];
    for (kind, source) in SeriesKind::ALL.into_iter().zip(&kinds) {
        let (Some(source), name) = (source, kind.file(index)) else {
            continue;
        };
        if let SeriesSource::File(path) = source {
            if from != to {
                copy(path, &to.join(name))?;
            }
        } else if is_moved {
            let series = read(from, plan, (index, kind), source)?;
            if bytes_of(&series) <= MAX_INLINE {
                inline[kind as usize] = Some(series);
                continue;
            }
            let target = to.join(&name);
            let folder = to.join(kind.folder());
            fs::create_dir_all(&folder).map_err(|source| io_error(&folder, source))?;
            let mut writer = kind.begin(&target, plan)?;
            writer.append(&series)?;
            writer.finish()?;
            record.add_file(name, &target)?;
        }
    }
    match is_moved {
        true => Ok(line(&record, inline)),
        false => read_line(from, &entry.line),
    }
}

/// Moves the long series of a list that an earlier version wrote to files. The list is replaced at
/// once, after the files are durable; a process that is killed before moves them again.
///
/// # Errors
///
/// [`FolderError`]. The list is then unchanged.
pub fn settle_all(folder: &Path, plan: &Plan, list: List) -> Result<List, FolderError> {
    let is_long = |bytes: Option<u64>| bytes.is_some_and(|bytes| bytes > MAX_INLINE);
    let has_long = |entry: &Entry| is_long(entry.record.order) || is_long(entry.record.series);
    if !list.finished.values().any(has_long) {
        return Ok(list);
    }
    let path = folder.join(RUNS);
    let fail = |source| io_error(&path, source);
    jostle_atomic_file::remove_unfinished(&path).map_err(fail)?;
    let mut file = BufWriter::new(jostle_atomic_file::begin(&path).map_err(fail)?);
    let header = Header {
        experiment: plan.name.clone(),
        model_version: list.model_version,
        definitions: list.definitions,
    };
    file.write_all(&to_line(&header)).map_err(fail)?;
    let mut entries: Vec<(&usize, &Entry)> = list.finished.iter().collect();
    entries.sort_by_key(|(_, entry)| entry.line.start);
    for (&index, entry) in entries {
        let line = match has_long(entry) {
            true => settle((folder, folder), plan, index, entry)?,
            false => read_line(folder, &entry.line)?,
        };
        file.write_all(&line).map_err(fail)?;
    }
    let file = file
        .into_inner()
        .map_err(|error| fail(error.into_error()))?;
    jostle_atomic_file::publish(file, &path).map_err(fail)?;
    read_runs(folder, plan)
}

/// Returns the line of a finished run with its short series.
pub fn line(record: &Record, [order, series]: [Option<Series>; 2]) -> Vec<u8> {
    to_line(&Line {
        record,
        order: order.map(Into::into),
        series: series.map(Into::into),
    })
}
