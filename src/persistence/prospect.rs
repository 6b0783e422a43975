//! From where a recovery would let a stored swarm go on.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::error::Error;

use crate::persistence::checkpoints::readable;
use crate::persistence::recovery::{NO_CHECKPOINT, Tail, read_metadata, read_tail};
use crate::store::Store;
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::journal::Record;
use crate::swarm::phase::Phase;

/// From where a stored swarm would go on.
pub struct Prospect {
    /// Its newest readable checkpoint. If that is of this version of the model, a recovery may take an older one of
    /// this version, with the same states.
    pub checkpoint: Checkpoint,
    /// The phase of the swarm; none if commands after the checkpoint may have changed it.
    pub phase: Option<Phase>,
    /// The number of commands that were sent, or executed, after it.
    pub later_commands: usize,
    /// The damage that was found.
    pub damage: Vec<String>,
}

/// Returns from where the swarm with this metadata would go on.
///
/// # Errors
///
/// Why it would not be recovered.
pub fn prospect(store: &Store, swarm: &str, metadata: &[u8]) -> Result<Prospect, Box<dyn Error>> {
    read_metadata(metadata)?;
    let before = store.health().damaged;
    let stored = store.checkpoints(swarm)?;
    let left_out = store.health().damaged - before;
    let unreadable = RefCell::new(Vec::new());
    let newest = readable(store, swarm, stored, |info, error| {
        unreadable.borrow_mut().push((info.step, error));
    })
    .next();
    let unreadable = unreadable.into_inner();
    let Some(checkpoint) = newest else {
        let error = unreadable.into_iter().next_back().map(|(_, error)| error);
        return Err(error.unwrap_or_else(|| NO_CHECKPOINT.to_owned()).into());
    };
    let mut damage = Vec::new();
    if left_out > 0 {
        damage.push(format!(
            "checkpoints that are damaged or missing: {left_out}"
        ));
    }
    damage.extend(
        unreadable
            .into_iter()
            .map(|(step, error)| format!("the checkpoint of step {step} cannot be read: {error}")),
    );
    let tail = read_tail(store, swarm, checkpoint.lines)?;
    damage.extend(tail.iter().filter_map(|it| it.as_ref().err()).cloned());
    Ok(Prospect {
        later_commands: commands(&tail),
        phase: phase(&checkpoint, &tail),
        checkpoint,
        damage,
    })
}

/// The phase after lines of a journal; none if commands among them may have changed it.
fn phase(checkpoint: &Checkpoint, tail: &Tail) -> Option<Phase> {
    let mut phase = Some(checkpoint.phase.clone());
    for entry in tail {
        match entry {
            Ok((line, _)) => match &line.record {
                Record::Fault(reason) => phase = Some(Phase::Faulted(reason.clone())),
                Record::Input { .. } | Record::Outcome { .. } => phase = None,
                Record::Resumed(_) | Record::Hash(_) => {}
            },
            Err(damage) => phase = Some(Phase::Faulted(damage.clone())),
        }
    }
    phase
}

/// The number of commands that lines of a journal send or execute, without those that were rejected.
fn commands(tail: &Tail) -> usize {
    let mut commands = BTreeSet::new();
    for (line, _) in tail.iter().flatten() {
        match &line.record {
            Record::Input { .. } => _ = commands.insert(line.number),
            Record::Outcome {
                input,
                seq: Some(_),
                ..
            } => _ = commands.insert(*input),
            Record::Outcome {
                input, seq: None, ..
            } => _ = commands.remove(input),
            _ => {}
        }
    }
    commands.len()
}
