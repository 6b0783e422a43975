//! `uninform`: individuals lose the direction of their own.

use jostle_proto::verbs::UninformArgs;

use crate::command::CommandError;
use crate::swarm::order::{Change, Order};
use crate::wire;

/// Takes individuals' direction away.
///
/// # Errors
///
/// [`CommandError`] names the first field that is wrong.
pub fn order(args: UninformArgs) -> Result<Order, CommandError> {
    Ok(Order::Change(Change::Uninform(wire::selection(
        args.select,
    )?)))
}
