//! Replays the journal of a swarm up to a step, for forks and verification.

use crate::convert::commands::CommandError;
use crate::persistence::checkpoints::read_checkpoint;
use crate::persistence::journal_reader::JournalReader;
use crate::store::Store;
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::outcome::ReplyTo;
use crate::swarm::phase::Phase;
use crate::swarm::worker::journal_index::JournalIndex;
use crate::swarm::worker::replay::{ReplaySource, ReplayTarget};

/// The result of a replay.
pub struct Replayed {
    /// The step of the first checkpoint.
    pub from: u64,
    /// The state at the end.
    pub checkpoint: Checkpoint,
    /// How many hashes are the same as in the journal.
    pub same: u64,
    /// The first epoch and step whose hash differs.
    pub differs_at: Option<(u64, u64)>,
}

/// Replays the journal of a swarm: to a step from the last checkpoint before it, to other targets from
/// the oldest. Passes the replayed fraction of the journal, from 0 to 1, to `on_progress`.
///
/// # Errors
///
/// [`CommandError::History`] if the checkpoint or the journal is damaged or no longer stored.
pub fn replay_to(
    store: &Store,
    swarm: &str,
    target: ReplayTarget,
    on_progress: impl Fn(f64) + Clone + Send + 'static,
) -> Result<Replayed, CommandError> {
    // Waits for the queued writes. If they fail, the replay ends early, which is checked below.
    let _ = store.commit(Vec::new());
    let history = |problem: String| CommandError::History(problem);
    let mut checkpoints = store
        .checkpoints(swarm)
        .map_err(|it| history(it.to_string()))?;
    match target {
        ReplayTarget::Step(step) => checkpoints.retain(|it| it.step <= step),
        ReplayTarget::LastInput | ReplayTarget::LastHash | ReplayTarget::At(..) => {
            checkpoints.reverse();
        }
    }
    let mut problem =
        "the history before this step is no longer stored: see history_from in get/status"
            .to_owned();
    for stored in checkpoints {
        let body = store.checkpoint(swarm, stored.number);
        let checkpoint = match body
            .map_err(|it| it.to_string())
            .and_then(|it| read_checkpoint(&it.body))
        {
            Ok(checkpoint) => checkpoint,
            Err(error) => {
                problem = error;
                continue;
            }
        };
        let after = checkpoint.lines;
        let mut index = JournalIndex::default();
        for line in JournalReader::new(store, swarm, after, None) {
            index.add(&line.map_err(|it| history(it.to_string()))?);
        }
        // Lines that are written from now on are not replayed.
        let until = index.last().unwrap_or(after);
        let on_progress = on_progress.clone();
        let lines = JournalReader::new(store, swarm, after, Some(until)).inspect(move |line| {
            if let Ok((line, _)) = line {
                on_progress((line.number - after - 1) as f64 / (until - after) as f64);
            }
        });
        let source = ReplaySource {
            checkpoint,
            lines: Box::new(lines.map(|line| line.map_err(|it| it.to_string()))),
            index,
            damage: None,
            entries: Vec::new(),
            reply_for: Box::new(|_| ReplyTo::ignored()),
            to: target,
        };
        let (checkpoint, replay) = source.replay();
        if let Some(problem) = replay.aborted {
            return Err(history(problem));
        }
        match (target, &checkpoint.phase) {
            (ReplayTarget::Step(_), Phase::Faulted(reason)) if replay.differs_at.is_some() => {
                return Err(history(reason.clone()));
            }
            (ReplayTarget::Step(step) | ReplayTarget::At(_, step), _)
                if replay.differs_at.is_none() && !has_reached(&checkpoint, target) =>
            {
                return Err(history(format!(
                    "step {step} is not on the disk yet, where the journal ends at step {}: retry \
                     in a moment, or once the disk has room",
                    checkpoint.simulation.state.step
                )));
            }
            _ => {}
        }
        return Ok(Replayed {
            from: stored.step,
            checkpoint,
            same: replay.same,
            differs_at: replay.differs_at,
        });
    }
    Err(history(problem))
}

fn has_reached(checkpoint: &Checkpoint, target: ReplayTarget) -> bool {
    let here = (
        checkpoint.simulation.epoch,
        checkpoint.simulation.state.step,
    );
    match target {
        ReplayTarget::Step(step) => here.1 == step,
        ReplayTarget::At(epoch, step) => here == (epoch, step),
        ReplayTarget::LastInput | ReplayTarget::LastHash => true,
    }
}
