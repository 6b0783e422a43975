//! `batch`: all of several changes at one step, or none.

use jostle_convert::change;
use jostle_proto::verbs::BatchArgs;

use crate::convert::commands::CommandError;
use crate::swarm::command::Command;

/// Converts the arguments.
///
/// # Errors
///
/// [`CommandError`] names the path of the first invalid field.
pub fn order(args: BatchArgs) -> Result<Command, CommandError> {
    // The parser rejects more than the maximum.
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
