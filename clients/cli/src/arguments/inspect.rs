//! The arguments of the verbs that only read.

use std::path::PathBuf;

use clap::builder::PossibleValuesParser;
use clap::{Args, ValueEnum, ValueHint};
use clap_complete::engine::ArgValueCompleter;

use crate::arguments::FilterArguments;
use crate::completion;
use crate::instant;
use crate::values;

#[derive(Debug, Args)]
pub struct TopArguments {
    #[command(flatten)]
    pub filter: FilterArguments,
    /// End after this many screens [default with --json: 1]
    #[arg(short = 'n', long, value_parser = values::positive, allow_negative_numbers = true)]
    pub count: Option<u64>,
    /// The time between two screens
    #[arg(long, value_name = "SECS", value_parser = values::seconds, default_value = "1", allow_negative_numbers = true)]
    pub interval: f64,
    /// The order of the swarms, not with --json [default: cost]
    #[arg(long, value_enum)]
    pub sort: Option<Sort>,
}

/// The orders of `top --sort`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Sort {
    /// By CPU time, the most first
    #[default]
    Cost,
    /// By the reached share of their rate, the least first; then by real-time factor
    Factor,
    /// By name
    Name,
}

#[derive(Debug, Args)]
pub struct MeasuresArguments {
    /// The swarm [default: lists all measures]
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: Option<String>,
    /// The measures, such as order or 'clusters.count(0.1)' [default: all of one state]
    #[arg(value_name = "MEASURE", add = ArgValueCompleter::new(completion::measures))]
    pub measures: Vec<String>,
    /// Print a histogram instead: pair_correlation or neighbour_density
    #[arg(long, value_name = "NAME", requires = "name", conflicts_with_all = ["measures", "list"], value_parser = PossibleValuesParser::new(["pair_correlation", "neighbour_density"]))]
    pub histogram: Option<String>,
    /// With --histogram: bins of an axis [default: 50]
    #[arg(long, requires = "histogram", value_name = "COUNT", value_parser = values::positive, allow_negative_numbers = true)]
    pub bins: Option<u64>,
    /// With --histogram: the largest distance, body sizes [default: 10]
    #[arg(long, requires = "histogram", value_name = "LENGTH", value_parser = values::number, allow_hyphen_values = true)]
    pub max: Option<f64>,
    /// List all measures: units, ranges, definitions
    #[arg(long, conflicts_with = "name")]
    pub list: bool,
}

#[derive(Debug, Args)]
pub struct JournalArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// Only commands with a higher seq
    #[arg(long, value_name = "SEQ", value_parser = values::whole, default_value = "0", hide_default_value = true, allow_negative_numbers = true)]
    pub after: u64,
    /// Only commands applied at this step or later, of any epoch
    #[arg(long, value_name = "STEP", value_parser = values::whole, allow_negative_numbers = true)]
    pub from_step: Option<u64>,
    /// Only commands applied at this step or earlier, of any epoch
    #[arg(long, value_name = "STEP", value_parser = values::whole, allow_negative_numbers = true)]
    pub to_step: Option<u64>,
    /// Only commands with this verb
    #[arg(long, value_parser = values::parameter, add = ArgValueCompleter::new(completion::verbs_of_swarms))]
    pub verb: Option<String>,
    /// Only commands of this client, or of all clients of this user
    #[arg(long, value_parser = values::parameter)]
    pub client: Option<String>,
    /// Only the newest ones, up to this many [default: all, with --json 1000]
    #[arg(long, value_name = "COUNT", value_parser = values::count, allow_negative_numbers = true)]
    pub limit: Option<usize>,
    /// All commands with --json, too
    #[arg(long, conflicts_with = "limit")]
    pub all: bool,
    /// Print the file of an experiment, TOML, whose run repeats the commands since the swarm's start
    #[arg(long, conflicts_with_all = ["after", "from_step", "to_step", "verb", "client", "limit", "all"])]
    pub as_experiment: bool,
    /// Give the experiment so many runs, with other seeds than the swarm
    #[arg(long, value_name = "COUNT", value_parser = values::positive, requires = "as_experiment", allow_negative_numbers = true)]
    pub replicates: Option<u64>,
    /// Write the file, such as found.toml, and the set-points of controllers to found.setpoints.csv
    #[arg(short = 'o', long, value_name = "FILE", requires = "as_experiment", value_hint = ValueHint::FilePath)]
    pub out: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct AuditArguments {
    /// Only commands of this user; `-` for those of nobody known
    #[arg(long, value_parser = values::parameter)]
    pub user: Option<String>,
    /// Only commands of the client that gives itself this name
    #[arg(long, value_parser = values::parameter)]
    pub client: Option<String>,
    /// Only commands with this verb, such as delete or experiment
    #[arg(long, value_parser = values::parameter, add = ArgValueCompleter::new(completion::verbs))]
    pub verb: Option<String>,
    /// Only commands on the swarm, experiment or recording of this name
    #[arg(long, value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: Option<String>,
    /// Only commands since this time: so long ago, such as 2h or 3d, or a time in UTC, such as
    /// 2026-11-28T07:00
    #[arg(long, value_name = "TIME", value_parser = instant::parse)]
    pub since: Option<f64>,
    /// Only commands until this time, in the same forms
    #[arg(long, value_name = "TIME", value_parser = instant::parse)]
    pub until: Option<f64>,
    /// Only the newest lines, up to this many [default: 100]
    #[arg(long, value_name = "COUNT", value_parser = values::count, allow_negative_numbers = true)]
    pub limit: Option<usize>,
    /// All lines that the daemon keeps
    #[arg(long, conflicts_with = "limit")]
    pub all: bool,
}

#[derive(Debug, Args)]
pub struct EventsArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// Only events with a higher number
    #[arg(long, value_name = "NUMBER", value_parser = values::whole, default_value = "0", hide_default_value = true, allow_negative_numbers = true)]
    pub after: u64,
    /// Of the past events only the newest, up to this many
    #[arg(long, value_name = "COUNT", value_parser = values::count, allow_negative_numbers = true)]
    pub limit: Option<usize>,
    /// Follow new events until the swarm is deleted
    #[arg(short, long)]
    pub follow: bool,
}

#[derive(Debug, Args)]
pub struct WatchArguments {
    /// The swarm; may be omitted on a terminal, which shows all
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: Option<String>,
    /// Print complete states as JSON Lines instead
    #[arg(long)]
    pub frames: bool,
    /// Print lines, and end after this many samples, states or lines
    #[arg(long, value_parser = values::positive, allow_negative_numbers = true)]
    pub count: Option<u64>,
    /// End after this long
    #[arg(long = "for", value_name = "SECS", value_parser = values::seconds, allow_negative_numbers = true)]
    pub for_secs: Option<f64>,
}

#[derive(Debug, Args)]
pub struct SchemaArguments {
    /// The message, such as step.args, a verb, or experiment.file, which needs no daemon [default: lists
    /// all messages]
    #[arg(add = ArgValueCompleter::new(completion::messages))]
    pub message: Option<String>,
}

#[derive(Debug, Args)]
pub struct CompletionsArguments {
    /// The shell
    #[arg(value_parser = PossibleValuesParser::new(completion::SHELLS))]
    pub shell: String,
}

#[derive(Debug, Args)]
pub struct ManArguments {
    /// Print the page of this verb, such as `experiment run`
    #[arg(conflicts_with = "out", value_name = "VERB")]
    pub verb: Vec<String>,
    /// Write a page for each verb into this folder
    #[arg(short, long, value_name = "FOLDER", value_hint = ValueHint::DirPath)]
    pub out: Option<PathBuf>,
}
