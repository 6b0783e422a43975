//! The folder of an experiment's results. A finished run survives a crash.
//!
//! A folder contains:
//!
//! - `experiment.toml`, a copy of the experiment's file;
//! - `runs.jsonl`, a header and a line for each finished run; a run counts as finished once its
//!   line is durable;
//! - `order/`, a file of numbers for each run, if the plan has `order_every`;
//! - the tables, written from these: `results.parquet`, `results.csv`, `order.parquet` and
//!   `touch.csv`;
//! - `lock`, which a process that writes to the folder holds exclusively.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

use jostle_physics::model::MODEL_VERSION;
use jostle_results::Run;
use jostle_results::table::order::ORDER_NAME;
use jostle_results::table::{self, CSV_NAME, OrderSeries, OrderWriter, PARQUET_NAME, TableError};
use jostle_results::touch::{self, TOUCH_NAME, Touch};
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::plan::{Plan, PlannedRun};
use crate::run::Finished;

const EXPERIMENT: &str = "experiment.toml";
const RUNS: &str = "runs.jsonl";
const LOCK: &str = "lock";
const SERIES: &str = "order";

/// Why a folder cannot be used.
#[derive(Debug, Error)]
pub enum FolderError {
    /// A system call failed.
    #[error("use {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// A table could not be written.
    #[error(transparent)]
    Table(#[from] TableError),
    /// Another process has locked the folder.
    #[error("use {}: another process is running this experiment", folder.display())]
    InUse {
        /// The folder.
        folder: PathBuf,
    },
    /// The folder contains results of another file.
    #[error(
        "use {}: it contains results of another experiment.toml; choose another folder, or \
         continue with that file", folder.display()
    )]
    OtherExperiment {
        /// The folder.
        folder: PathBuf,
    },
    /// The folder contains results, but no `experiment.toml`.
    #[error(
        "use {}: it contains {file} but no {EXPERIMENT}; choose another folder", folder.display()
    )]
    NoExperiment {
        /// The folder.
        folder: PathBuf,
        /// The first file or folder of results that was found.
        file: &'static str,
    },
    /// The runs were computed with another version of the model, which gives other results for the
    /// same seeds.
    #[error(
        "use {}: its runs have model version {theirs}, this program has {MODEL_VERSION}; finish it \
         with the jostled that started it, or choose another folder", folder.display()
    )]
    OtherModel {
        /// The folder.
        folder: PathBuf,
        /// The model version of its runs.
        theirs: u32,
    },
    /// A line of the list of runs is damaged.
    #[error("read {}: line {line}: {reason}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What is wrong.
        reason: String,
    },
}

/// The first line of the list of finished runs.
#[derive(Deserialize, Serialize)]
struct Header {
    experiment: String,
    model_version: u32,
}

/// A finished run.
#[derive(Clone, Debug, Deserialize, Serialize)]
struct Record {
    run: String,
    /// Why the run ended early, if it did.
    fault: Option<String>,
    /// The row of the run; none if it ended before its first step.
    row: Option<Run>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    touch: Option<Touch>,
}

/// The folder of an experiment, locked for writing.
#[derive(Debug)]
pub struct Folder {
    path: PathBuf,
    runs: File,
    finished: BTreeMap<String, Record>,
    /// The lock is released when this file is closed.
    _lock: File,
}

