//! `batch`: several changes at one step, or none of them.

use jostle_proto::verbs::{BatchArgs, Change};

use crate::command::{CommandError, inform, inject, remove, set, uninform};
use crate::swarm::order::Order;

/// Makes several changes.
///
/// # Errors
///
/// [`CommandError`] names the first field that is wrong, by its path.
pub fn order(args: BatchArgs) -> Result<Order, CommandError> {
    // Reading stops at one too many.
    if args.commands.is_empty() {
        return Err(CommandError::Field {
            field: "commands",
            problem: "holds none: give at least one",
        });
    }
    let mut changes = Vec::with_capacity(args.commands.len());
    for (index, change) in args.commands.into_iter().enumerate() {
        let order = match change {
            Change::Set(args) => set::order(args),
            Change::Inform(args) => inform::order(args),
            Change::Uninform(args) => uninform::order(args),
            Change::Inject(args) => inject::order(args),
            Change::Remove(args) => remove::order(args),
        };
        let within = |error: CommandError| error.within(format!("commands[{index}].args"));
        match order.map_err(within)? {
            Order::Change(change) => changes.push(change),
            _ => unreachable!("what changes is a change"),
        }
    }
    Ok(Order::Batch(changes))
}
