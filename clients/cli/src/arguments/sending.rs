//! How a command is sent: when it applies, what it expects and who sends it.

use clap::Args;

use crate::values;

/// How a command to a swarm is sent.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "How it is sent")]
pub struct SendingArguments {
    /// Carry it out at this step; one that lies ahead is acknowledged at once
    #[arg(long, value_name = "STEP", value_parser = values::whole, allow_negative_numbers = true)]
    pub at_step: Option<u64>,
    /// Refuse with `conflict` unless the swarm is in this epoch
    #[arg(long, value_name = "EPOCH", value_parser = values::whole, allow_negative_numbers = true)]
    pub expect_epoch: Option<u64>,
    /// Refuse with `conflict` unless the swarm is at this step
    #[arg(long, value_name = "STEP", value_parser = values::whole, allow_negative_numbers = true)]
    pub expect_step: Option<u64>,
    /// Who sends it.
    #[command(flatten)]
    pub sender: SenderArguments,
}

/// Who sends a command, and what it is called.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "How it is sent")]
pub struct SenderArguments {
    /// What to call the request; the same one again is not carried out twice [default: a new one]
    #[arg(long, value_name = "ID", value_parser = values::label)]
    pub request_id: Option<String>,
    /// Who the daemon is told has sent it, your user@host if left out
    #[arg(long, value_name = "NAME", value_parser = values::label)]
    pub client: Option<String>,
}
