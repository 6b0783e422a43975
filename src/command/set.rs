//! `set`: new values of the parameters named, and of no others.

use jostle_proto::RequestError;
use jostle_proto::verbs::SetArgs;

use crate::command::CommandError;
use crate::swarm::order::{Change, Order, Settings};
use crate::wire;

/// What is chosen when a swarm is created, and stays.
const CHOSEN_AT_CREATION: [&str; 4] = ["n", "dt", "seed", "start"];

/// Says what to do instead for fields that are chosen when a swarm is created.
pub fn explain(error: RequestError) -> CommandError {
    let field = CHOSEN_AT_CREATION
        .iter()
        .find(|field| **field == error.field && error.problem.starts_with("unknown field"));
    match field {
        Some(field) => CommandError::Field {
            field,
            problem: "is chosen at creation and never set: create a swarm with it, or give \
                      reset a new seed; inject and remove change how many there are",
        },
        None => error.into(),
    }
}

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
        contacts,
        stepping,
        relinearise,
        attraction,
        noise,
        publish_every,
        make_room,
    } = args;
    if make_room && pi1.is_none() {
        return Err(CommandError::Field {
            field: "make_room",
            problem: "goes with a new pi1: name both",
        });
    }
    if args == SetArgs::default() {
        return Err(CommandError::Field {
            field: "args",
            problem: "names nothing to set: give pi1, pi2, pi3, pi4, contacts, stepping, \
                      relinearise, attraction, noise or publish_every",
        });
    }
    let publish_every = publish_every.map(wire::publish_every).transpose()?;
    Ok(Order::Change(Change::Set(Settings {
        pi1,
        pi2,
        pi3,
        pi4,
        contacts: contacts.map(wire::contact_rule),
        stepping: stepping.map(wire::stepping),
        relinearise: relinearise.map(wire::relinearise).transpose()?,
        attraction: attraction.map(wire::attraction),
        noise,
        publish_every,
        make_room,
    })))
}
