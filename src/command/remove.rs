//! `remove`: individuals leave the group.

use jostle_proto::verbs::RemoveArgs;

use crate::command::CommandError;
use crate::swarm::order::{Change, Order};
use crate::wire;

/// Takes individuals out of the group.
///
/// # Errors
///
/// [`CommandError`] names the first field that is wrong.
pub fn order(args: RemoveArgs) -> Result<Order, CommandError> {
    Ok(Order::Change(Change::Remove(wire::selection(args.select)?)))
}
