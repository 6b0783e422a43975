//! `set`: changes parameters.

use jostle_proto::RequestError;

use crate::convert::commands::CommandError;

/// Parameters of a spec that cannot change.
const CHOSEN_AT_CREATION: [&str; 4] = ["n", "dt", "seed", "start"];

/// Returns an error with the alternatives for parameters that cannot change.
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
