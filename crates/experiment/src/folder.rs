//! Where an experiment's results are kept, so that whatever ends it, no finished run is lost.
//!
//! A folder holds `experiment.toml`, the file it was made from; `runs.jsonl`, a header and then a
//! line for each finished run, on the disk before the run counts as finished; `order/`, a file of
//! bare numbers for each run if the plan asks for time series; and the tables made of these:
//! `results.parquet`, `results.csv`, `order.parquet` and `touch.csv`. While somebody writes it, `lock` is held.

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
    /// The system refused.
    #[error("use {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// A table could not be written.
    #[error(transparent)]
    Table(#[from] TableError),
    /// Somebody else writes it.
    #[error("use {}: another process is running this experiment", folder.display())]
    InUse {
        /// The folder.
        folder: PathBuf,
    },
    /// It holds the results of another file.
    #[error(
        "use {}: it holds the results of another experiment.toml; choose another folder, or go on \
         with that file", folder.display()
    )]
    OtherExperiment {
        /// The folder.
        folder: PathBuf,
    },
    /// It holds results, but not what they are results of.
    #[error(
        "use {}: it holds {file} but no {EXPERIMENT}; choose another folder", folder.display()
    )]
    NoExperiment {
        /// The folder.
        folder: PathBuf,
        /// What it holds.
        file: &'static str,
    },
    /// Its runs are those of another model: the same seeds would have other futures.
    #[error(
        "use {}: its runs are of model version {theirs}, this is {MODEL_VERSION}; finish it with \
         the jostled that began it, or choose another folder", folder.display()
    )]
    OtherModel {
        /// The folder.
        folder: PathBuf,
        /// The version of its model.
        theirs: u32,
    },
    /// A line is not what was written there.
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

/// The first line of a list of finished runs.
#[derive(Deserialize, Serialize)]
struct Header {
    experiment: String,
    model_version: u32,
}

/// A finished run.
#[derive(Clone, Debug, Deserialize, Serialize)]
struct Record {
    run: String,
    /// Why it ended early, if it did.
    fault: Option<String>,
    /// Its row; none if it ended before its first step.
    row: Option<Run>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    touch: Option<Touch>,
}

/// The folder of an experiment, while it is locked.
#[derive(Debug)]
pub struct Folder {
    path: PathBuf,
    runs: File,
    finished: BTreeMap<String, Record>,
    /// Held while the folder is.
    _lock: File,
}

