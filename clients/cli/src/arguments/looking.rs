//! The arguments of the verbs that only look.

use std::path::PathBuf;

use clap::builder::PossibleValuesParser;
use clap::{Args, Subcommand, ValueEnum, ValueHint};
use clap_complete::engine::ArgValueCompleter;

use crate::completion;
use crate::values;

/// What there is to look at, once or again and again.
#[derive(Debug, Subcommand)]
pub enum Look {
    /// Lists the swarms of a daemon
    List(RepeatArguments),
    /// Shows how a swarm is doing
    Status(LookArguments),
    /// Shows a swarm's parameters: values, ranges, units, and which verb changes them
    Parameters(LookArguments),
    /// Shows the controllers of a swarm, and for whom it waits
    Controllers(LookArguments),
    /// Prints what a swarm was made from, as `create --spec` reads it
    Spec(LookArguments),
    /// Shows the commands a swarm has applied
    Journal(JournalArguments),
    /// Lists the daemons that are reached here
    Nodes(RepeatArguments),
    /// Shows live what a daemon and its swarms cost and how fast they are
    Top(TopArguments),
}

impl Look {
    /// How many seconds to rest before looking again; none to look once.
    pub fn every_secs(&self) -> Option<f64> {
        match self {
            Look::List(repeat) | Look::Nodes(repeat) => repeat.watch,
            Look::Status(look)
            | Look::Parameters(look)
            | Look::Controllers(look)
            | Look::Spec(look) => look.repeat.watch,
            Look::Journal(journal) => journal.repeat.watch,
            Look::Top(top) => Some(top.interval),
        }
    }

    /// How often to look; none without an end.
    pub fn count(&self) -> Option<u64> {
        match self {
            Look::Top(top) => top.count,
            _ => None,
        }
    }
}

/// Whether to look again.
#[derive(Debug, Args)]
pub struct RepeatArguments {
    /// Look again every so often, 1 s if not said; in place on a terminal
    #[arg(
        short,
        long,
        value_name = "SECS",
        num_args = 0..=1,
        default_missing_value = "1",
        value_parser = values::seconds,
        allow_negative_numbers = true
    )]
    pub watch: Option<f64>,
}

/// What of a daemon to show live, and how often.
#[derive(Debug, Args)]
pub struct TopArguments {
    /// End after so many looks
    #[arg(short = 'n', long, value_parser = clap::value_parser!(u64).range(1..), allow_negative_numbers = true)]
    pub count: Option<u64>,
    /// Look every so often
    #[arg(long, value_name = "SECS", value_parser = values::seconds, default_value = "1", allow_negative_numbers = true)]
    pub interval: f64,
    /// What comes first
    #[arg(long, value_enum, default_value_t)]
    pub sort: Sort,
}

/// Which swarms come first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Sort {
    /// Those that compute most
    #[default]
    Cost,
    /// Those that fall farthest behind their rate, then by real-time factor
    Factor,
    /// By name
    Name,
}

/// A swarm to look at.
#[derive(Debug, Args)]
pub struct LookArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// Whether to look again.
    #[command(flatten)]
    pub repeat: RepeatArguments,
}

/// Which commands of a swarm to show.
#[derive(Debug, Args)]
pub struct JournalArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// Only commands with a higher seq
    #[arg(long, value_name = "SEQ", value_parser = values::whole, default_value = "0", hide_default_value = true, allow_negative_numbers = true)]
    pub after: u64,
    /// Only the newest so many of them
    #[arg(long, value_name = "COUNT", value_parser = values::count, allow_negative_numbers = true)]
    pub limit: Option<usize>,
    /// Whether to look again.
    #[command(flatten)]
    pub repeat: RepeatArguments,
}

/// Which events of a swarm to show.
#[derive(Debug, Args)]
pub struct EventsArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// Only events with a higher number
    #[arg(long, value_name = "NUMBER", value_parser = values::whole, default_value = "0", hide_default_value = true, allow_negative_numbers = true)]
    pub after: u64,
    /// Of those that are past only the newest so many
    #[arg(long, value_name = "COUNT", value_parser = values::count, allow_negative_numbers = true)]
    pub limit: Option<usize>,
    /// Go on with those to come, until the swarm is deleted
    #[arg(short, long)]
    pub follow: bool,
}

/// What to show live, and for how long.
#[derive(Debug, Args)]
pub struct WatchArguments {
    /// The swarm; left out on a terminal, all of them
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: Option<String>,
    /// Print whole states as JSON Lines instead
    #[arg(long)]
    pub frames: bool,
    /// Print lines, and end after this many samples, states or lines
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..), allow_negative_numbers = true)]
    pub count: Option<u64>,
    /// End after this long
    #[arg(long = "for", value_name = "SECS", value_parser = values::seconds, allow_negative_numbers = true)]
    pub for_secs: Option<f64>,
}

/// Which message to describe.
#[derive(Debug, Args)]
pub struct SchemaArguments {
    /// The message, such as step.args; left out, lists them all
    #[arg(add = ArgValueCompleter::new(completion::messages))]
    pub message: Option<String>,
}

/// Which shell to complete in.
#[derive(Debug, Args)]
pub struct CompletionsArguments {
    /// The shell
    #[arg(value_parser = PossibleValuesParser::new(completion::SHELLS))]
    pub shell: String,
}

/// Where to put the manual.
#[derive(Debug, Args)]
pub struct ManArguments {
    /// Write a page for each verb into this folder
    #[arg(short, long, value_name = "FOLDER", value_hint = ValueHint::DirPath)]
    pub out: Option<PathBuf>,
}