impl Folder {
    /// Opens and locks the folder of an experiment, or creates it. An incomplete last line of the
    /// list of runs is removed.
    ///
    /// # Errors
    ///
    /// [`FolderError`]. Results in the folder are then unchanged.
    pub fn open(path: &Path, plan: &Plan) -> Result<Self, FolderError> {
        fs::create_dir_all(path).map_err(|source| io_error(path, source))?;
        let lock = lock(path)?;
        claim(path, plan)?;
        let list = path.join(RUNS);
        let fail = |source| io_error(&list, source);
        let bytes = read_or_empty(&list)?;
        let mut runs = OpenOptions::new()
            .create(true)
            .truncate(false)
            .write(true)
            .open(&list)
            .map_err(fail)?;
        let (finished, mut length) = parse_runs(path, plan, &bytes)?;
        // A run whose line is incomplete is not finished.
        runs.set_len(length).map_err(fail)?;
        runs.seek(SeekFrom::End(0)).map_err(fail)?;
        if length == 0 {
            let header = Header {
                experiment: plan.name.clone(),
                model_version: MODEL_VERSION,
            };
            let line = to_line(&header);
            runs.write_all(&line).map_err(fail)?;
            length = line.len() as u64;
        }
        debug_assert!(length > 0);
        runs.sync_all().map_err(fail)?;
        if plan.order_every.is_some() {
            let series = path.join(SERIES);
            fs::create_dir_all(&series).map_err(|source| io_error(&series, source))?;
        }
        sync_folder(path)?;
        Ok(Self {
            path: path.to_owned(),
            runs,
            finished,
            _lock: lock,
        })
    }

    /// Reads the rows of the finished runs, in the plan's order. Does not lock the folder: another
    /// process may append runs meanwhile.
    ///
    /// # Errors
    ///
    /// [`FolderError`].
    pub fn read(path: &Path, plan: &Plan) -> Result<Vec<Run>, FolderError> {
        let bytes = read_or_empty(&path.join(RUNS))?;
        let (finished, _) = parse_runs(path, plan, &bytes)?;
        Ok(rows(plan, &finished))
    }

    /// Reads the order over time of a finished run, by its index in the plan.
    ///
    /// # Errors
    ///
    /// [`FolderError::Io`] if the run has no such series.
    pub fn read_order(path: &Path, plan: &Plan, index: usize) -> Result<OrderSeries, FolderError> {
        read_series(path, plan, index, plan.order_every.unwrap_or(1))
    }

    /// The path of the folder.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns whether a run is finished.
    #[must_use]
    pub fn is_finished(&self, run: &PlannedRun) -> bool {
        self.finished.contains_key(&run.name)
    }

    /// Returns the rows of the finished runs, in the plan's order.
    #[must_use]
    pub fn rows(&self, plan: &Plan) -> Vec<Run> {
        rows(plan, &self.finished)
    }

    /// Returns the names of the runs that ended early, each with its reason, in the plan's order.
    #[must_use]
    pub fn faults(&self, plan: &Plan) -> Vec<(String, String)> {
        let records = plan.runs().iter().map(|run| self.finished.get(&run.name));
        let faults = records.flatten().filter_map(|record| {
            let fault = record.fault.as_ref()?;
            Some((record.run.clone(), fault.clone()))
        });
        faults.collect()
    }

    /// Appends finished runs, each with its index in the plan. They are durable on return.
    ///
    /// # Errors
    ///
    /// [`FolderError::Io`]. None of them counts as finished then.
    pub fn append(
        &mut self,
        plan: &Plan,
        batch: Vec<(usize, Finished)>,
    ) -> Result<(), FolderError> {
        let mut lines = Vec::new();
        let mut records = Vec::with_capacity(batch.len());
        for (index, finished) in batch {
            if let Some(series) = &finished.series {
                self.write_series(index, series)?;
            }
            let record = Record {
                run: plan.runs()[index].name.clone(),
                fault: finished.fault,
                row: finished.row,
                touch: finished.touch,
            };
            lines.extend(to_line(&record));
            records.push(record);
        }
        if plan.order_every.is_some() {
            sync_folder(&self.path.join(SERIES))?;
        }
        let written = self.runs.write_all(&lines);
        let synced = written.and_then(|()| self.runs.sync_data());
        synced.map_err(|source| io_error(&self.path.join(RUNS), source))?;
        let named = records
            .into_iter()
            .map(|record| (record.run.clone(), record));
        self.finished.extend(named);
        Ok(())
    }

