//! `pause`: stand still between two steps.

use jostle_proto::verbs::PauseArgs;

use crate::swarm::order::Order;

/// Pauses the swarm.
pub fn order(PauseArgs {}: PauseArgs) -> Order {
    Order::Pause
}
