//! The list of finished runs, `runs.jsonl`: a header and a line for each run.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufRead as _, BufReader, Read as _, Seek as _, SeekFrom};
use std::ops::Range;
use std::path::{Component, Path};

use jostle_physics::model::MODEL_VERSION;
use jostle_physics::observables::Definitions;
use jostle_results::ResultRow;
use jostle_results::contact_statistics::ContactStatistics;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::error::{FolderError, io_error};
use super::stored::{StoredOrder, StoredSeries, order_bytes, series_bytes};
use crate::plan::Plan;

/// The name of the list in its folder.
pub const RUNS: &str = "runs.jsonl";

/// The longest line that is parsed from memory. Only earlier versions wrote longer ones.
const LONG_LINE: u64 = 1 << 20;

/// The first line of the list of finished runs.
#[derive(Deserialize, Serialize)]
pub struct Header {
    pub experiment: String,
    pub model_version: u32,
    /// The number of the definitions of measures. Earlier versions, which had the first ones, wrote none.
    #[serde(default = "first")]
    pub definitions: u32,
}

fn first() -> u32 {
    Definitions::First.number()
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
    /// The bytes of the rows of the order over time, if the line contains it.
    #[serde(default, skip_serializing, deserialize_with = "order_bytes")]
    pub order: Option<u64>,
    /// The bytes of the rows of the measures over time, if the line contains them.
    #[serde(default, skip_serializing, deserialize_with = "series_bytes")]
    pub series: Option<u64>,
}

impl Record {
    /// Adds a file of the run beside the list.
    pub fn add_file(&mut self, name: String, path: &Path) -> Result<(), FolderError> {
        let file = path.metadata();
        let file = file.map_err(|source| io_error(path, source))?;
        self.files.insert(name, file.len());
        Ok(())
    }
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

/// The parsed list of runs.
pub struct List {
    /// The finished runs by their index in the plan.
    pub finished: BTreeMap<usize, Entry>,
    /// The number of bytes in complete lines.
    pub length: u64,
    /// The version of the model that executed the runs.
    pub model_version: u32,
    /// The number of the definitions of their measures.
    pub definitions: u32,
}

impl List {
    /// Returns the list of an experiment that has not begun.
    pub fn empty(plan: &Plan) -> Self {
        Self {
            finished: BTreeMap::new(),
            length: 0,
            model_version: MODEL_VERSION,
            definitions: plan.definitions.number(),
        }
    }

    /// Returns the definitions under which further runs are executed.
    ///
    /// # Errors
    ///
    /// [`FolderError::OtherDefinitions`]: no run can be added.
    pub fn definitions(&self, folder: &Path) -> Result<Definitions, FolderError> {
        let (folder, theirs) = (folder.to_owned(), self.definitions);
        Definitions::of(theirs).ok_or(FolderError::OtherDefinitions { folder, theirs })
    }

    /// Checks that `model_version` executed its runs.
    ///
    /// # Errors
    ///
    /// [`FolderError::OtherModel`].
    pub fn check_model(&self, folder: &Path, model_version: u32) -> Result<(), FolderError> {
        match self.model_version {
            theirs if theirs == model_version => Ok(()),
            theirs => Err(FolderError::OtherModel {
                folder: folder.to_owned(),
                theirs,
            }),
        }
    }
}

/// Reads the version of the model in the header of a folder's list of runs; none if it has no header.
pub fn read_model_version(folder: &Path) -> Option<u32> {
    let path = folder.join(RUNS);
    let mut lines = Lines::open(&path).ok()?;
    let has_header = lines.next().ok()?;
    let header: Header = has_header.then(|| lines.parse().ok())??;
    Some(header.model_version)
}

/// Reads the list of runs of a folder; an empty one if there is none. Of several lines of one run the
/// last one is valid: a run whose files were missing was executed again.
pub fn read_runs(folder: &Path, plan: &Plan) -> Result<List, FolderError> {
    let path = folder.join(RUNS);
    let damaged = |line: usize, reason: String| FolderError::Damaged {
        path: path.clone(),
        line: line + 1,
        reason,
    };
    let fail = |source| io_error(&path, source);
    let mut list = List::empty(plan);
    let mut lines = match Lines::open(&path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(list),
        lines => lines.map_err(fail)?,
    };
    let mut number = 0;
    while lines.next().map_err(fail)? {
        // The process ended while it wrote the last line, which lacks its newline or has other bytes.
        if number == 0 {
            let header: Header = match lines.parse() {
                Ok(header) => header,
                Err(_) if lines.is_last().map_err(fail)? => break,
                Err(error) => return Err(damaged(number, error.to_string())),
            };
            list.model_version = header.model_version;
            list.definitions = header.definitions;
        } else {
            let mut record: Record = match lines.parse() {
                Ok(record) => record,
                Err(_) if lines.is_last().map_err(fail)? => break,
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
            let line = lines.range.clone();
            list.finished.insert(index, Entry { record, line });
        }
        list.length = lines.range.end;
        number += 1;
    }
    Ok(list)
}

/// The lines of a list, one after the other. The text of a long one is not kept in memory.
struct Lines<'a> {
    path: &'a Path,
    reader: BufReader<File>,
    /// The bytes of the current line, at most [`LONG_LINE`].
    text: Vec<u8>,
    range: Range<u64>,
}

impl<'a> Lines<'a> {
    fn open(path: &'a Path) -> io::Result<Self> {
        Ok(Self {
            path,
            reader: BufReader::with_capacity(1 << 16, File::open(path)?),
            text: Vec::new(),
            range: 0..0,
        })
    }

    /// Goes to the next line; returns false at the end, or at a line without its newline.
    fn next(&mut self) -> io::Result<bool> {
        self.text.clear();
        self.range = self.range.end..self.range.end;
        loop {
            let read = self.reader.fill_buf()?;
            if read.is_empty() {
                return Ok(false);
            }
            let newline = read.iter().position(|&byte| byte == b'\n');
            let count = newline.map_or(read.len(), |at| at + 1);
            if self.range.end - self.range.start < LONG_LINE {
                self.text.extend(&read[..count]);
            }
            self.reader.consume(count);
            self.range.end += count as u64;
            if newline.is_some() {
                return Ok(true);
            }
        }
    }

    /// Returns whether no line follows.
    fn is_last(&mut self) -> io::Result<bool> {
        Ok(self.reader.fill_buf()?.is_empty())
    }

    fn parse<T: DeserializeOwned>(&self) -> serde_json::Result<T> {
        match self.range.end - self.range.start == self.text.len() as u64 {
            true => serde_json::from_slice(&self.text),
            false => {
                let reader = line_reader(self.path, &self.range);
                serde_json::from_reader(reader.map_err(serde::de::Error::custom)?)
            }
        }
    }
}

/// Returns a reader of a line.
pub fn line_reader(path: &Path, line: &Range<u64>) -> io::Result<impl io::Read + use<>> {
    let mut runs = File::open(path)?;
    runs.seek(SeekFrom::Start(line.start))?;
    Ok(BufReader::new(runs.take(line.end - line.start)))
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
