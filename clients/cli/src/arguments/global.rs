//! The command line as a whole: each verb offers those common options that have an effect on it.

use std::ffi::{OsStr, OsString};

use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::parser::ValueSource;
use clap::{Arg, ArgMatches, Args, Command, CommandFactory, FromArgMatches};
use clap_complete::engine::{ArgValueCompleter, CompletionCandidate};

use crate::arguments::{Arguments, EXAMPLES, GlobalArguments, TOPICS};
use crate::completion;

/// The options that several verbs have.
const OPTIONS: [&str; 6] = [
    "endpoint",
    "credentials",
    "node",
    "prefix",
    "timeout",
    "json",
];

/// The options that reach a daemon.
const CONNECTION_OPTIONS: [&str; 5] = ["endpoint", "credentials", "node", "prefix", "timeout"];

/// The longest part of a word that an error repeats.
const MAX_REPEATED_CHARS: usize = 64;

/// The verbs with requests to a daemon, which --node selects. A swarm is found by its name.
const DAEMON_VERBS: [&str; 24] = [
    "audit",
    "auth can",
    "auth link",
    "auth whoami",
    "create",
    "delete",
    "doctor",
    "experiment attach",
    "experiment cancel",
    "experiment delete",
    "experiment list",
    "experiment pause",
    "experiment play",
    "experiment results",
    "experiment resume",
    "experiment run",
    "experiment status",
    "list",
    "record",
    "replay",
    "restore",
    "schema",
    "top",
    "watch",
];

/// Whether an option has an effect on a verb, such as `experiment list`.
fn has_effect(option: &str, verb: &str) -> bool {
    match verb {
        "check" | "claims" | "completions" | "experiment plan" | "help" | "man"
        | "results merge" => !CONNECTION_OPTIONS.contains(&option),
        "auth link" => option != "json",
        verb => option != "node" || DAEMON_VERBS.contains(&verb),
    }
}

/// The command line.
pub fn command() -> Command {
    let with_nodes = |command: Command| {
        command.mut_arg("node", |it| {
            it.add(ArgValueCompleter::new(completion::nodes))
        })
    };
    let options = with_nodes(GlobalArguments::augment_args(Command::new("options")));
    let options: Vec<Arg> = options.get_arguments().cloned().collect();
    let completer = ArgValueCompleter::new(verbs_and_topics);
    let command = with_nodes(Arguments::command())
        .mut_subcommand("help", |it| it.mut_arg("words", |arg| arg.add(completer)));
    add_options(command, "", &options)
}

/// Adds to each subcommand of `command` its example, and the options that have an effect on it or on
/// one of its own subcommands.
fn add_options(command: Command, of: &str, options: &[Arg]) -> Command {
    command.mut_subcommands(|verb| {
        let name = joined(of, verb.get_name());
        let verbs: Vec<String> = match verb.has_subcommands() {
            true => verb
                .get_subcommands()
                .map(|it| joined(&name, it.get_name()))
                .collect(),
            false => vec![name.clone()],
        };
        let is_of_use = |option: &&Arg| {
            let option = option.get_id().as_str();
            verbs.iter().any(|verb| has_effect(option, verb))
        };
        let mut verb = verb.args(options.iter().filter(is_of_use).cloned());
        if let Some((_, example)) = EXAMPLES.iter().find(|(verb, _)| *verb == name) {
            let more = verb.get_after_help().map(|more| format!("\n\n{more}"));
            let example = format!("Example:\n  jostle {example}{}", more.unwrap_or_default());
            verb = verb.after_help(example);
        }
        add_options(verb, &name, options)
    })
}

/// Completes the words of `jostle help`.
fn verbs_and_topics(typed: &OsStr) -> Vec<CompletionCandidate> {
    let command = command();
    let verbs = command.get_subcommands().map(|it| it.get_name().to_owned());
    let topics = TOPICS.iter().map(|it| it.name.to_owned());
    completion::beginning_with(typed, verbs.chain(topics).chain(["topics".to_owned()]))
}

fn joined(of: &str, verb: &str) -> String {
    format!("{of} {verb}").trim_start().to_owned()
}

