//! `leave`: let a controller go.

use jostle_proto::verbs::LeaveArgs;

use crate::convert::commands::{CommandError, check_name};
use crate::swarm::order::Order;

/// Has a controller leave.
///
/// # Errors
///
/// [`CommandError::Name`].
pub fn order(LeaveArgs { controller }: LeaveArgs) -> Result<Order, CommandError> {
    check_name("controller", &controller)?;
    Ok(Order::Leave(controller))
}
