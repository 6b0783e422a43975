//! The arguments of the verbs about playbacks.

use std::path::PathBuf;

use clap::{Args, ValueHint};
use clap_complete::engine::ArgValueCompleter;

use crate::arguments::SenderArguments;
use crate::completion;
use crate::values::{self, Rate};

#[derive(Debug, Args)]
pub struct ReplayArguments {
    /// The recording, .mcap
    #[arg(value_hint = ValueHint::FilePath, required_unless_present = "recording")]
    pub file: Option<PathBuf>,
    /// A recording of the daemon, instead of a file
    #[arg(long, value_name = "NAME", value_parser = values::name, conflicts_with = "file")]
    pub recording: Option<String>,
    /// The name of the playback [default: the name of the file or recording]
    #[arg(long = "as", value_name = "NAME", value_parser = values::name)]
    pub name: Option<String>,
    /// Time units per second of wall clock, or max [default: the rate of the swarm when the recording
    /// began, 1 if it was max]
    #[arg(long, value_parser = values::rate, allow_negative_numbers = true)]
    pub rate: Option<Rate>,
    /// Stay at the first frame
    #[arg(long, conflicts_with = "rate")]
    pub paused: bool,
    #[command(flatten)]
    pub sender: SenderArguments,
}

#[derive(Debug, Args)]
pub struct SeekArguments {
    /// The playback
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    #[command(flatten)]
    pub place: PlaceArguments,
    #[command(flatten)]
    pub sender: SenderArguments,
}

/// A place in a recording.
#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
pub struct PlaceArguments {
    /// To the last frame up to this step of the recorded swarm
    #[arg(long, value_parser = values::whole, allow_negative_numbers = true)]
    pub step: Option<u64>,
    /// To the last frame up to this time of the recorded swarm
    #[arg(long, value_parser = values::number, allow_negative_numbers = true)]
    pub time: Option<f64>,
    /// To this share of the recording, 0 to 1 or 0% to 100%
    #[arg(long, value_name = "SHARE", value_parser = values::share, allow_hyphen_values = true)]
    pub fraction: Option<f64>,
}
