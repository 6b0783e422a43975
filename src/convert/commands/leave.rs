//! `leave`: removes a controller.

use jostle_proto::verbs::LeaveArgs;

use crate::convert::commands::{CommandError, check_name};
use crate::swarm::command::Command;

/// Converts the arguments.
///
/// # Errors
///
/// [`CommandError::Name`].
pub fn order(LeaveArgs { controller }: LeaveArgs) -> Result<Command, CommandError> {
    check_name("controller", &controller)?;
    Ok(Command::Leave(controller))
}
