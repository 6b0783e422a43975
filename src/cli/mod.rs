//! The command line of `jostled` and the configuration of its process.

pub mod arguments;
pub mod auth;
pub mod backup;
pub mod check;
mod demo;
pub mod doctor;
mod duration;
pub mod explain;
pub mod man;
pub mod process;
pub mod run;
pub mod serve;
pub mod settings;
mod start_error;
mod systemd;
mod table;

use std::fmt::Display;
use std::io::{self, Write as _};
use std::process::ExitCode;

use jostle_experiment::stdout::{self, StdoutError};

/// Prints text; returns the exit code.
pub fn print(text: &str) -> ExitCode {
    printed(stdout::write(text.as_bytes()))
}

/// Prints the help, the version or an error of the command line; returns the exit code.
pub fn usage(error: &clap::Error) -> ExitCode {
    let written = error.print().and_then(|()| io::stdout().flush());
    match error.use_stderr() {
        true => ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2)),
        false => printed(written.map_err(StdoutError::from)),
    }
}

/// The exit code of a command whose last action is to print.
fn printed(written: Result<(), StdoutError>) -> ExitCode {
    match stdout::unless_closed(written) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => fail(1, &error),
    }
}

/// Prints an error message; returns the exit code.
pub fn fail(code: u8, error: &dyn Display) -> ExitCode {
    note(&format_args!("jostled: {error}"));
    ExitCode::from(code)
}

/// Prints a line on standard error. Its failure cannot be reported anywhere, and `eprintln` panics.
pub fn note(line: &dyn Display) {
    let _ = writeln!(io::stderr(), "{line}");
}
