//! The options that verbs have in common, each offered by the verbs on which it has an effect.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::builder::TypedValueParser as _;
use clap::error::ErrorKind;
use clap::parser::ValueSource;
use clap::{Arg, ArgMatches, Args, Command, CommandFactory, FromArgMatches};
use clap_complete::engine::ArgValueCompleter;
use jostle_proto::keys::DEFAULT_PREFIX;

use crate::arguments::Arguments;
use crate::completion;
use crate::values;

/// The names of these options.
const OPTIONS: [&str; 6] = [
    "endpoint",
    "credentials",
    "node",
    "prefix",
    "timeout",
    "json",
];

/// The options that reach a daemon.
const CONNECTION: [&str; 5] = ["endpoint", "credentials", "node", "prefix", "timeout"];

/// The verbs that send requests to a daemon rather than to a swarm, which is found by its name.
const OF_A_DAEMON: [&str; 22] = [
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

/// The options that verbs have in common.
#[derive(Debug, Args)]
#[command(next_help_heading = "Connection and output")]
pub struct GlobalArguments {
    /// Where the daemon listens [default: where the credentials say, or tcp/127.0.0.1:7447]
    #[arg(short, long, env = "JOSTLE_ENDPOINT", hide_env_values = true)]
    pub endpoint: Option<String>,
    /// Folder with your credentials, as written by `jostled auth`
    #[arg(
        long,
        env = "JOSTLE_CREDENTIALS",
        hide_env_values = true,
        value_name = "FOLDER",
        value_parser = clap::builder::OsStringValueParser::new().map(PathBuf::from),
        value_hint = clap::ValueHint::DirPath
    )]
    pub credentials: Option<PathBuf>,
    /// Which daemon, if several are reached there
    #[arg(long, value_name = "NAME", value_parser = values::name, add = ArgValueCompleter::new(completion::nodes))]
    pub node: Option<String>,
    /// The first chunk of the daemon's keys
    #[arg(long, value_name = "NAME", default_value = DEFAULT_PREFIX, value_parser = values::name)]
    pub prefix: String,
    /// How long to wait for an answer; the daemon finishes its work anyway
    #[arg(long, value_name = "SECS", default_value = "5", value_parser = values::seconds, allow_negative_numbers = true)]
    pub timeout: f64,
    /// Print replies as they came, streams as JSON Lines
    #[arg(long)]
    pub json: bool,
}

/// Whether an option has an effect on a verb, such as `experiment list`.
fn has_effect(option: &str, verb: &str) -> bool {
    match verb {
        "completions" | "man" | "claims" | "results merge" | "experiment plan" => {
            !CONNECTION.contains(&option)
        }
        "auth link" => option != "json",
        verb => option != "node" || OF_A_DAEMON.contains(&verb),
    }
}

/// The command line.
pub fn command() -> Command {
    let options = GlobalArguments::augment_args(Command::new("options"));
    let options: Vec<Arg> = options.get_arguments().cloned().collect();
    offer(Arguments::command(), "", &options)
}

/// Adds to each subcommand of `command` the options that have an effect on it or on one of its own
/// subcommands.
fn offer(command: Command, of: &str, options: &[Arg]) -> Command {
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
        let verb = verb.args(options.iter().filter(is_of_use).cloned());
        offer(verb, &name, options)
    })
}

fn joined(of: &str, verb: &str) -> String {
    format!("{of} {verb}").trim_start().to_owned()
}

impl Arguments {
    /// Reads a command line.
    ///
    /// # Errors
    ///
    /// What is wrong with it, or the help that it asks for.
    pub fn read(
        words: impl IntoIterator<Item = impl Into<OsString> + Clone>,
    ) -> Result<Self, clap::Error> {
        let mut command = command();
        let matches = command.try_get_matches_from_mut(words)?;
        let read = Arguments::from_arg_matches(&matches);
        let mut arguments = read.map_err(|error| error.format(&mut command))?;
        let mut given = given(&matches);
        let (mut verb, mut level) = (String::new(), &matches);
        while let Some((name, deeper)) = level.subcommand() {
            (verb, level) = (joined(&verb, name), deeper);
            for option in self::given(level) {
                arguments.global.take(option, level);
                given.push(option);
            }
        }
        // A verb does not offer it, but it may stand before the verb.
        if let Some(option) = given.iter().find(|option| !has_effect(option, &verb)) {
            let problem = format!("--{option} has no effect on `jostle {verb}`: leave it out");
            return Err(command.error(ErrorKind::ArgumentConflict, problem));
        }
        Ok(arguments)
    }
}

impl GlobalArguments {
    /// Takes an option as it stands after a verb.
    fn take(&mut self, option: &str, matches: &ArgMatches) {
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

/// The options that are on the command line, and not only in the environment.
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
    fn a_verb_offers_the_options_that_have_an_effect_on_it_and_no_others() {
        let mut command = command();
        command.build();
        let verbs = verbs(&command, "");
        for name in OF_A_DAEMON {
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
}
