//! `join`: registers a controller.

use jostle_proto::verbs::JoinArgs;

use crate::convert;
use crate::convert::commands::{CommandError, check_name};
use crate::swarm::command::Command;
use crate::swarm::membership;
use crate::swarm::membership::JoinOptions;
use jostle_convert::WireError;

/// Converts the arguments.
///
/// # Errors
///
/// [`CommandError`] for an invalid name or selection, or a deadline out of range.
pub fn order(args: JoinArgs) -> Result<Command, CommandError> {
    let JoinArgs {
        controller,
        select,
        mode,
        deadline_secs,
        on_timeout,
        driving,
        again,
    } = args;
    check_name("controller", &controller)?;
    let Some(deadline) = membership::deadline(deadline_secs) else {
        return Err(WireError::out_of_range("deadline_secs", deadline_secs).into());
    };
    Ok(Command::Join(JoinOptions {
        controller,
        selection: select.map(jostle_convert::change::selection).transpose()?,
        mode: convert::mode(mode),
        deadline,
        on_timeout: convert::on_timeout(on_timeout),
        driving,
        again,
    }))
}
