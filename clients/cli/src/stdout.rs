//! What standard output is.

use std::io::{self, IsTerminal};

/// Whether stdout is a terminal that can move its cursor.
pub fn is_terminal() -> bool {
    io::stdout().is_terminal() && std::env::var_os("TERM").is_some_and(|term| term != "dumb")
}
