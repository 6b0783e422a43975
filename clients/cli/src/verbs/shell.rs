//! `completions` and `man`: what a shell and `man` read.

use std::path::Path;

use clap::Command;
use clap_mangen::Man;
use serde_json::json;

use crate::arguments::{self, CompletionsArguments, ManArguments};
use crate::completion;
use crate::failure::Failure;
use crate::output::{self, Output};

/// Prints the line that makes a shell complete.
///
/// # Errors
///
/// When it cannot be written.
pub fn completions(output: Output, arguments: &CompletionsArguments) -> Result<(), Failure> {
    let shell = arguments.shell.as_str();
    let (line, file) = completion::line(shell);
    if output.json {
        return output.data(&json!({"shell": shell, "line": line, "file": file}).to_string());
    }
    if output::is_terminal() {
        output.note(&format!("put this line into {file}:"));
    }
    output.data(&line)
}

/// Prints the manual page, or writes a page for each verb.
///
/// # Errors
///
/// When they cannot be written.
pub fn man(output: Output, arguments: &ManArguments) -> Result<(), Failure> {
    let Some(directory) = &arguments.out else {
        let mut page = Vec::new();
        Man::new(command())
            .render(&mut page)
            .map_err(Failure::Output)?;
        let page = String::from_utf8_lossy(&page);
        if output.json {
            return output.data(&json!({ "page": page }).to_string());
        }
        return output::write(&page);
    };
    std::fs::create_dir_all(directory).map_err(|error| unwritable(directory, error))?;
    let mut command = command();
    command.build();
    let mut written = vec![write(Man::new(command.clone()), directory)?];
    for verb in command.get_subcommands().cloned() {
        let name = format!("jostle-{}", verb.get_name());
        for of_verb in verb.get_subcommands().filter(|it| it.get_name() != "help") {
            let name = format!("{name}-{}", of_verb.get_name());
            written.push(write(
                Man::new(of_verb.clone().display_name(name)),
                directory,
            )?);
        }
        written.push(write(Man::new(verb.display_name(name)), directory)?);
    }
    if output.json {
        return output.data(&json!({ "written": written }).to_string());
    }
    output.data(&written.join("\n"))
}

/// The command line without `help`, which has no page of its own.
fn command() -> Command {
    arguments::command().disable_help_subcommand(true)
}

#[expect(clippy::needless_pass_by_value, reason = "nobody needs it any more")]
fn write(page: Man, directory: &Path) -> Result<String, Failure> {
    page.generate_to(directory)
        .map(|path| path.display().to_string())
        .map_err(|error| unwritable(directory, error))
}

fn unwritable(path: &Path, error: std::io::Error) -> Failure {
    Failure::File {
        path: path.display().to_string(),
        error,
    }
}
