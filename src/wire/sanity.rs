//! Whether a swarm that somebody sent can be one.
//!
//! What a daemon wrote down itself is under seals and trusted. A snapshot that comes in a request
//! has a hash, but anybody can compute one: what the worker and the stepper take for granted is
//! looked at here, before there is a swarm.

use jostle_convert::SnapshotError;
use jostle_convert::snapshot;
use jostle_convert::value::rate;
use jostle_proto::LARGEST_WHOLE;

use crate::swarm::checkpoint::Checkpoint;

/// Checks what a swarm that was sent must keep to.
///
/// # Errors
///
/// [`SnapshotError::Impossible`].
pub fn check(checkpoint: &Checkpoint) -> Result<(), SnapshotError> {
    let impossible = |problem: String| Err(SnapshotError::Impossible(problem));
    snapshot::check(&checkpoint.simulation)?;
    if let Err(error) = rate(checkpoint.rate) {
        return impossible(error.to_string());
    }
    let at_steps = || checkpoint.scheduled.iter().map(|(at_step, _)| *at_step);
    if at_steps().any(|it| it > LARGEST_WHOLE) {
        return impossible("a count of it is too large".to_owned());
    }
    if at_steps().any(|at_step| at_step < checkpoint.simulation.state.step) {
        return impossible("a command waits for a step that is past".to_owned());
    }
    Ok(())
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
            ("individuals", |it| {
                it.simulation.state.configuration.id.clear()
            }),
            ("ids", |it| it.simulation.state.configuration.id.swap(0, 1)),
            ("ids", |it| it.simulation.state.configuration.next_id = 0),
            ("origin", |it| {
                it.simulation.state.configuration.origin[1] = i64::MIN
            }),
            ("finite", |it| {
                it.simulation.state.configuration.x[0] = f64::NAN
            }),
            ("finite", |it| it.simulation.means.drift = f64::INFINITY),
            ("weight", |it| {
                it.simulation.state.configuration.weight[0] = -1.0
            }),
            ("pi1", |it| it.simulation.state.parameters.pi1 = 99.0),
            ("publish_every", |it| it.simulation.publish_every = 0),
            ("rate", |it| it.rate = Some(0.0)),
            ("count", |it| it.simulation.state.step = u64::MAX),
            ("past", |it| it.simulation.state.step = 101),
            ("solver", |it| it.simulation.state.warm_start.order[0] = 99),
            ("solver", |it| {
                it.simulation.state.warm_start.contacts[0].code = 8
            }),
        ];
        for (what, harm) in harms {
            let mut checkpoint = recorded();
            harm(&mut checkpoint);
            let error = check(&checkpoint).unwrap_err().to_string();
            assert!(error.contains(what), "{what}: {error}");
        }
    }
}
