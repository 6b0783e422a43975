//! The arguments of the verbs about recordings.

use std::path::PathBuf;

use clap::{Args, ValueEnum, ValueHint};
use clap_complete::engine::ArgValueCompleter;

use crate::arguments::SenderArguments;
use crate::completion;
use crate::values;

/// What to record where, and for how long.
#[derive(Debug, Args)]
pub struct RecordArguments {
    /// The swarm
    #[arg(required_unless_present_any = ["list", "stop", "delete"], value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: Option<String>,
    /// The file: .parquet for data frames, .mcap for what was published as it was
    #[arg(short, long, value_name = "FILE", value_hint = ValueHint::FilePath, required_unless_present_any = ["at_daemon", "list", "stop", "delete"], conflicts_with_all = ["at_daemon", "as_name", "format", "list", "stop", "delete", "request_id", "client"])]
    pub out: Option<PathBuf>,
    /// Of the published states only such as are at least so many steps apart
    #[arg(long, value_name = "STEPS", value_parser = clap::value_parser!(u64).range(1..), allow_negative_numbers = true)]
    pub every: Option<u64>,
    /// End after this long [default: at Ctrl-C, or when the swarm is deleted]
    #[arg(long = "for", value_name = "SECS", value_parser = values::seconds, allow_negative_numbers = true)]
    pub for_secs: Option<f64>,
    /// End when the swarm has gone so many steps
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..), allow_negative_numbers = true)]
    pub steps: Option<u64>,
    /// Replace a file that is there
    #[arg(long)]
    pub force: bool,
    /// Have the daemon record into its data directory, whoever looks on, until it is stopped or
    /// the swarm is deleted
    #[arg(long, help_heading = AT_DAEMON, conflicts_with_all = ["for_secs", "steps", "force"])]
    pub at_daemon: bool,
    /// What to call the daemon's recording [default: the swarm's name and a number]
    #[arg(long = "as", value_name = "NAME", help_heading = AT_DAEMON, requires = "at_daemon", value_parser = values::name)]
    pub as_name: Option<String>,
    /// How the daemon writes it [default: mcap]
    #[arg(long, help_heading = AT_DAEMON, requires = "at_daemon")]
    pub format: Option<RecordedAs>,
    /// List the daemon's recordings and how they stand
    #[arg(long, help_heading = AT_DAEMON, conflicts_with_all = ["name", "every", "for_secs", "steps", "force", "at_daemon", "stop", "delete", "request_id", "client"])]
    pub list: bool,
    /// End one of the daemon's recordings; what was recorded is kept
    #[arg(long, value_name = "NAME", help_heading = AT_DAEMON, conflicts_with_all = ["name", "every", "for_secs", "steps", "force", "at_daemon", "delete"], value_parser = values::name, add = ArgValueCompleter::new(completion::recordings))]
    pub stop: Option<String>,
    /// Remove one of the daemon's recordings with its files; one that goes on is ended
    #[arg(long, value_name = "NAME", help_heading = AT_DAEMON, conflicts_with_all = ["name", "every", "for_secs", "steps", "force", "at_daemon"], value_parser = values::name, add = ArgValueCompleter::new(completion::recordings))]
    pub delete: Option<String>,
    /// Who sends it.
    #[command(flatten)]
    pub sender: SenderArguments,
}

/// Above the options of what the daemon records.
const AT_DAEMON: &str = "Recordings of the daemon";

/// How a daemon writes a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum RecordedAs {
    /// What was published as it was
    Mcap,
    /// A table for data frames
    Parquet,
}
