//! The arguments of the verbs about recordings.

use std::path::PathBuf;

use clap::{Args, ValueHint};
use clap_complete::engine::ArgValueCompleter;

use crate::arguments::SenderArguments;
use crate::completion;
use crate::values;

#[derive(Debug, Args)]
pub struct RecordArguments {
    /// The swarm
    #[arg(required_unless_present_any = ["list", "stop", "delete", "fetch", "recover"], value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: Option<String>,
    /// The file: .parquet for data frames, .mcap for players and replays
    #[arg(short, long, value_name = "FILE", value_hint = ValueHint::FilePath, required_unless_present_any = ["at_daemon", "list", "stop", "delete", "recover"], conflicts_with_all = ["at_daemon", "as_name", "format", "list", "stop", "delete", "request_id", "client"])]
    pub out: Option<PathBuf>,
    /// Record the states whose step is a multiple of this [default: the swarm's publish_every; with
    /// --published every state that arrives]
    #[arg(long, value_name = "STEPS", value_parser = values::positive, allow_negative_numbers = true)]
    pub every: Option<u64>,
    /// Drop and count states while the daemon's disk is too slow [default: the swarm waits for the
    /// disk]
    #[arg(long)]
    pub drop_when_behind: bool,
    /// End before the recording exceeds this size, such as 500MB or 2GiB. The limit applies to the
    /// size before compression, so the file may be smaller [default: 1GiB]
    #[arg(long, value_name = "SIZE", value_parser = values::size)]
    pub max_size: Option<u64>,
    /// Record the published states on this machine, as a viewer receives them: as many as the
    /// daemon's max_hz and the network let through
    #[arg(long, requires = "out", conflicts_with_all = ["drop_when_behind", "max_size"])]
    pub published: bool,
    /// End after this long [default: at Ctrl-C, or when the swarm is deleted]
    #[arg(long = "for", value_name = "SECS", value_parser = values::seconds, allow_negative_numbers = true)]
    pub for_secs: Option<f64>,
    /// End after this many steps of the swarm
    #[arg(long, value_parser = values::positive, allow_negative_numbers = true)]
    pub steps: Option<u64>,
    /// Replace an existing file
    #[arg(long)]
    pub force: bool,
    /// Recover FILE after its recording process was killed; needs no daemon
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, conflicts_with_all = ["name", "out", "every", "drop_when_behind", "max_size", "published", "fetch", "for_secs", "steps", "at_daemon", "list", "stop", "delete", "request_id", "client"])]
    pub recover: Option<PathBuf>,
    /// Record on the daemon, into its data directory, until --stop or until the swarm is deleted
    #[arg(long, help_heading = AT_DAEMON, conflicts_with_all = ["for_secs", "force"])]
    pub at_daemon: bool,
    /// The name of the daemon's recording [default: the swarm's name and a number]
    #[arg(long = "as", value_name = "NAME", help_heading = AT_DAEMON, requires = "at_daemon", value_parser = values::name)]
    pub as_name: Option<String>,
    /// Fetch one of the daemon's recordings into -o FILE, such as one whose client was killed
    #[arg(long, value_name = "NAME", help_heading = AT_DAEMON, requires = "out", conflicts_with_all = ["name", "every", "drop_when_behind", "max_size", "published", "for_secs", "steps", "at_daemon", "list", "stop", "delete"], value_parser = values::name, add = ArgValueCompleter::new(completion::recordings))]
    pub fetch: Option<String>,
    /// List the daemon's recordings with their status
    #[arg(long, help_heading = AT_DAEMON, conflicts_with_all = ["name", "every", "drop_when_behind", "max_size", "for_secs", "steps", "force", "at_daemon", "stop", "delete", "request_id", "client"])]
    pub list: bool,
    /// End one of the daemon's recordings and keep its files
    #[arg(long, value_name = "NAME", help_heading = AT_DAEMON, conflicts_with_all = ["name", "every", "drop_when_behind", "max_size", "for_secs", "steps", "force", "at_daemon", "delete"], value_parser = values::name, add = ArgValueCompleter::new(completion::recordings))]
    pub stop: Option<String>,
    /// Delete one of the daemon's recordings with its files, also one that is running
    #[arg(long, value_name = "NAME", help_heading = AT_DAEMON, conflicts_with_all = ["name", "every", "drop_when_behind", "max_size", "for_secs", "steps", "force", "at_daemon"], value_parser = values::name, add = ArgValueCompleter::new(completion::recordings))]
    pub delete: Option<String>,
    #[command(flatten)]
    pub sender: SenderArguments,
}

/// The heading of the options about recordings of the daemon.
const AT_DAEMON: &str = "Recordings of the daemon";
