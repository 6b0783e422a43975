//! The swarm and the options of a request: when it applies, its preconditions and its sender.

use clap::Args;
use clap_complete::engine::ArgValueCompleter;

use crate::completion;
use crate::values;

/// The swarm of a verb.
#[derive(Debug, Args)]
pub struct SwarmArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
}

/// A swarm, and the options of a command to it.
#[derive(Debug, Args)]
pub struct CommandArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    #[command(flatten)]
    pub sending: SendingArguments,
}

/// The options of a command to a swarm.
#[derive(Clone, Debug, Default, Args)]
pub struct SendingArguments {
    /// Apply it at this step; the daemon acknowledges a future step at once
    #[arg(long, help_heading = REQUEST, value_name = "STEP", value_parser = values::whole, allow_negative_numbers = true)]
    pub at_step: Option<u64>,
    /// Reject it with `conflict` unless the swarm is in this epoch
    #[arg(long, help_heading = REQUEST, value_name = "EPOCH", value_parser = values::whole, allow_negative_numbers = true)]
    pub expect_epoch: Option<u64>,
    /// Reject it with `conflict` unless the swarm is at this step
    #[arg(long, help_heading = REQUEST, value_name = "STEP", value_parser = values::whole, allow_negative_numbers = true)]
    pub expect_step: Option<u64>,
    #[command(flatten)]
    pub sender: SenderArguments,
}

/// The sender and the id of a request.
#[derive(Clone, Debug, Default, Args)]
pub struct SenderArguments {
    /// The id of the request; the daemon executes each id once [default: a new id]
    #[arg(long, help_heading = REQUEST, value_name = "ID", value_parser = values::label)]
    pub request_id: Option<String>,
    /// The sender, as shown in events and the journal (default: your user@host)
    #[arg(long, help_heading = REQUEST, value_name = "NAME", value_parser = values::label)]
    pub client: Option<String>,
}

/// The heading of these options. As `next_help_heading` it would also apply to the arguments after a
/// flattened struct.
const REQUEST: &str = "Request";
