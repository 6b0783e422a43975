//! `set`: new values of the parameters named, and of no others.

use jostle_proto::verbs::SetArgs;

use crate::command::CommandError;
use crate::swarm::order::{Change, Order, Settings};
use crate::wire;

/// Changes parameters.
///
/// # Errors
///
/// [`CommandError`] when none is named, or `make_room` without `pi1`. Ranges are the swarm's to
/// check: what fits depends on who is in it.
pub fn order(args: SetArgs) -> Result<Order, CommandError> {
    let SetArgs {
        pi1,
        pi2,
        pi3,
        pi4,
        publish_every,
        make_room,
    } = args;
    if make_room && pi1.is_none() {
        return Err(CommandError::Field {
            field: "make_room",
            problem: "goes with a new pi1: name both",
        });
    }
    let numbers = [pi1, pi2, pi3, pi4];
    if numbers.iter().all(Option::is_none) && publish_every.is_none() {
        return Err(CommandError::Field {
            field: "args",
            problem: "names nothing to set: give pi1, pi2, pi3, pi4 or publish_every",
        });
    }
    let publish_every = publish_every.map(wire::publish_every).transpose()?;
    Ok(Order::Change(Change::Set(Settings {
        pi1,
        pi2,
        pi3,
        pi4,
        publish_every,
        make_room,
    })))
}
