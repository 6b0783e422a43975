//! A swarm's journal, read back from the store.

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
use crate::swarm::worker::replay::Told;

/// Lines read at once.
pub const PAGE: usize = 1000;

/// Why a line cannot be read. None after it is.
#[derive(Debug, Error)]
pub enum LineError {
    /// The store cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// It is not as it was written.
    #[error(
        "line {number} of its journal is damaged ({problem}): this is the last state that is sure; \
         reset it, or delete it and restore a snapshot"
    )]
    Damaged {
        /// Its number.
        number: u64,
        /// What is wrong.
        problem: String,
    },
    /// It has gone meanwhile.
    #[error("line {0} of its journal is no longer kept: ask again")]
    Gone(u64),
}

/// The lines after one, in order, read a page at a time.
pub struct Lines {
    store: Store,
    swarm: String,
    after: u64,
    until: Option<u64>,
    page: vec::IntoIter<Row>,
    damaged_at: Option<u64>,
    is_last_page: bool,
}

impl Lines {
    /// Those after the line `after`: all of them, or up to the line `until`.
    pub fn new(store: &Store, swarm: &str, after: u64, until: Option<u64>) -> Self {
        Lines {
            store: store.clone(),
            swarm: swarm.to_owned(),
            after,
            until,
            page: Vec::new().into_iter(),
            damaged_at: None,
            is_last_page: false,
        }
    }

    fn turn_the_page(&mut self) -> Result<(), LineError> {
        let rows = self.store.rows(&self.swarm, self.after, PAGE)?;
        self.is_last_page = rows.rows.len() < PAGE;
        self.damaged_at = rows.damaged_at;
        self.page = rows.rows.into_iter();
        Ok(())
    }

    fn read(&mut self) -> Result<Option<Told>, LineError> {
        let number = self.after + 1;
        if self.until.is_some_and(|until| until < number) {
            return Ok(None);
        }
        if self.page.as_slice().is_empty() && self.damaged_at.is_none() && !self.is_last_page {
            self.turn_the_page()?;
        }
        let damaged = |problem| LineError::Damaged { number, problem };
        match self.page.next() {
            Some(row) if row.number == number => {
                self.after = number;
                read(&row).map(Some).map_err(damaged)
            }
            Some(_) => Err(LineError::Gone(number)),
            None if self.damaged_at.is_some() => Err(damaged("it is not as it was written".into())),
            None if self.until.is_some() => Err(LineError::Gone(number)),
            None => Ok(None),
        }
    }
}

impl Iterator for Lines {
    type Item = Result<Told, LineError>;

    fn next(&mut self) -> Option<Self::Item> {
        let read = self.read();
        if read.is_err() {
            // Nothing that comes after it is sure.
            self.until = Some(self.after);
        }
        read.transpose()
    }
}

/// Reads a line; a command with what it orders.
///
/// # Errors
///
/// What is wrong with it.
pub fn read(row: &Row) -> Result<Told, String> {
    let record = durable::read_record(&row.body).map_err(|error| error.to_string())?;
    let order = match &record {
        Record::Input { sender, .. } => Some(read_order(sender)?),
        _ => None,
    };
    let line = Line {
        number: row.number,
        epoch: row.epoch,
        step: row.step,
        record,
    };
    Ok((line, order))
}

/// What a command ordered; it was read before, so it can be read again.
///
/// # Errors
///
/// What is wrong with it.
pub fn read_order(sender: &Sender) -> Result<Command, String> {
    read_command(sender).map(|command| command.order)
}

/// A command as it was sent.
///
/// # Errors
///
/// What is wrong with it.
pub fn read_command(sender: &Sender) -> Result<ParsedCommand, String> {
    let args = RawValue::from_string(sender.args.clone()).map_err(|error| error.to_string())?;
    let request = Request {
        args: Some(args),
        ..Request::default()
    };
    commands::read_again(sender.verb, &request).map_err(|error| error.to_string())
}
