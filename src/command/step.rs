//! `step`: some steps on, as fast as possible, and a reply when they are taken.

use jostle_proto::verbs::{Return, StepArgs};

use crate::command::CommandError;
use crate::swarm::order::Order;
use crate::wire::WireError;

/// The most steps that one command takes.
const MOST_STEPS: u64 = 1_000_000_000;

/// Steps the swarm on.
///
/// # Errors
///
/// [`WireError::OutOfRange`].
pub fn order(args: StepArgs) -> Result<Order, CommandError> {
    if (1..=MOST_STEPS).contains(&args.steps) {
        return Ok(Order::Step(args.steps));
    }
    Err(WireError::out_of_range("steps", args.steps).into())
}

/// Whether the reply is to carry the state reached.
pub fn returns_state(args: StepArgs) -> bool {
    args.return_ == Return::State
}
