//! `reset`: back to the start, in a new epoch.

use jostle_proto::verbs::ResetArgs;

use crate::convert::commands::CommandError;
use crate::swarm::order::Order;

/// Resets the swarm.
///
/// # Errors
///
/// [`CommandError::Value`].
pub fn order(args: ResetArgs) -> Result<Order, CommandError> {
    let seed = args
        .seed
        .map(|seed| jostle_convert::value::whole("seed", seed))
        .transpose()?;
    Ok(Order::Reset(seed))
}