impl Arguments {
    /// Reads a command line.
    pub fn read(words: impl IntoIterator<Item = impl Into<OsString>>) -> Result<Self, clap::Error> {
        let mut command = command();
        let mut words: Vec<OsString> = words.into_iter().map(Into::into).collect();
        // `experiment help run` is `help experiment run`.
        if let [_, group, help, ..] = words.as_slice()
            && help == "help"
            && command
                .find_subcommand(group)
                .is_some_and(Command::has_subcommands)
        {
            words.swap(1, 2);
        }
        let matches = command
            .try_get_matches_from_mut(words.iter())
            .map_err(|error| cut(taken_by_option(&mut command, &words, error)))?;
        let read = Arguments::from_arg_matches(&matches);
        let mut arguments = read.map_err(|error| error.format(&mut command))?;
        let mut given = given(&matches);
        let (mut verb, mut level) = (String::new(), &matches);
        while let Some((name, deeper)) = level.subcommand() {
            (verb, level) = (joined(&verb, name), deeper);
            for option in self::given(level) {
                arguments.global.set(option, level);
                given.push(option);
            }
        }
        // A verb does not offer it, but it may stand before the verb.
        if let Some(option) = given.iter().find(|option| !has_effect(option, &verb)) {
            let problem = format!("--{option} has no effect on `jostle {verb}`: leave it out");
            return Err(command.error(ErrorKind::ArgumentConflict, problem));
        }
        arguments.global.is_timeout_given = given.contains(&"timeout");
        Ok(arguments)
    }
}

/// Explains the error of a missing argument if an option with an optional value took the word after it,
/// as in `when --cancel school`.
fn taken_by_option(command: &mut Command, words: &[OsString], error: clap::Error) -> clap::Error {
    let Some(ContextValue::Strings(missing)) = error.get(ContextKind::InvalidArg) else {
        return error;
    };
    let (ErrorKind::MissingRequiredArgument, [missing]) = (error.kind(), missing.as_slice()) else {
        return error;
    };
    let missing = missing.trim_matches(['<', '>']);
    let mut verb = command;
    let mut name = String::new();
    for word in words.iter().skip(1).filter_map(|word| word.to_str()) {
        if verb.find_subcommand(word).is_some() {
            name = joined(&name, word);
            let deeper = verb.find_subcommand_mut(word);
            verb = deeper.expect("it has just been found");
        }
    }
    let taken = words.windows(2).find_map(|pair| {
        let [option, value] = [pair[0].to_str()?, pair[1].to_str()?];
        let mut options = verb.get_arguments().filter(|it| {
            let values = it.get_num_args().unwrap_or_default();
            (values.min_values(), values.max_values()) == (0, 1)
        });
        let of_word = |it: &&Arg| it.get_long().is_some_and(|long| option == format!("--{long}"));
        let noun = options.find(of_word)?.get_value_names()?.first()?;
        (!value.starts_with('-')).then(|| {
            format!(
                "{missing} is missing: {value} is the {noun} of {option}; write \
                 `jostle {name} {missing} {option} {value}`, or `jostle {name} {value} {option}` if it is \
                 the {missing}"
            )
        })
    });
    match taken {
        Some(problem) => verb.error(ErrorKind::MissingRequiredArgument, problem),
        None => error,
    }
}

/// Cuts a word of the command line that an error repeats, such as a long note.
fn cut(mut error: clap::Error) -> clap::Error {
    for kind in [
        ContextKind::InvalidArg,
        ContextKind::InvalidSubcommand,
        ContextKind::InvalidValue,
    ] {
        let Some(ContextValue::String(word)) = error.get(kind) else {
            continue;
        };
        if word.chars().count() > MAX_REPEATED_CHARS {
            let start: String = word.chars().take(MAX_REPEATED_CHARS).collect();
            error.insert(kind, ContextValue::String(format!("{start}…")));
        }
    }
    error
}

impl GlobalArguments {
    /// Takes over the value of an option given after a verb.
    fn set(&mut self, option: &str, matches: &ArgMatches) {
        let text = || matches.get_one::<String>(option).cloned();
        match option {
            "endpoint" => self.endpoint = text(),
            "credentials" => self.credentials = matches.get_one(option).cloned(),
            "node" => self.node = text(),
            "prefix" => self.prefix = text().unwrap_or_default(),
            "timeout" => self.timeout = matches.get_one(option).copied().unwrap_or_default(),
            _ => self.json = matches.get_flag(option),
        }
    }
}

