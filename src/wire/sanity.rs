//! Whether a swarm that somebody sent can be one.
//!
//! What a daemon wrote down itself is under seals and trusted. A snapshot that comes in a request
//! has a hash, but anybody can compute one: what the worker and the stepper take for granted is
//! looked at here, before there is a swarm.

use jostle_proto::LARGEST_WHOLE;

use crate::swarm::checkpoint::Checkpoint;
use crate::wire::durable::DurableError;
use crate::wire::from_proto::{publish_every, rate};

/// How far from home a group may be, in units of the origin: a double holds it.
const FURTHEST: u64 = LARGEST_WHOLE;

/// Codes of contacts are below this.
const CODES: u8 = 8;

/// Checks what a swarm that was sent must keep to.
///
/// # Errors
///
/// [`DurableError::Impossible`].
pub fn check(checkpoint: &Checkpoint) -> Result<(), DurableError> {
    let impossible = |problem: &str| Err(DurableError::Impossible(problem.to_owned()));
    let Checkpoint {
        state,
        means,
        exactness,
        scheduled,
        ..
    } = checkpoint;
    let configuration = &state.configuration;
    let ids = &configuration.id;
    if ids.is_empty() {
        return impossible("it has no individuals");
    }
    if !ids.is_sorted_by(|a, b| a < b) || ids.iter().any(|id| *id >= configuration.next_id) {
        return impossible("its ids are not ascending, or not below the next one");
    }
    if configuration
        .origin
        .iter()
        .any(|it| it.unsigned_abs() > FURTHEST)
    {
        return impossible("its origin is too far out");
    }
    let columns = [
        &configuration.x,
        &configuration.y,
        &configuration.alpha,
        &configuration.weight,
        &configuration.direction,
    ];
    let residual = exactness.residual;
    let [vx, vy] = means.velocity;
    let sums = [means.order, vx, vy, means.drift, residual];
    let mut numbers = columns.into_iter().flatten().chain(&sums);
    if !numbers.all(|it| it.is_finite()) {
        return impossible("a number of it is not finite");
    }
    if configuration.weight.iter().any(|weight| *weight < 0.0) {
        return impossible("a weight of it is negative");
    }
    let told = |error: &dyn std::fmt::Display| DurableError::Impossible(error.to_string());
    state
        .parameters
        .check(configuration.largest_weight())
        .map_err(|error| told(&error))?;
    publish_every(checkpoint.publish_every).map_err(|error| told(&error))?;
    rate(checkpoint.rate).map_err(|error| told(&error))?;
    let counts = [state.step, checkpoint.seq, means.count, means.directed];
    let at_steps = scheduled.iter().map(|(at_step, _)| *at_step);
    if counts
        .into_iter()
        .chain(at_steps.clone())
        .any(|it| it > LARGEST_WHOLE)
    {
        return impossible("a count of it is too large");
    }
    if at_steps.into_iter().any(|at_step| at_step < state.step) {
        return impossible("a command waits for a step that is past");
    }
    let is_contact =
        |code: u8, multiplier: f64| code < CODES && multiplier.is_finite() && multiplier >= 0.0;
    let mut contacts = state.memory.contacts.iter();
    if !contacts.all(|it| is_contact(it.code, it.multiplier)) || !is_order(&state.memory.order) {
        return impossible("its solver remembers what cannot have been");
    }
    Ok(())
}

/// Whether each of the first whole numbers is there once.
fn is_order(order: &[u32]) -> bool {
    let mut sorted = order.to_vec();
    sorted.sort_unstable();
    sorted
        .iter()
        .zip(0..)
        .all(|(found, wanted)| *found == wanted)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use jostle_proto::{Reply, Snapshot};

    use super::*;
    use crate::swarm::order::Order;
    use crate::wire::durable;

    fn recorded() -> Checkpoint {
        let text = include_str!("../../proto/fixtures/snapshot.reply.json");
        let reply: Reply<Snapshot> = serde_json::from_str(text).unwrap();
        durable::checkpoint(&reply.result, &|_| Ok(Order::Pause)).unwrap()
    }

    #[test]
    fn what_a_daemon_told_can_be() {
        assert_eq!(check(&recorded()), Ok(()));
    }

    #[test]
    fn what_cannot_be_is_refused_whatever_its_hash() {
        type Harm = (&'static str, fn(&mut Checkpoint));
        let harms: [Harm; 14] = [
            ("individuals", |it| it.state.configuration.id.clear()),
            ("ids", |it| it.state.configuration.id.swap(0, 1)),
            ("ids", |it| it.state.configuration.next_id = 0),
            ("origin", |it| it.state.configuration.origin[1] = i64::MIN),
            ("finite", |it| it.state.configuration.x[0] = f64::NAN),
            ("finite", |it| it.means.drift = f64::INFINITY),
            ("weight", |it| it.state.configuration.weight[0] = -1.0),
            ("pi1", |it| it.state.parameters.pi1 = 99.0),
            ("publish_every", |it| it.publish_every = 0),
            ("rate", |it| it.rate = Some(0.0)),
            ("count", |it| it.state.step = u64::MAX),
            ("past", |it| it.state.step = 101),
            ("solver", |it| it.state.memory.order[0] = 99),
            ("solver", |it| it.state.memory.contacts[0].code = 8),
        ];
        for (what, harm) in harms {
            let mut checkpoint = recorded();
            harm(&mut checkpoint);
            let error = check(&checkpoint).unwrap_err().to_string();
            assert!(error.contains(what), "{what}: {error}");
        }
    }
}
