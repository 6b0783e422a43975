//! `reset`: restarts from the spec, in a new epoch.

use jostle_proto::verbs::ResetArgs;

use crate::convert::commands::CommandError;
use crate::swarm::command::Command;

/// Converts the arguments.
///
/// # Errors
///
/// [`CommandError::Value`].
pub fn order(args: ResetArgs) -> Result<Command, CommandError> {
    let seed = args
        .seed
        .map(|seed| jostle_convert::value::whole("seed", seed))
        .transpose()?;
    Ok(Command::Reset(seed))
}
