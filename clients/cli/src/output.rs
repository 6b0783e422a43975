//! Data on stdout, talk on stderr; with `--json` both are JSON.

use std::io::{self, IsTerminal, Write};
use std::process::ExitCode;

use serde_json::json;

use crate::failure::Failure;

/// How to speak.
#[derive(Clone, Copy, Debug)]
pub struct Output {
    /// For programs rather than for people.
    pub json: bool,
}

impl Output {
    /// Writes data, a line or several, to stdout.
    ///
    /// # Errors
    ///
    /// Those of [`write()`].
    pub fn data(self, text: &str) -> Result<(), Failure> {
        write(&format!("{text}\n"))
    }

    /// Says something to whoever looks on.
    pub fn note(self, text: &str) {
        if self.json {
            complain(&json!({ "note": text }).to_string());
        } else {
            complain(text);
        }
    }

    /// Says why it failed and returns what the process ends with.
    pub fn failure(self, failure: &Failure) -> ExitCode {
        match failure {
            Failure::Pipe => {}
            _ if self.json => complain(&failure.to_json().to_string()),
            // Whoever pressed Ctrl-C knows.
            Failure::Interrupted { left: None } => {}
            _ => complain(&format!("jostle: {failure}")),
        }
        ExitCode::from(failure.exit_code())
    }
}

/// Says what is wrong with the command line, or helps, and returns what the process ends with.
pub fn usage(error: &clap::Error) -> ExitCode {
    if error.use_stderr() && std::env::args_os().any(|argument| argument == "--json") {
        let message = error.to_string();
        let message = message.trim().trim_start_matches("error: ");
        complain(
            &json!({
                "code": "invalid_argument",
                "message": message,
                "details": {},
                "step": null,
            })
            .to_string(),
        );
    } else {
        // `jostle --help | head -1` is no reason to complain.
        let _ = error.print();
    }
    ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2))
}

/// Writes to stdout, at once.
///
/// # Errors
///
/// [`Failure::Pipe`] when nobody reads on, [`Failure::Output`] when it cannot be written.
pub fn write(text: &str) -> Result<(), Failure> {
    let mut stdout = io::stdout().lock();
    stdout
        .write_all(text.as_bytes())
        .and_then(|()| stdout.flush())
        .map_err(|error| match error.kind() {
            io::ErrorKind::BrokenPipe => Failure::Pipe,
            _ => Failure::Output(error),
        })
}

/// Tells whether data goes to a terminal that can move its cursor.
pub fn is_terminal() -> bool {
    io::stdout().is_terminal() && std::env::var_os("TERM").is_some_and(|term| term != "dumb")
}

/// Writes a line to stderr; if even that fails there is nobody left to tell.
fn complain(line: &str) {
    let _ = writeln!(io::stderr().lock(), "{line}");
}
