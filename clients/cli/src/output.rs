//! Data on stdout, notes and errors on stderr; with `--json` both are JSON.

use std::io::{self, Write};
use std::process::ExitCode;

use jostle_client::Payload;
use jostle_experiment::stdout;
use jostle_proto::Reply;
use jostle_proto::verbs::Scheduled;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::json;

use crate::failure::{Failure, Kind};
use crate::format;
use crate::table::{self, Column};

/// The form of the output.
#[derive(Clone, Copy, Debug)]
pub struct Output {
    /// JSON instead of text.
    pub json: bool,
}

impl Output {
    /// Writes lines to stdout.
    pub fn data(self, text: &str) -> Result<(), Failure> {
        write(&format!("{text}\n"))
    }

    /// Writes a line of JSON to stdout.
    pub fn document(self, document: &impl Serialize) -> Result<(), Failure> {
        self.data(&serde_json::to_string(document).map_err(Failure::defect)?)
    }

    /// Writes a document, or with text output what describes it.
    pub fn print(self, document: &impl Serialize, text: &str) -> Result<(), Failure> {
        match self.json {
            true => self.document(document),
            false => self.data(text),
        }
    }

    /// Writes a reply as received, or as `describe` formats it.
    pub fn reply<T: DeserializeOwned>(
        self,
        reply: &Payload,
        describe: impl FnOnce(&T) -> String,
    ) -> Result<(), Failure> {
        match self.json {
            true => self.data(reply.json()?),
            false => self.data(&describe(&reply.read()?)),
        }
    }

    /// Writes the reply to a command as received, as scheduled, or as `describe` formats it.
    pub fn outcome<T: DeserializeOwned>(
        self,
        reply: &Payload,
        verb: &str,
        describe: impl FnOnce(&Reply<T>) -> String,
    ) -> Result<(), Failure> {
        match scheduled(reply) {
            Some(reply) if !self.json => self.data(&format!(
                "{verb} will be applied at step {}; {}",
                reply.result.applies_at_step,
                format::standing(&reply)
            )),
            _ => self.reply(reply, describe),
        }
    }

    /// Writes a reply as received, or its `rows` as a table; if there are none, writes a note.
    pub fn list<T, const COLUMNS: usize>(
        self,
        reply: &Payload,
        rows: &[T],
        columns: [Column<T>; COLUMNS],
        if_empty: &str,
    ) -> Result<(), Failure> {
        if self.json {
            return self.data(reply.json()?);
        }
        if rows.is_empty() {
            self.note(if_empty);
            return Ok(());
        }
        self.data(&table::of(rows, columns))
    }

    /// Writes a note to stderr.
    pub fn note(self, text: &str) {
        if self.json {
            write_stderr(&json!({ "note": text }).to_string());
        } else {
            write_stderr(text);
        }
    }

    /// Writes the error to stderr and returns the exit code.
    pub fn failure(self, failure: &Failure) -> ExitCode {
        match failure.kind {
            Kind::BrokenPipe => {}
            _ if self.json => write_stderr(&failure.to_json().to_string()),
            // The user pressed Ctrl-C and needs no message.
            Kind::Interrupted => {}
            _ => write_stderr(&format!("jostle: {failure}")),
        }
        ExitCode::from(failure.exit_code())
    }
}

/// Prints an error of the command line, or the help, and returns the exit code.
pub fn usage(error: &clap::Error) -> ExitCode {
    if error.use_stderr() && std::env::args_os().any(|argument| argument == "--json") {
        let message = error.to_string();
        let message = message.trim().trim_start_matches("error: ");
        write_stderr(
            &Failure::new("invalid_argument", message)
                .to_json()
                .to_string(),
        );
    } else {
        let written = error.print().and_then(|()| io::stdout().flush());
        if !error.use_stderr()
            && let Err(error) = written
        {
            let json = std::env::args_os().any(|argument| argument == "--json");
            return Output { json }.failure(&Failure::output(error));
        }
    }
    ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2))
}

/// The reply to a scheduled command; only it has the step at which it applies.
pub fn scheduled(reply: &Payload) -> Option<Reply<Scheduled>> {
    reply.read().ok()
}

/// Writes to stdout and flushes.
pub fn write(text: &str) -> Result<(), Failure> {
    stdout::write(text.as_bytes()).map_err(Failure::output)
}

/// Writes a line to stderr; a failure cannot be reported anywhere.
fn write_stderr(line: &str) {
    let _ = writeln!(io::stderr().lock(), "{line}");
}
