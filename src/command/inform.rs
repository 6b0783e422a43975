//! `inform`: individuals get a direction of their own.

use jostle_proto::verbs::InformArgs;

use crate::command::CommandError;
use crate::swarm::order::{Change, Order};
use crate::wire::{self, WireError};

/// The longest that individuals can be informed for, in time units.
const LONGEST_TIME: f64 = 1e9;

/// Informs individuals.
///
/// # Errors
///
/// [`CommandError`] names the first field that is wrong.
pub fn order(args: InformArgs) -> Result<Order, CommandError> {
    if let Some(time) = args.for_time
        && !(time > 0.0 && time <= LONGEST_TIME)
    {
        return Err(WireError::out_of_range("for_time", time).into());
    }
    Ok(Order::Change(Change::Inform {
        selection: wire::selection(args.select)?,
        direction: args.direction,
        weight: args.weight.map(wire::weight).transpose()?,
        for_time: args.for_time,
    }))
}
