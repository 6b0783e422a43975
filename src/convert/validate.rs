//! Validates the checkpoint in a request.
//!
//! Checkpoints of the daemon itself have checksums and are trusted. A snapshot in a request has a
//! hash, but any client can compute one: what the worker and the stepper assume is checked here,
//! before a swarm is created.

use jostle_convert::SnapshotError;
use jostle_convert::snapshot;
use jostle_convert::value::rate;
use jostle_measures::MAX_PAST;
use jostle_proto::LARGEST_WHOLE;

use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::watch::{MAX_WATCHES, Waiting};

/// Checks that a swarm can be in this state.
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
    if checkpoint.seq() > LARGEST_WHOLE || checkpoint.protocol_draws > LARGEST_WHOLE {
        return impossible("it has a count that is too large".to_owned());
    }
    let at_steps = || checkpoint.scheduled.iter().map(|(at_step, _)| *at_step);
    if at_steps().any(|it| it > LARGEST_WHOLE) {
        return impossible("it has a count that is too large".to_owned());
    }
    if at_steps().any(|at_step| at_step < checkpoint.simulation.state.step) {
        return impossible("a command waits for a step that is past".to_owned());
    }
    let step = checkpoint.simulation.state.step;
    let is_early = |it: &Waiting| {
        it.first > step || it.held.steps().iter().flatten().any(|since| *since > step)
    };
    if checkpoint.watches.iter().any(is_early) {
        return impossible("a condition holds since a step that is not reached".to_owned());
    }
    if checkpoint.watches.len() > MAX_WATCHES {
        return impossible(format!("more than {MAX_WATCHES} conditions wait"));
    }
    let mut watches = checkpoint.watches.iter().enumerate();
    let is_twice = |(k, it): (usize, &Waiting)| {
        let before = &checkpoint.watches[..k];
        before.iter().any(|other| other.watch.is_same(&it.watch))
    };
    if watches.any(is_twice) {
        return impossible("a condition waits twice with the same action".to_owned());
    }
    if checkpoint.past.frames().any(|frame| frame.step > step) {
        return impossible("it has a past of steps that are not reached".to_owned());
    }
    if checkpoint.past.earlier_poses() > MAX_PAST {
        return impossible(format!("its past has more than {MAX_PAST} poses"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use jostle_proto::{Reply, Snapshot};

    use super::*;
    use crate::convert::durable;
    use crate::persistence::journal_reader::parse_command;

    fn sent() -> Checkpoint {
        let text = include_str!("../../proto/fixtures/snapshot.reply.json");
        let reply: Reply<Snapshot> = serde_json::from_str(text).unwrap();
        durable::checkpoint(&reply.result, &parse_command).unwrap()
    }

    #[test]
    fn a_snapshot_of_a_daemon_is_valid() {
        assert_eq!(check(&sent()), Ok(()));
    }

    #[test]
    fn a_snapshot_that_no_swarm_can_have_is_rejected() {
        type Change = (&'static str, fn(&mut Checkpoint));
        let changes: [Change; 4] = [
            // The other conditions of the simulation are tested in jostle-convert.
            ("finite", |it| it.simulation.means.drift = f64::INFINITY),
            ("too large", |it| it.annotations = LARGEST_WHOLE),
            ("rate", |it| it.rate = Some(0.0)),
            ("past", |it| it.simulation.state.step = 101),
        ];
        for (what, change) in changes {
            let mut checkpoint = sent();
            change(&mut checkpoint);
            let error = check(&checkpoint).unwrap_err().to_string();
            assert!(error.contains(what), "{what}: {error}");
        }
    }
}