/// The options given on the command line, not only by the environment.
fn given(matches: &ArgMatches) -> Vec<&'static str> {
    let is_given = |option: &&str| {
        let is_known = matches.ids().any(|id| id.as_str() == *option);
        is_known && matches.value_source(option) == Some(ValueSource::CommandLine)
    };
    OPTIONS.into_iter().filter(is_given).collect()
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    fn read(line: &str) -> Result<Arguments, clap::Error> {
        Arguments::read(["jostle"].into_iter().chain(line.split(' ')))
    }

    /// Every verb without verbs of its own, by its name.
    fn verbs(command: &Command, of: &str) -> Vec<(String, Command)> {
        let below = command
            .get_subcommands()
            .filter(|it| it.get_name() != "help");
        below
            .flat_map(|verb| {
                let name = joined(of, verb.get_name());
                match verb.has_subcommands() {
                    true => verbs(verb, &name),
                    false => vec![(name, verb.clone())],
                }
            })
            .collect()
    }

    #[test]
    fn an_error_repeats_the_start_of_a_long_word() {
        let long = "x".repeat(5000);
        for words in [
            vec!["jostle", "annotate", "demo", &long],
            vec!["jostle", "status", "demo", &long],
            vec!["jostle", "annotate", "demo", "note", "--at-step", &long],
            vec!["jostle", &long],
        ] {
            let error = Arguments::read(words).unwrap_err().to_string();
            assert!(error.contains(&format!("{}…", &long[..64])), "{error}");
            assert!(error.len() < 400, "{error}");
        }
    }

    #[test]
    fn a_verb_offers_the_options_that_have_an_effect_on_it_and_no_others() {
        let mut command = command();
        command.build();
        let verbs = verbs(&command, "");
        for name in DAEMON_VERBS {
            assert!(verbs.iter().any(|(verb, _)| verb == name), "no verb {name}");
        }
        for (name, verb) in verbs {
            for option in OPTIONS {
                let mut offered = verb.get_arguments();
                assert_eq!(
                    offered.any(|it| it.get_long() == Some(option)),
                    has_effect(option, &name),
                    "{name} --{option}"
                );
            }
        }
    }

    #[test]
    fn an_option_without_effect_is_refused_wherever_it_stands() {
        for line in [
            "--node a status demo",
            "status demo --node a",
            "-e tcp/h:1 man",
            "completions bash --timeout 3",
            "--prefix a claims results",
            "auth --json link",
        ] {
            let error = read(line).unwrap_err();
            assert_eq!(error.exit_code(), 2, "{line}");
        }
        let error = read("--node a status demo").unwrap_err().to_string();
        assert!(
            error.contains("--node has no effect on `jostle status`"),
            "{error}"
        );
        for line in [
            "--node a list",
            "list --node a",
            "auth --node a whoami",
            "--json man",
        ] {
            read(line).unwrap();
        }
    }

    #[test]
    fn options_may_stand_before_and_after_a_verb_and_the_last_one_counts() {
        let before = read("-e tcp/h:1 --json --timeout 2 --prefix a status demo").unwrap();
        let after = read("status demo -e tcp/h:1 --json --timeout 2 --prefix a").unwrap();
        let last = read(
            "--timeout 7 experiment --prefix b -e tcp/h:2 --timeout 2 list --prefix a --json -e tcp/h:1",
        );
        for arguments in [before, after, last.unwrap()] {
            assert_eq!(arguments.global.endpoint.as_deref(), Some("tcp/h:1"));
            assert!(arguments.global.json);
            assert_eq!(arguments.global.timeout.to_bits(), 2.0_f64.to_bits());
            assert_eq!(arguments.global.prefix, "a");
        }
        let left_out = read("--timeout 7 status demo").unwrap();
        assert_eq!(left_out.global.timeout.to_bits(), 7.0_f64.to_bits());
    }

    #[test]
    fn verbs_and_topics_are_completed() {
        let completed = |typed: &str| {
            let candidates = verbs_and_topics(OsStr::new(typed)).into_iter();
            let words = candidates.map(|it| it.get_value().to_str().unwrap().to_owned());
            words.collect::<Vec<_>>()
        };
        assert_eq!(completed("exi"), ["exit-codes"]);
        assert_eq!(completed("top"), ["top", "topics"]);
    }
}
