//! `step`: some steps on, as fast as possible, and a reply when they are taken.

use jostle_proto::verbs::{Return, StepArgs};

use crate::convert::commands::CommandError;
use crate::swarm::command::Command;
use jostle_convert::WireError;

/// The most steps that one command takes.
const MOST_STEPS: u64 = 1_000_000_000;

/// Steps the swarm on.
///
/// # Errors
///
/// [`WireError::OutOfRange`].
pub fn order(args: StepArgs) -> Result<Command, CommandError> {
    count(args.steps).map(Command::Step)
}

/// Checks how many steps are to be taken.
///
/// # Errors
///
/// [`WireError::OutOfRange`].
pub fn count(steps: u64) -> Result<u64, CommandError> {
    if (1..=MOST_STEPS).contains(&steps) {
        return Ok(steps);
    }
    Err(WireError::out_of_range("steps", steps).into())
}

/// Whether the reply is to carry the state reached.
pub fn returns_state(args: StepArgs) -> bool {
    args.return_ == Return::State
}
