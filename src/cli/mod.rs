//! The command line of `jostled` and the configuration of its process.

pub mod arguments;
pub mod auth;
pub mod backup;
mod demo;
mod duration;
pub mod explain;
pub mod man;
pub mod process;
pub mod run;
pub mod serve;
pub mod settings;
mod start_error;
mod systemd;

use std::fmt::Display;
use std::io::Write as _;
use std::process::ExitCode;

/// Prints text. A closed standard output is no error.
pub fn print(text: &str) -> ExitCode {
    let _ = std::io::stdout().write_all(text.as_bytes());
    ExitCode::SUCCESS
}

/// Prints an error message; returns the exit code.
pub fn fail(code: u8, error: &dyn Display) -> ExitCode {
    eprintln!("jostled: {error}");
    ExitCode::from(code)
}
