//! `step`: takes steps as fast as possible, and replies after the last.

use jostle_proto::verbs::{Return, StepArgs};

use crate::convert::commands::CommandError;
use crate::swarm::command::Command;
use jostle_convert::WireError;

/// Maximum steps of one command.
const MAX_STEPS: u64 = 1_000_000_000;

/// Converts the arguments.
///
/// # Errors
///
/// [`WireError::OutOfRange`].
pub fn order(args: StepArgs) -> Result<Command, CommandError> {
    count(args.steps).map(Command::Step)
}

/// Checks the number of steps.
///
/// # Errors
///
/// [`WireError::OutOfRange`].
pub fn count(steps: u64) -> Result<u64, CommandError> {
    if (1..=MAX_STEPS).contains(&steps) {
        return Ok(steps);
    }
    Err(WireError::out_of_range("steps", steps).into())
}

/// Whether the reply contains the state.
pub fn returns_state(args: StepArgs) -> bool {
    args.return_ == Return::State
}
