//! `join`: take a controller in.

use std::time::Duration;

use jostle_proto::verbs::JoinArgs;

use crate::command::{CommandError, check_name};
use crate::swarm::control::Terms;
use crate::swarm::order::Order;
use crate::wire::{self, WireError};

/// The longest that others wait for a controller, or that its set-points hold.
const LONGEST_DEADLINE_SECS: f64 = 60.0;

/// Has a controller join.
///
/// # Errors
///
/// [`CommandError`] for a name that is none, and a deadline out of range.
pub fn order(args: JoinArgs) -> Result<Order, CommandError> {
    let JoinArgs {
        controller,
        select,
        mode,
        deadline_secs,
        on_timeout,
        again,
    } = args;
    check_name("controller", &controller)?;
    if !(deadline_secs > 0.0 && deadline_secs <= LONGEST_DEADLINE_SECS) {
        return Err(WireError::out_of_range("deadline_secs", deadline_secs).into());
    }
    Ok(Order::Join(Terms {
        controller,
        selection: select.map(wire::selection).transpose()?,
        mode: wire::mode(mode),
        deadline: Duration::from_secs_f64(deadline_secs).max(Duration::from_nanos(1)),
        on_timeout: wire::on_timeout(on_timeout),
        again,
    }))
}