impl Folder {
    /// Opens the folder of an experiment, or makes it.
    ///
    /// # Errors
    ///
    /// [`FolderError`]; whatever the folder holds is then as it was.
    pub fn open(path: &Path, plan: &Plan) -> Result<Self, FolderError> {
        fs::create_dir_all(path).map_err(|source| io_error(path, source))?;
        let lock = lock(path)?;
        claim(path, plan)?;
        let list = path.join(RUNS);
        let fail = |source| io_error(&list, source);
        let bytes = read_if_there(&list)?;
        let mut runs = OpenOptions::new()
            .create(true)
            .truncate(false)
            .write(true)
            .open(&list)
            .map_err(fail)?;
        let (finished, mut length) = understand(path, plan, &bytes)?;
        // What was not written to its end is not finished.
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

    /// Reads the rows of the runs that are finished, in the plan's order; somebody may be adding
    /// to them meanwhile.
    ///
    /// # Errors
    ///
    /// [`FolderError`].
    pub fn read(path: &Path, plan: &Plan) -> Result<Vec<Run>, FolderError> {
        let bytes = read_if_there(&path.join(RUNS))?;
        let (finished, _) = understand(path, plan, &bytes)?;
        Ok(rows(plan, &finished))
    }

    /// Reads the order over time of a finished run, by its index in the plan.
    ///
    /// # Errors
    ///
    /// [`FolderError::Io`] when there is none.
    pub fn read_order(path: &Path, plan: &Plan, index: usize) -> Result<OrderSeries, FolderError> {
        read_series(path, plan, index, plan.order_every.unwrap_or(1))
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether a run is finished.
    #[must_use]
    pub fn is_finished(&self, run: &PlannedRun) -> bool {
        self.finished.contains_key(&run.name)
    }

    /// The rows of the runs that are finished, in the plan's order.
    #[must_use]
    pub fn rows(&self, plan: &Plan) -> Vec<Run> {
        rows(plan, &self.finished)
    }

    /// The runs that ended early and why, in the plan's order.
    #[must_use]
    pub fn faults(&self, plan: &Plan) -> Vec<(String, String)> {
        let records = plan.runs().iter().map(|run| self.finished.get(&run.name));
        let faults = records.flatten().filter_map(|record| {
            let fault = record.fault.as_ref()?;
            Some((record.run.clone(), fault.clone()))
        });
        faults.collect()
    }

    /// Writes down finished runs, by their index in the plan. They are on the disk on return.
    ///
    /// # Errors
    ///
    /// [`FolderError::Io`]; none of them is finished then.
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

    /// Makes the tables of what is finished, in the plan's order.
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

    /// Writes the orders, then the drifts if there are any, as bare little-endian doubles.
    fn write_series(&self, index: usize, series: &OrderSeries) -> Result<(), FolderError> {
        let numbers = series.orders.iter().chain(&series.drifts);
        let bytes: Vec<u8> = numbers.flat_map(|number| number.to_le_bytes()).collect();
        write_whole(&series_path(&self.path, index), &bytes)
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

/// Locks a folder until the file returned is closed.
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

/// Makes sure that the folder is that of the plan's file, and says so in a new one.
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
            write_whole(&path, plan.text.as_bytes())?;
            sync_folder(folder)
        }
        Err(source) => Err(io_error(&path, source)),
    }
}

/// Reads what is written of finished runs, and how many bytes of it are whole lines.
fn understand(
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
                Ok(_) => unreachable!("a line that is not the last ends"),
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
                // Its writer was ended in the midst of it.
                _ if is_last => break,
                Ok(_) => unreachable!("a line that is not the last ends"),
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
    let mut line = serde_json::to_vec(value).expect("names and numbers");
    line.push(b'\n');
    line
}

fn read_if_there(path: &Path) -> Result<Vec<u8>, FolderError> {
    match fs::read(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        read => read.map_err(|source| io_error(path, source)),
    }
}

/// Writes a file that is either whole or not there.
fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), FolderError> {
    let fail = |source| io_error(path, source);
    let draft = path.with_extension("part");
    let mut file = File::create(&draft).map_err(fail)?;
    file.write_all(bytes).map_err(fail)?;
    file.sync_all().map_err(fail)?;
    fs::rename(&draft, path).map_err(fail)
}

/// Has the disk know the names in a folder.
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
mod tests {
    use super::*;
    use crate::run::conduct;

    const FILE: &str = "name = \"a\"\nduration = 1\nreplicates = 4\nspec = { n = 3 }\n\
                        measure = { order_every = 10 }\n";

    struct Fixture {
        directory: tempfile::TempDir,
        plan: Plan,
    }

    impl Fixture {
        fn new() -> Self {
            Self {
                directory: tempfile::tempdir().unwrap(),
                plan: Plan::parse(FILE).unwrap(),
            }
        }

        fn path(&self) -> &Path {
            self.directory.path()
        }

        fn open(&self) -> Result<Folder, FolderError> {
            Folder::open(self.path(), &self.plan)
        }

        fn append(&self, folder: &mut Folder, index: usize) {
            let finished = conduct(&self.plan, &self.plan.runs()[index], |_| true).unwrap();
            folder.append(&self.plan, vec![(index, finished)]).unwrap();
        }

        fn names(&self, folder: &Folder) -> Vec<String> {
            let rows = folder.rows(&self.plan).into_iter();
            rows.map(|row| row.run).collect()
        }

        /// Changes the list of finished runs.
        fn edit(&self, change: impl FnOnce(&mut Vec<u8>)) {
            let path = self.path().join(RUNS);
            let mut bytes = fs::read(&path).unwrap();
            change(&mut bytes);
            fs::write(path, bytes).unwrap();
        }
    }

    #[test]
    fn rows_come_back_in_the_plans_order_and_with_their_series() {
        let fixture = Fixture::new();
        let mut folder = fixture.open().unwrap();
        for index in [2, 0] {
            fixture.append(&mut folder, index);
        }
        assert_eq!(fixture.names(&folder), ["#0", "#2"]);
        let rows = folder.rows(&fixture.plan);
        drop(folder);
        let folder = fixture.open().unwrap();
        assert_eq!(folder.rows(&fixture.plan), rows);
        assert_eq!(Folder::read(fixture.path(), &fixture.plan).unwrap(), rows);
        let finished = fixture
            .plan
            .runs()
            .iter()
            .map(|run| folder.is_finished(run));
        assert_eq!(finished.collect::<Vec<_>>(), [true, false, true, false]);
        folder.write_tables(&fixture.plan).unwrap();
        assert_eq!(table::read(fixture.path()).unwrap(), rows);
        let series = table::order::read(&fixture.path().join(ORDER_NAME)).unwrap();
        let expected = [0, 2].map(|index| {
            let run = &fixture.plan.runs()[index];
            conduct(&fixture.plan, run, |_| true)
                .unwrap()
                .series
                .unwrap()
        });
        assert_eq!(series, expected);
    }

