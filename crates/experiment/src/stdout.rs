//! Standard output of a command line.

use std::io::{self, Write as _};

use thiserror::Error;

/// Why standard output was not written.
#[derive(Debug, Error)]
pub enum StdoutError {
    /// Its reader has closed the pipe, as in `jostled man | head`: no error to a command line.
    #[error("standard output is closed")]
    Closed,
    /// Such as a full disk: a script must not take what it got for the whole output.
    #[error("failed to write to standard output: {0}")]
    Failed(io::Error),
}

impl From<io::Error> for StdoutError {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::BrokenPipe => StdoutError::Closed,
            _ => StdoutError::Failed(error),
        }
    }
}

/// Writes to standard output and flushes.
///
/// # Errors
///
/// [`StdoutError`].
pub fn write(bytes: &[u8]) -> Result<(), StdoutError> {
    let mut stdout = io::stdout().lock();
    stdout.write_all(bytes)?;
    Ok(stdout.flush()?)
}

/// Returns the error, unless the reader has closed the pipe.
///
/// # Errors
///
/// [`StdoutError::Failed`].
pub fn unless_closed(written: Result<(), StdoutError>) -> Result<(), StdoutError> {
    match written {
        Err(StdoutError::Closed) => Ok(()),
        written => written,
    }
}
