//! `advance`: a controller lets the swarm step, as soon as every other one has too.

use jostle_convert::change::set_points;
use jostle_proto::verbs::{AdvanceArgs, Return};

use crate::convert::commands::{CommandError, check_name, step};
use crate::swarm::command::Command;

/// Has a controller advance.
///
/// # Errors
///
/// [`CommandError`] for a name that is none, steps out of range, and columns that differ in length.
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

/// Whether the reply is to carry the state reached.
pub fn returns_state(args: &AdvanceArgs) -> bool {
    args.return_ == Return::State
}
