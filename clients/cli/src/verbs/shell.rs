//! `completions` and `man`: integration with shells and `man`.

use std::path::Path;

use clap::Command;
use clap_mangen::Man;
use serde_json::json;

use crate::arguments::{self, CompletionsArguments, ManArguments, TOPICS};
use crate::completion;
use crate::failure::Failure;
use crate::output::{self, Output};
use crate::stdout;

/// Prints the line that enables completion in a shell.
pub fn completions(output: Output, arguments: &CompletionsArguments) -> Result<(), Failure> {
    let shell = arguments.shell.as_str();
    let (line, file) = completion::line(shell);
    if stdout::is_terminal() && !output.json {
        output.note(&format!("put this line into {file}:"));
    }
    let document = json!({"shell": shell, "line": line, "file": file});
    output.print(&document, &line)
}

/// Prints the manual page, or writes a page for each verb.
pub fn man(output: Output, arguments: &ManArguments) -> Result<(), Failure> {
    let Some(directory) = &arguments.out else {
        let mut page = Vec::new();
        Man::new(of_verb(&arguments.verb)?)
            .render(&mut page)
            .map_err(Failure::output)?;
        let page = String::from_utf8_lossy(&page);
        if output.json {
            return output.document(&json!({ "page": page }));
        }
        return output::write(&page);
    };
    std::fs::create_dir_all(directory).map_err(|error| unwritable(directory, error))?;
    let mut command = command();
    command.build();
    let mut written = vec![write(Man::new(command.clone()), directory)?];
    for verb in command.get_subcommands().filter(|it| !it.is_hide_set()) {
        let name = format!("jostle-{}", verb.get_name());
        for of_verb in verb.get_subcommands() {
            let name = format!("{name}-{}", of_verb.get_name());
            written.push(write(
                Man::new(of_verb.clone().display_name(name)),
                directory,
            )?);
        }
        written.push(write(Man::new(verb.clone().display_name(name)), directory)?);
    }
    output.print(&json!({ "written": written }), &written.join("\n"))
}

/// The command line of a verb; the whole one without a verb.
fn of_verb(words: &[String]) -> Result<Command, Failure> {
    let mut command = command();
    command.build();
    let mut name = command.get_name().to_owned();
    for word in words {
        let Some(verb) = command.find_subcommand(word) else {
            let message = format!(
                "there is no verb `{}`: `jostle help` lists the verbs",
                words.join(" ")
            );
            return Err(Failure::new("invalid_argument", message));
        };
        name = format!("{name}-{}", verb.get_name());
        command = verb.clone();
    }
    Ok(command.display_name(name))
}

/// The command line with the topics of `help` in its description instead of a page of its own.
fn command() -> Command {
    let command = arguments::command().mut_subcommand("help", |it| it.hide(true));
    let overview = command
        .get_after_help()
        .map_or_else(String::new, ToString::to_string);
    let topics = TOPICS.iter().filter(|it| !overview.contains(it.text));
    let topics: String = topics
        .map(|it| format!("\n\n{}:\n{}", it.about, it.text))
        .collect();
    command.after_help(overview + &topics)
}

#[expect(clippy::needless_pass_by_value, reason = "callers are done with it")]
fn write(page: Man, directory: &Path) -> Result<String, Failure> {
    page.generate_to(directory)
        .map(|path| path.display().to_string())
        .map_err(|error| unwritable(directory, error))
}

fn unwritable(path: &Path, error: std::io::Error) -> Failure {
    Failure::file(path.display(), error)
}
