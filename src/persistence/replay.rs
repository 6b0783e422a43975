//! Replays the stored history of a swarm outside the registry: all of it for `verify`, up to a step for
//! `fork`.

use crate::convert::commands::CommandError;
use crate::convert::error::EarlierModelError;
use crate::persistence::checkpoints::read_stored;
use crate::persistence::journal_reader::JournalReader;
use crate::store::{CheckpointInfo, Store};
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::command::Command;
use crate::swarm::handle::ReplyTo;
use crate::swarm::journal::{GoesOn, OnProgress, Replayed};
use crate::swarm::phase::Phase;
use crate::swarm::worker::replay::{ReplaySource, ReplayTarget};

/// Replays the journal of a swarm from its oldest readable checkpoint up to its step in `present`, or up
/// to the last hash if it moves. Passes the replayed fraction (0 to 1) to `on_progress`. Returns the first
/// step, the final state and what the replay found; `None` if it was not to go on.
///
/// # Errors
///
/// [`CommandError::History`] if the checkpoint or the journal is damaged or no longer stored.
pub fn replay_all(
    store: &Store,
    swarm: &str,
    present: &Checkpoint,
    on_progress: impl Fn(f64) + Send + 'static,
    goes_on: GoesOn,
) -> Result<Option<(u64, Checkpoint, Replayed)>, CommandError> {
    let mut checkpoints = stored_checkpoints(store, swarm)?;
    checkpoints.reverse();
    let checkpoint = first_readable(store, swarm, checkpoints)?;
    let (from, after) = (checkpoint.simulation.state.step, checkpoint.lines);
    let (epoch, step) = position(present);
    let to = match present.phase.is_moving() {
        true => ReplayTarget::LastHash,
        false => ReplayTarget::At(epoch, step),
    };
    let lines = JournalReader::new(store, swarm, after, present.lines);
    let all = present.lines.saturating_sub(after) as f64;
    let on_progress: OnProgress =
        Box::new(move |line| on_progress((line - after - 1) as f64 / all));
    let Some((end, replayed)) = replay(checkpoint, lines, to, Some(on_progress), goes_on)? else {
        return Ok(None);
    };
    let is_there = present.phase.is_moving() || position(&end) == (epoch, step);
    if replayed.differs_at.is_none() && !is_there {
        return Err(not_on_disk(step, &end));
    }
    Ok(Some((from, end, replayed)))
}

/// Replays the journal of a swarm from the last checkpoint before `step`. Returns the state on arrival
/// at `step` in the last run, before the commands that were executed there; `None` if it was not to go on.
///
/// # Errors
///
/// [`CommandError::History`] if the checkpoint or the journal is damaged or no longer stored.
pub fn replay_to(
    store: &Store,
    swarm: &str,
    step: u64,
    goes_on: GoesOn,
) -> Result<Option<Checkpoint>, CommandError> {
    let mut checkpoints = stored_checkpoints(store, swarm)?;
    checkpoints.retain(|it| it.step <= step);
    // One at `step` itself may contain commands that were executed there, but the oldest does not: it
    // is the start, or all that is left.
    let (mut there, mut before): (Vec<_>, Vec<_>) =
        checkpoints.into_iter().partition(|it| it.step == step);
    there.reverse();
    before.append(&mut there);
    let checkpoint = first_readable(store, swarm, before)?;
    let lines = || JournalReader::new(store, swarm, checkpoint.lines, u64::MAX);
    // The checkpoint may be of an earlier run, if that of the reset is damaged.
    let mut last_reset = 0;
    for line in lines() {
        let (line, command) = line.map_err(|it| CommandError::History(it.to_string()))?;
        if matches!(command, Some(Command::Reset(_))) {
            last_reset = line.number;
        }
    }
    let (lines, to) = (lines(), ReplayTarget::Step(step, last_reset));
    let Some((end, replayed)) = replay(checkpoint, lines, to, None, goes_on)? else {
        return Ok(None);
    };
    match &end.phase {
        Phase::Faulted(reason) if replayed.differs_at.is_some() => {
            Err(CommandError::History(reason.clone()))
        }
        _ if position(&end).1 != step => Err(not_on_disk(step, &end)),
        _ => Ok(Some(end)),
    }
}

/// The stored checkpoints, newest first.
pub(super) fn stored_checkpoints(
    store: &Store,
    swarm: &str,
) -> Result<Vec<CheckpointInfo>, CommandError> {
    // Waits for the queued writes. If they fail, the replay ends early, which is checked later.
    let _ = store.commit(Vec::new());
    let checkpoints = store.checkpoints(swarm);
    checkpoints.map_err(|it| CommandError::History(it.to_string()))
}

pub(super) fn first_readable(
    store: &Store,
    swarm: &str,
    checkpoints: Vec<CheckpointInfo>,
) -> Result<Checkpoint, CommandError> {
    let mut problem =
        "the history before this step is no longer stored: fork or restore a later step, from \
         history_from in get/status on, or a snapshot of this step"
            .to_owned();
    for stored in checkpoints {
        match read_stored(store, swarm, stored.number) {
            Ok(checkpoint) if checkpoint.is_of_earlier_model() => {
                return Err(CommandError::from(EarlierModelError::Computed {
                    model_version: checkpoint.model_version,
                    step: checkpoint.simulation.state.step,
                }));
            }
            Ok(checkpoint) => return Ok(checkpoint),
            Err(error) => problem = error,
        }
    }
    Err(CommandError::History(problem))
}

/// Replays the lines. `None` if that was not to go on.
fn replay(
    checkpoint: Checkpoint,
    lines: JournalReader,
    to: ReplayTarget,
    on_progress: Option<OnProgress>,
    goes_on: GoesOn,
) -> Result<Option<(Checkpoint, Replayed)>, CommandError> {
    let source = ReplaySource {
        checkpoint,
        lines: Box::new(lines.map(|line| line.map_err(|it| it.to_string()))),
        entries: Vec::new(),
        reply_for: Box::new(|_| ReplyTo::ignored()),
        to,
        on_progress,
        goes_on: Some(goes_on),
    };
    let (end, mut replayed) = source.replay();
    if replayed.is_cancelled {
        return Ok(None);
    }
    match replayed.problem.take() {
        Some(problem) => Err(CommandError::History(problem)),
        None => Ok(Some((end, replayed))),
    }
}

fn not_on_disk(step: u64, end: &Checkpoint) -> CommandError {
    CommandError::History(format!(
        "step {step} is not on the disk yet, where the journal ends at step {}: retry in a moment, or \
         once the disk has room",
        end.simulation.state.step
    ))
}

fn position(checkpoint: &Checkpoint) -> (u64, u64) {
    let simulation = &checkpoint.simulation;
    (simulation.epoch, simulation.state.step)
}
