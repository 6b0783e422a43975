//! `advance`: a controller permits steps; the swarm takes them when all controllers have.

use jostle_convert::change::set_points;
use jostle_proto::verbs::{AdvanceArgs, Return};

use crate::convert::commands::{CommandError, check_name, step};
use crate::swarm::command::Command;

/// Converts the arguments.
///
/// # Errors
///
/// [`CommandError`] for an invalid name, a number of steps out of range, and columns of different
/// lengths.
pub fn order(args: AdvanceArgs) -> Result<Command, CommandError> {
    let AdvanceArgs {
        controller,
        steps,
        set,
        return_: _,
    } = args;
    check_name("controller", &controller)?;
    Ok(Command::Advance {
        controller,
        steps: step::count(steps)?,
        set: set.map(set_points).transpose()?,
    })
}

/// Whether the reply contains the state.
pub fn returns_state(args: &AdvanceArgs) -> bool {
    args.return_ == Return::State
}
