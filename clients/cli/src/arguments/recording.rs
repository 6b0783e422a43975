//! The arguments of the verbs about recordings.

use std::path::PathBuf;

use clap::{Args, ValueHint};
use clap_complete::engine::ArgValueCompleter;

use crate::completion;
use crate::values;

/// What to record where, and for how long.
#[derive(Debug, Args)]
pub struct RecordArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// The file: .parquet for data frames, .mcap for what was published as it was
    #[arg(short, long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub out: PathBuf,
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
}
