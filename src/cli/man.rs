//! `jostled man`.

use std::fs;
use std::path::Path;
use std::process::ExitCode;

use crate::cli::arguments::command_line;
use crate::cli::fail;

/// Prints the manual page, or writes a page for each command into `folder`.
pub fn manual(folder: Option<&Path>) -> ExitCode {
    let command = command_line();
    let written = match folder {
        Some(folder) => {
            fs::create_dir_all(folder).and_then(|()| clap_mangen::generate_to(command, folder))
        }
        // A closed standard output is no error.
        None => {
            let _ = clap_mangen::Man::new(command).render(&mut std::io::stdout());
            Ok(())
        }
    };
    match written {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => fail(1, &error),
    }
}
