//! Reads the journal of a swarm from the store.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::vec;

use jostle_proto::Request;
use serde_json::value::RawValue;
use thiserror::Error;

use crate::convert::commands;
use crate::persistence::writer;
use crate::store::{Row, Store, StoreError};
use crate::swarm::command::Command;
use crate::swarm::frame::Stamp;
use crate::swarm::history::Entry;
use crate::swarm::journal::{Line, Record};
use crate::swarm::phase::{PauseReason, Phase};
use crate::swarm::sender::Sender;
use crate::swarm::worker::replay::ReplayEntry;

/// Lines per page.
const PAGE_LINES: usize = 1000;

/// Why a line cannot be read. Iteration ends after it.
#[derive(Debug, Error)]
pub enum LineError {
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(
        "line {number} of its journal is damaged ({problem}): this is the last state that is certain; \
         reset it, or delete it and restore a snapshot"
    )]
    Damaged { number: u64, problem: String },
    /// It was deleted during the iteration.
    #[error("line {0} of its journal is no longer stored: retry")]
    Gone(u64),
}

/// An iterator over the lines of a journal, in order, which loads a page at a time.
pub struct JournalReader {
    store: Store,
    swarm: String,
    after: u64,
    until: u64,
    page: vec::IntoIter<Row>,
    is_last_page: bool,
    is_damaged: bool,
}

impl JournalReader {
    /// The lines after line `after` up to line `until`, or to the last one.
    pub fn new(store: &Store, swarm: &str, after: u64, until: u64) -> Self {
        JournalReader {
            store: store.clone(),
            swarm: swarm.to_owned(),
            after,
            until,
            page: Vec::new().into_iter(),
            is_last_page: false,
            is_damaged: false,
        }
    }

    fn read(&mut self) -> Result<Option<ReplayEntry>, LineError> {
        if self.after >= self.until {
            return Ok(None);
        }
        if self.page.as_slice().is_empty() && !self.is_last_page {
            let page = self.store.rows(&self.swarm, self.after, PAGE_LINES)?;
            self.is_last_page = page.rows.len() < PAGE_LINES;
            self.is_damaged = page.damaged_at.is_some();
            self.page = page.rows.into_iter();
        }
        let number = self.after + 1;
        let damaged = |problem| LineError::Damaged { number, problem };
        match self.page.next() {
            Some(row) if row.number == number => {
                self.after = number;
                parse_entry(&row).map(Some).map_err(damaged)
            }
            Some(_) => Err(LineError::Gone(number)),
            None if self.is_damaged => Err(damaged("its checksum is wrong".into())),
            None => Ok(None),
        }
    }
}

impl Iterator for JournalReader {
    type Item = Result<ReplayEntry, LineError>;

    fn next(&mut self) -> Option<Self::Item> {
        let read = self.read();
        if read.is_err() {
            // The lines after it cannot be trusted.
            self.until = self.after;
        }
        read.transpose()
    }
}

/// Reads the lines after line `after` up to line `until` that are stored and can be parsed.
pub fn read_lines(
    store: &Store,
    swarm: &str,
    mut after: u64,
    until: u64,
) -> Result<Vec<Line>, StoreError> {
    let mut lines = Vec::new();
    while after < until {
        let rows = store.rows(swarm, after, PAGE_LINES)?.rows;
        let Some(last) = rows.last() else {
            break;
        };
        after = last.number;
        let rows = rows.iter().filter(|row| row.number <= until);
        lines.extend(rows.filter_map(|row| parse_line(row).ok()));
    }
    Ok(lines)
}

/// A command that was applied.
pub struct AppliedInput {
    pub epoch: u64,
    pub step: u64,
    /// Its number among the applied commands, annotations included.
    pub seq: u64,
    pub unix_secs: Option<f64>,
    pub sender: Arc<Sender>,
}

impl AppliedInput {
    /// As an entry of the history of a swarm with steps of `dt`.
    pub fn entry(self, dt: f64) -> Entry {
        Entry {
            stamp: Stamp {
                epoch: self.epoch,
                step: self.step,
                time: self.step as f64 * dt,
                phase: Phase::Paused(PauseReason::Requested),
                seq: self.seq,
            },
            unix_secs: self.unix_secs,
            sender: self.sender,
        }
    }
}

/// Finds the commands that were applied in a sequence of lines.
#[derive(Default)]
pub struct AppliedInputs {
    /// Commands whose outcome has not been read, by their lines.
    waiting: BTreeMap<u64, Arc<Sender>>,
}

impl AppliedInputs {
    /// Whether the command on a line was read and waits for its outcome.
    pub fn has(&self, input: u64) -> bool {
        self.waiting.contains_key(&input)
    }

    /// Adds a command that was scheduled before the first line.
    pub fn wait_for(&mut self, input: u64, sender: Arc<Sender>) {
        self.waiting.insert(input, sender);
    }

    /// Reads the next line. Returns the command that it says was applied.
    pub fn read(&mut self, line: Line) -> Option<AppliedInput> {
        let (seq, sender, unix_secs) = match line.record {
            Record::Input {
                sender, seq: None, ..
            } => {
                self.waiting.insert(line.number, sender);
                return None;
            }
            Record::Input {
                sender,
                seq: Some(seq),
                unix_secs,
                ..
            } => (seq, sender, unix_secs),
            Record::Outcome {
                input,
                seq,
                unix_secs,
            } => (seq?, self.waiting.remove(&input)?, unix_secs),
            Record::Fault(_) | Record::Resumed(_) | Record::Hash(_) => return None,
        };
        Some(AppliedInput {
            epoch: line.epoch,
            step: line.step,
            seq,
            unix_secs,
            sender,
        })
    }
}

/// Reads a row of the store.
pub fn parse_line(row: &Row) -> Result<Line, String> {
    Ok(Line {
        number: row.number,
        epoch: row.epoch,
        step: row.step,
        record: writer::read_record(&row.body).map_err(|error| error.to_string())?,
    })
}

fn parse_entry(row: &Row) -> Result<ReplayEntry, String> {
    let line = parse_line(row)?;
    let command = match &line.record {
        Record::Input { sender, .. } => Some(parse_command(sender)?),
        _ => None,
    };
    Ok((line, command))
}

pub fn parse_command(sender: &Sender) -> Result<Command, String> {
    parse_request(sender).map(|(command, _)| command)
}

/// Parses the command of a sender, and whether its reply contains the state.
pub fn parse_request(sender: &Sender) -> Result<(Command, bool), String> {
    let args = RawValue::from_string(sender.args.clone()).map_err(|error| error.to_string())?;
    let request = Request {
        args: Some(args),
        ..Request::default()
    };
    commands::read_journaled(sender.verb, &request).map_err(|error| error.to_string())
}
