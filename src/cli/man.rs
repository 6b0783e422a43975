//! `jostled man`.

use std::fs;
use std::path::Path;
use std::process::ExitCode;

use crate::cli::arguments::command_line;
use crate::cli::{fail, print};

/// Prints the manual page, or writes a page for each command into `folder`.
pub fn manual(folder: Option<&Path>) -> ExitCode {
    let command = command_line();
    let written = match folder {
        Some(folder) => {
            fs::create_dir_all(folder).and_then(|()| clap_mangen::generate_to(command, folder))
        }
        None => {
            let mut page = Vec::new();
            let rendered = clap_mangen::Man::new(command).render(&mut page);
            return match rendered {
                Ok(()) => print(&String::from_utf8_lossy(&page)),
                Err(error) => fail(1, &error),
            };
        }
    };
    match written {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => fail(1, &error),
    }
}
