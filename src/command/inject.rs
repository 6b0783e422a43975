//! `inject`: individuals join the group where they overlap nobody.

use jostle_proto::verbs::InjectArgs;

use crate::command::CommandError;
use crate::swarm::order::{Change, Order, Placement};
use crate::wire;

/// Adds individuals.
///
/// # Errors
///
/// [`CommandError`] when not exactly one of `count` and `at` is given, or something that does
/// not go with it.
pub fn order(args: InjectArgs) -> Result<Order, CommandError> {
    let wrong = |field, problem| Err(CommandError::Field { field, problem });
    if args.count == Some(0) || args.at.as_ref().is_some_and(Vec::is_empty) {
        let field = if args.at.is_none() { "count" } else { "at" };
        return wrong(field, "names nobody: add at least one");
    }
    let place = match (args.count, args.at, args.within) {
        (Some(_), Some(_), _) => {
            return wrong("at", "and count are both given: name one of them");
        }
        (None, None, _) => {
            return wrong("count", "or at is missing: say how many, or where exactly");
        }
        (None, Some(_), Some(_)) => return wrong("within", "goes with count: leave it out"),
        (None, Some(poses), None) => Placement::At(poses.into_iter().map(wire::pose).collect()),
        (Some(count), None, None) => Placement::Border(wire::count(count)),
        (Some(count), None, Some(region)) => {
            Placement::Within(wire::count(count), wire::region(region))
        }
    };
    let informed = match (args.direction, args.weight) {
        (None, Some(_)) => return wrong("weight", "goes with direction: give both"),
        (None, None) => None,
        (Some(direction), weight) => Some((direction, weight.map(wire::weight).transpose()?)),
    };
    Ok(Order::Change(Change::Inject { place, informed }))
}
