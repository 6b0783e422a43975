//! `batch`: several changes at one step, or none of them.

use jostle_convert::change;
use jostle_proto::verbs::BatchArgs;

use crate::convert::commands::CommandError;
use crate::swarm::command::Command;

/// Makes several changes.
///
/// # Errors
///
/// [`CommandError`] names the first field that is wrong, by its path.
pub fn order(args: BatchArgs) -> Result<Command, CommandError> {
    // Reading stops at one too many.
    if args.commands.is_empty() {
        return Err(CommandError::Field {
            field: "commands",
            problem: "holds none: give at least one",
        });
    }
    let mut changes = Vec::with_capacity(args.commands.len());
    for (index, command) in args.commands.into_iter().enumerate() {
        let within = |error| CommandError::from(error).within(format!("commands[{index}].args"));
        changes.push(change::change(command).map_err(within)?);
    }
    Ok(Command::Batch(changes))
}
