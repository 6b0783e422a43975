//! `help`: the help of a verb, or a topic.

use std::io::{self, Write as _};

use serde_json::json;

use crate::arguments::{self, HelpArguments, TOPICS};
use crate::failure::Failure;
use crate::output::Output;
use crate::suggest::did_you_mean;

/// Prints the help of a verb, a topic or the list of topics.
pub fn help(output: Output, arguments: &HelpArguments) -> Result<(), Failure> {
    if let [word] = arguments.words.as_slice() {
        let topic = TOPICS.iter().find(|it| it.name == word);
        match topic.map(|it| it.text) {
            Some(text) => return print(output, text),
            None if word == "topics" => return print(output, &arguments::topics()),
            None => {}
        }
    }
    let mut command = arguments::command();
    command.build();
    let mut verb = &mut command;
    for word in &arguments.words {
        let names: Vec<String> = verb
            .get_subcommands()
            .map(|it| it.get_name().to_owned())
            .collect();
        verb = verb
            .find_subcommand_mut(word)
            .ok_or_else(|| unknown(word, &names))?;
    }
    if output.json {
        return print(output, &verb.render_long_help().to_string());
    }
    let printed = verb.print_long_help();
    let printed = printed.and_then(|()| io::stdout().flush());
    printed.map_err(Failure::output)
}

fn print(output: Output, text: &str) -> Result<(), Failure> {
    output.print(&json!({ "help": text }), text)
}

fn unknown(word: &str, verbs: &[String]) -> Failure {
    let topics = TOPICS.iter().map(|it| it.name).chain(["topics"]);
    let question = did_you_mean(word, verbs.iter().map(String::as_str).chain(topics));
    let question = question.map_or_else(String::new, |question| question + " ");
    Failure::argument(
        "VERB|TOPIC",
        format!(
            "unknown verb or topic `{word}`: {question}`jostle --help` lists the verbs, `jostle \
             help topics` the topics"
        ),
    )
}