    #[test]
    fn a_line_cut_anywhere_is_no_run_and_those_before_it_are() {
        let fixture = Fixture::new();
        let mut folder = fixture.open().unwrap();
        let header = fs::read(fixture.path().join(RUNS)).unwrap().len();
        fixture.append(&mut folder, 0);
        let first = fs::read(fixture.path().join(RUNS)).unwrap().len();
        fixture.append(&mut folder, 1);
        drop(folder);
        let whole = fs::read(fixture.path().join(RUNS)).unwrap();
        for length in (0..whole.len())
            .step_by(7)
            .chain([header, first, whole.len() - 1])
        {
            fixture.edit(|bytes| *bytes = whole[..length].to_vec());
            let folder = fixture.open().unwrap();
            let expected = usize::from(length >= first);
            assert_eq!(fixture.names(&folder).len(), expected, "{length}");
            let left = fs::read(fixture.path().join(RUNS)).unwrap();
            assert_eq!(left.len(), if expected == 1 { first } else { header });
        }
        // What the disk made of a line that it never got is no run either.
        fixture.edit(|bytes| *bytes = [&whole[..first], b"\0\0\0\0\n"].concat());
        assert_eq!(fixture.names(&fixture.open().unwrap()), ["#0"]);
    }

    #[test]
    fn a_line_damaged_in_the_midst_is_told_and_nothing_is_changed() {
        let fixture = Fixture::new();
        let mut folder = fixture.open().unwrap();
        fixture.append(&mut folder, 0);
        fixture.append(&mut folder, 1);
        drop(folder);
        let whole = fs::read(fixture.path().join(RUNS)).unwrap();
        let text = String::from_utf8(whole).unwrap();
        let lines: Vec<&str> = text.split_inclusive('\n').collect();
        let seed = fixture.plan.runs()[0].seed.to_string();
        for damaged in [
            [lines[0], &lines[1][5..], lines[2]].concat(),
            [lines[0], &lines[1].replace("#0", "#9"), lines[2]].concat(),
            [lines[0], &lines[1].replace(&seed, "1"), lines[2]].concat(),
        ] {
            fixture.edit(|bytes| *bytes = damaged.clone().into_bytes());
            match fixture.open().unwrap_err() {
                FolderError::Damaged { line, .. } => assert_eq!(line, 2),
                other => panic!("{other}"),
            }
            assert_eq!(
                fs::read_to_string(fixture.path().join(RUNS)).unwrap(),
                damaged
            );
        }
        let old = lines
            .concat()
            .replace("\"model_version\":", "\"model_version\":9");
        fixture.edit(|bytes| *bytes = old.into_bytes());
        let other = fixture.open().unwrap_err();
        assert!(matches!(other, FolderError::OtherModel { .. }), "{other}");
    }

    #[test]
    fn a_folder_has_one_experiment_and_one_writer() {
        let fixture = Fixture::new();
        let folder = fixture.open().unwrap();
        let twice = fixture.open().unwrap_err();
        assert!(matches!(twice, FolderError::InUse { .. }), "{twice}");
        drop(folder);
        let other = Plan::parse(&format!("{FILE}# another\n")).unwrap();
        let refused = Folder::open(fixture.path(), &other).unwrap_err();
        assert!(
            matches!(refused, FolderError::OtherExperiment { .. }),
            "{refused}"
        );
        fixture.open().unwrap();
        fs::remove_file(fixture.path().join(EXPERIMENT)).unwrap();
        let orphan = fixture.open().unwrap_err();
        assert!(
            matches!(orphan, FolderError::NoExperiment { file: RUNS, .. }),
            "{orphan}"
        );
        let file = fixture.path().join(RUNS);
        let nowhere = Folder::open(&file, &fixture.plan).unwrap_err();
        assert!(matches!(nowhere, FolderError::Io { .. }), "{nowhere}");
    }
}