    /// Writes the tables of the finished runs, in the plan's order.
    ///
    /// # Errors
    ///
    /// [`FolderError`].
    pub fn write_tables(&self, plan: &Plan) -> Result<(), FolderError> {
        table::write(&self.path, &self.rows(plan))?;
        if plan.touch {
            let records = plan.runs().iter().map(|run| self.finished.get(&run.name));
            let rows = records.flatten().filter_map(|record| record.touch.clone());
            touch::write(&self.path.join(TOUCH_NAME), &rows.collect::<Vec<_>>())?;
        }
        let Some(every) = plan.order_every else {
            return Ok(());
        };
        let mut writer = OrderWriter::begin(&self.path.join(ORDER_NAME))?;
        for (index, run) in plan.runs().iter().enumerate() {
            let record = self.finished.get(&run.name);
            if record.is_some_and(|record| record.row.is_some()) {
                writer.append(&read_series(&self.path, plan, index, every)?)?;
            }
        }
        Ok(writer.finish()?)
    }

    /// Writes the orders and then the drifts, if the series has drifts, as little-endian doubles
    /// without a header.
    fn write_series(&self, index: usize, series: &OrderSeries) -> Result<(), FolderError> {
        let numbers = series.orders.iter().chain(&series.drifts);
        let bytes: Vec<u8> = numbers.flat_map(|number| number.to_le_bytes()).collect();
        write_atomically(&series_path(&self.path, index), &bytes)
    }
}

fn series_path(folder: &Path, index: usize) -> PathBuf {
    folder.join(SERIES).join(format!("{index:06}"))
}

fn read_series(
    folder: &Path,
    plan: &Plan,
    index: usize,
    every: u64,
) -> Result<OrderSeries, FolderError> {
    let run = &plan.runs()[index];
    let point = plan.point(run);
    let path = series_path(folder, index);
    let bytes = fs::read(&path).map_err(|source| io_error(&path, source))?;
    let (numbers, _) = bytes.as_chunks();
    let mut orders: Vec<f64> = numbers.iter().copied().map(f64::from_le_bytes).collect();
    let drifts = match point.informed {
        0 => Vec::new(),
        _ => orders.split_off(orders.len() / 2),
    };
    let steps: Vec<u64> = (0..orders.len() as u64)
        .map(|entry| entry * every)
        .collect();
    let dt = point.spec.parameters.dt;
    Ok(OrderSeries {
        run: run.name.clone(),
        times: steps.iter().map(|&step| step as f64 * dt).collect(),
        steps,
        orders,
        drifts,
    })
}

/// Locks a folder until the returned file is closed.
fn lock(folder: &Path) -> Result<File, FolderError> {
    let path = folder.join(LOCK);
    let fail = |source| io_error(&path, source);
    let lock = OpenOptions::new()
        .create(true)
        .truncate(false)
        .write(true)
        .open(&path)
        .map_err(fail)?;
    match flock(&lock, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => Ok(lock),
        Err(Errno::WOULDBLOCK) => Err(FolderError::InUse {
            folder: folder.to_owned(),
        }),
        Err(error) => Err(fail(error.into())),
    }
}

/// Checks that the folder belongs to the plan's file. If the folder has no results, writes the
/// file.
fn claim(folder: &Path, plan: &Plan) -> Result<(), FolderError> {
    let path = folder.join(EXPERIMENT);
    match fs::read(&path) {
        Ok(bytes) if bytes == plan.text.as_bytes() => Ok(()),
        Ok(_) => Err(FolderError::OtherExperiment {
            folder: folder.to_owned(),
        }),
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            let names = [RUNS, PARQUET_NAME, CSV_NAME, ORDER_NAME, SERIES];
            if let Some(file) = names.into_iter().find(|name| folder.join(name).exists()) {
                let folder = folder.to_owned();
                return Err(FolderError::NoExperiment { folder, file });
            }
            write_atomically(&path, plan.text.as_bytes())?;
            sync_folder(folder)
        }
        Err(source) => Err(io_error(&path, source)),
    }
}

