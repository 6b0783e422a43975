//! `delete`: the end of a swarm.

use jostle_proto::verbs::DeleteArgs;

use crate::swarm::order::Order;

/// Ends the swarm.
pub fn order(DeleteArgs {}: DeleteArgs) -> Order {
    Order::Delete
}
