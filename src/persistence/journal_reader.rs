//! Reads the journal of a swarm from the store.

use std::vec;

use jostle_proto::Request;
use serde_json::value::RawValue;
use thiserror::Error;

use crate::convert::commands::{self, ParsedCommand};
use crate::convert::durable;
use crate::store::{Row, Store, StoreError};
use crate::swarm::command::Command;
use crate::swarm::journal::{Line, Record};
use crate::swarm::sender::Sender;
use crate::swarm::worker::journal_index::ReplayEntry;

/// Lines per page.
pub const PAGE_LINES: usize = 1000;

/// Why a line cannot be read. Iteration ends after it.
#[derive(Debug, Error)]
pub enum LineError {
    /// The store cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// It is damaged.
    #[error(
        "line {number} of its journal is damaged ({problem}): this is the last state that is certain; \
         reset it, or delete it and restore a snapshot"
    )]
    Damaged {
        /// Its number.
        number: u64,
        /// The problem.
        problem: String,
    },
    /// It was deleted during the iteration.
    #[error("line {0} of its journal is no longer stored: retry")]
    Gone(u64),
}

/// An iterator over the lines of a journal, in order, which loads a page at a time.
pub struct JournalReader {
    store: Store,
    swarm: String,
    after: u64,
    until: Option<u64>,
    page: vec::IntoIter<Row>,
    damaged_at: Option<u64>,
    is_last_page: bool,
}

impl JournalReader {
    /// The lines after line `after`: all of them, or up to line `until`.
    pub fn new(store: &Store, swarm: &str, after: u64, until: Option<u64>) -> Self {
        JournalReader {
            store: store.clone(),
            swarm: swarm.to_owned(),
            after,
            until,
            page: Vec::new().into_iter(),
            damaged_at: None,
            is_last_page: false,
        }
    }

    fn load_page(&mut self) -> Result<(), LineError> {
        let rows = self.store.rows(&self.swarm, self.after, PAGE_LINES)?;
        self.is_last_page = rows.rows.len() < PAGE_LINES;
        self.damaged_at = rows.damaged_at;
        self.page = rows.rows.into_iter();
        Ok(())
    }

    fn read(&mut self) -> Result<Option<ReplayEntry>, LineError> {
        let number = self.after + 1;
        if self.until.is_some_and(|until| until < number) {
            return Ok(None);
        }
        if self.page.as_slice().is_empty() && self.damaged_at.is_none() && !self.is_last_page {
            self.load_page()?;
        }
        let damaged = |problem| LineError::Damaged { number, problem };
        match self.page.next() {
            Some(row) if row.number == number => {
                self.after = number;
                parse_line(&row).map(Some).map_err(damaged)
            }
            Some(_) => Err(LineError::Gone(number)),
            None if self.damaged_at.is_some() => Err(damaged("its checksum is wrong".into())),
            None if self.until.is_some() => Err(LineError::Gone(number)),
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
            self.until = Some(self.after);
        }
        read.transpose()
    }
}

/// Parses a line, and its command if it records one.
pub fn parse_line(row: &Row) -> Result<ReplayEntry, String> {
    let record = durable::read_record(&row.body).map_err(|error| error.to_string())?;
    let command = match &record {
        Record::Input { sender, .. } => Some(parse_command(sender)?),
        _ => None,
    };
    let line = Line {
        number: row.number,
        epoch: row.epoch,
        step: row.step,
        record,
    };
    Ok((line, command))
}

/// Parses the command of a sender.
pub fn parse_command(sender: &Sender) -> Result<Command, String> {
    parse_request(sender).map(|command| command.order)
}

/// Parses a stored request.
pub fn parse_request(sender: &Sender) -> Result<ParsedCommand, String> {
    let args = RawValue::from_string(sender.args.clone()).map_err(|error| error.to_string())?;
    let request = Request {
        args: Some(args),
        ..Request::default()
    };
    commands::read_journaled(sender.verb, &request).map_err(|error| error.to_string())
}