/// Parses the list of runs. Returns the finished runs by name, and the number of bytes in complete
/// lines.
fn parse_runs(
    folder: &Path,
    plan: &Plan,
    bytes: &[u8],
) -> Result<(BTreeMap<String, Record>, u64), FolderError> {
    let damaged = |line: usize, reason: String| FolderError::Damaged {
        path: folder.join(RUNS),
        line: line + 1,
        reason,
    };
    let seeds: BTreeMap<&str, u64> = plan
        .runs()
        .iter()
        .map(|run| (run.name.as_str(), run.seed))
        .collect();
    let (mut finished, mut length) = (BTreeMap::new(), 0);
    for (number, line) in bytes.split_inclusive(|&byte| byte == b'\n').enumerate() {
        let is_last = length + line.len() == bytes.len();
        if number == 0 {
            let header: Header = match serde_json::from_slice(line) {
                Ok(header) if line.ends_with(b"\n") => header,
                _ if is_last => break,
                Ok(_) => unreachable!("only the last line can lack a newline"),
                Err(error) => return Err(damaged(number, error.to_string())),
            };
            if header.model_version != MODEL_VERSION {
                return Err(FolderError::OtherModel {
                    folder: folder.to_owned(),
                    theirs: header.model_version,
                });
            }
        } else {
            let record: Record = match serde_json::from_slice(line) {
                Ok(record) if line.ends_with(b"\n") => record,
                // The process ended while it wrote the line.
                _ if is_last => break,
                Ok(_) => unreachable!("only the last line can lack a newline"),
                Err(error) => return Err(damaged(number, error.to_string())),
            };
            let seed = record.row.as_ref().map(|row| row.seed);
            match seeds.get(record.run.as_str()) {
                None => {
                    let reason = format!("the experiment has no run {:?}", record.run);
                    return Err(damaged(number, reason));
                }
                Some(&planned) if seed.is_some_and(|seed| seed != planned) => {
                    let reason = format!("the seed of run {:?} is {planned}", record.run);
                    return Err(damaged(number, reason));
                }
                Some(_) => {}
            }
            finished.insert(record.run.clone(), record);
        }
        length += line.len();
    }
    Ok((finished, length as u64))
}

fn rows(plan: &Plan, finished: &BTreeMap<String, Record>) -> Vec<Run> {
    let records = plan.runs().iter().filter_map(|run| finished.get(&run.name));
    records.filter_map(|record| record.row.clone()).collect()
}

fn to_line(value: &impl Serialize) -> Vec<u8> {
    let mut line = serde_json::to_vec(value).expect("names and numbers are valid JSON");
    line.push(b'\n');
    line
}

/// Reads a file; empty if it does not exist.
fn read_or_empty(path: &Path) -> Result<Vec<u8>, FolderError> {
    match fs::read(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        read => read.map_err(|source| io_error(path, source)),
    }
}

/// Writes a file through a temporary one, so that a crash leaves no incomplete file.
fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), FolderError> {
    let fail = |source| io_error(path, source);
    let draft = path.with_extension("part");
    let mut file = File::create(&draft).map_err(fail)?;
    file.write_all(bytes).map_err(fail)?;
    file.sync_all().map_err(fail)?;
    fs::rename(&draft, path).map_err(fail)
}

/// Makes the entries of a folder durable.
fn sync_folder(path: &Path) -> Result<(), FolderError> {
    let synced = File::open(path).and_then(|folder| folder.sync_all());
    synced.map_err(|source| io_error(path, source))
}

fn io_error(path: &Path, source: io::Error) -> FolderError {
    FolderError::Io {
        path: path.to_owned(),
        source,
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
