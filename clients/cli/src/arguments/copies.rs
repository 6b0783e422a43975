//! The arguments of the verbs that copy swarms and hold their pasts against each other.

use std::path::PathBuf;

use clap::{Args, ValueHint};
use clap_complete::engine::ArgValueCompleter;

use crate::arguments::SenderArguments;
use crate::completion;
use crate::values;

/// Which swarm to copy, as what.
#[derive(Debug, Args)]
pub struct ForkArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// The new swarm's name
    #[arg(value_parser = values::name)]
    pub copy: String,
    /// As it was on arriving at this step, before the commands given there [default: as it is now]
    #[arg(long, value_name = "STEP", value_parser = values::whole, allow_negative_numbers = true)]
    pub at_step: Option<u64>,
    /// Who sends it.
    #[command(flatten)]
    pub sender: SenderArguments,
}

/// Which swarms to compare.
#[derive(Debug, Args)]
pub struct DiffArguments {
    /// One swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub one: String,
    /// The other
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub other: String,
}

/// Which swarm to write where.
#[derive(Debug, Args)]
pub struct SnapshotArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// The file
    #[arg(short, long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub out: PathBuf,
    /// Replace a file that is there
    #[arg(long)]
    pub force: bool,
}

/// Which file to make a swarm from.
#[derive(Debug, Args)]
pub struct RestoreArguments {
    /// The file that `snapshot` wrote
    #[arg(value_hint = ValueHint::FilePath)]
    pub file: PathBuf,
    /// The new swarm's name [default: that of the swarm it was]
    #[arg(value_parser = values::name)]
    pub name: Option<String>,
    /// Who sends it.
    #[command(flatten)]
    pub sender: SenderArguments,
}

/// Whose past to verify.
#[derive(Debug, Args)]
pub struct VerifyArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
}
