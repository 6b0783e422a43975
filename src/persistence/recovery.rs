//! Recovers all stored swarms when the daemon starts.

use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::sync::Arc;
use std::sync::mpsc::channel;

use fail::fail_point;
use jostle_convert::Place;
use jostle_physics::model::MODEL_VERSION;
use jostle_physics::simulation::Spec;
use tracing::{error, info, warn};

use crate::convert::commands::CommandError;
use crate::convert::error::EarlierModelError;
use crate::convert::{self, Payload};
use crate::persistence::checkpoints::{read_stored, readable};
use crate::persistence::journal_reader::{
    self, AppliedInputs, JournalReader, LineError, read_lines,
};
use crate::persistence::recoveries::Recoveries;
use crate::persistence::reply_cache::ReplyCache;
use crate::persistence::writer::{SwarmMetadata, writes};
use crate::store::{CheckpointInfo, Store, StoreError, Write};
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::error::SwarmError;
use crate::swarm::frame::Frame;
use crate::swarm::handle::{Handle, Rejection, ReplyTo};
use crate::swarm::history;
use crate::swarm::journal::{Entry, GoesOn, Line, OnProgress, Record};
use crate::swarm::recovery_progress::RecoveryProgress;
use crate::swarm::registry::{self, SwarmRegistry};
use crate::swarm::sender::{Creation, Sender};
use crate::swarm::worker::replay::{ReplayEntry, ReplaySource, ReplayTarget};

/// Lines before a checkpoint that are read for the commands in the history.
const MAX_HISTORY_LINES: u64 = 10_000;

/// Lines before a checkpoint whose replies may be missing.
const MAX_REPLY_LINES: u64 = 1000;

/// The number of checkpoints after which the reply to a command is certainly stored.
const SETTLED_CHECKPOINTS: usize = 8;

/// Why a swarm without a readable checkpoint is not recovered, if none is damaged.
pub(super) const NO_CHECKPOINT: &str = "it has no checkpoint";

/// Called on the thread of each recovered swarm before it continues: with its handle, its state, and the
/// epochs and steps at which it was reset, oldest first, as far as [`MAX_HISTORY_LINES`] tell. Returns the
/// controllers whose liveliness tokens are declared.
pub type OnRecovered =
    Arc<dyn Fn(&Handle, &Arc<Frame>, &[(u64, u64)]) -> BTreeSet<String> + Send + Sync>;

/// The swarms to recover, by name and metadata.
pub type Stored = Vec<(String, Vec<u8>)>;

/// Reads the replies of the previous run, which retries get, and then the swarms to recover.
pub fn read(store: &Store, replies: &impl ReplyCache) -> Result<Stored, StoreError> {
    replies.fill(store.replies()?);
    store.swarms()
}

/// Recovers the swarms that [`read`] has returned, and waits until all are replayed. Returns their number.
///
/// On a daemon without users, `has_users` is false, and the swarms belong to nobody. A swarm that cannot be
/// recovered is logged and stays in the store.
pub fn recover(
    registry: &Arc<SwarmRegistry>,
    store: &Store,
    replies: &impl ReplyCache,
    swarms: Stored,
    on_recovered: &OnRecovered,
    (has_users, progress): (bool, &Arc<RecoveryProgress>),
) -> usize {
    let (replayed, all_replayed) = channel();
    let mut count = 0;
    for (swarm, metadata) in swarms {
        fail_point!("recover-swarm");
        let started = load(store, replies, &swarm, &metadata, progress).and_then(|loaded| {
            let ((spec, creation), source, resets) = loaded;
            let creation = creation.map(|it| Creation {
                owner: it.owner.filter(|_| has_users),
                ..it
            });
            let (replayed, on_recovered) = (replayed.clone(), on_recovered.clone());
            let answer = move || {
                ReplyTo::new(move |_| {
                    let _ = replayed.send(());
                })
            };
            let on_recovered: registry::OnRecovered = Box::new(move |handle, now| {
                // A reset begins an epoch, and so does the recovery. A last one that was rejected has
                // no outcome if a crash followed.
                let mut resets = resets;
                resets.retain(|(epoch, _)| epoch + 1 < now.stamp.epoch);
                on_recovered(handle, now, &resets)
            });
            Ok(registry.recover(
                &swarm,
                ((spec, creation), store.swarm_id(&swarm).ok()),
                source,
                on_recovered,
                answer,
            )?)
        });
        match started {
            Ok(()) => count += 1,
            Err(error) => error!(swarm, %error, "failed to recover: the swarm stays in the store"),
        }
    }
    drop(replayed);
    let recovered = all_replayed.iter().take(count).count();
    if recovered > 0 {
        info!(swarms = recovered, "recovered");
    }
    recovered
}

/// The spec and the creation of a swarm, what is to be replayed, and where the swarm was reset.
type Loaded = ((Spec, Option<Creation>), ReplaySource, Vec<(u64, u64)>);

fn load(
    store: &Store,
    replies: &impl ReplyCache,
    swarm: &str,
    metadata: &[u8],
    progress: &Arc<RecoveryProgress>,
) -> Result<Loaded, Box<dyn Error>> {
    let (spec, creation) = read_metadata(metadata)?;
    let mut chosen = None;
    let mut problem = NO_CHECKPOINT.to_owned();
    let checkpoints = store.checkpoints(swarm)?;
    // A reply is stored soon after its command, so replies to commands before an older checkpoint
    // were stored before the newest one: if the store has ever evicted a reply, a missing one was
    // evicted, not lost.
    let settled = checkpoints.get(SETTLED_CHECKPOINTS);
    let settled = settled.filter(|_| store.has_evicted());
    let replied = settled.map_or(0, |it| it.number);
    let damaged = |stored: &CheckpointInfo, error: String| {
        warn!(swarm, step = stored.step, %error, "a checkpoint is damaged: using an older one");
        problem = error;
    };
    for checkpoint in readable(store, swarm, checkpoints, damaged) {
        if chosen.is_some() && checkpoint.is_of_earlier_model() {
            // A replay from it would not give the states that this version of the model has published.
            break;
        }
        let tail = read_tail(store, swarm, checkpoint.lines)?;
        if matches!(tail.last(), Some(Err(_))) && chosen.is_some() {
            // Intact lines are more important than lost replies.
            break;
        }
        if checkpoint.is_of_earlier_model() {
            info!(
                swarm,
                from = checkpoint.model_version,
                to = MODEL_VERSION,
                step = checkpoint.simulation.state.step,
                "another version of the model goes on from the last stored state"
            );
            for line in unreplied(store, swarm, &checkpoint, replies, replied)? {
                report_accepted(replies, checkpoint.model_version, &line);
            }
            chosen = Some((checkpoint, tail));
            break;
        }
        if unreplied(store, swarm, &checkpoint, replies, replied)?.is_empty() {
            chosen = Some((checkpoint, tail));
            break;
        }
        // A reply was lost: a replay from an older checkpoint produces it again.
        chosen.get_or_insert((checkpoint, tail));
    }
    let (checkpoint, mut tail) = chosen.ok_or(problem)?;
    truncate(store, swarm, &checkpoint, &mut tail);
    let until = checkpoint.lines;
    let before = read_lines(store, swarm, until.saturating_sub(MAX_HISTORY_LINES), until)?;
    let replayed = tail.iter().flatten().map(|(line, _)| line);
    let resets = resets(before.iter().chain(replayed));
    let entries = history_before(store, swarm, &checkpoint, before)?;
    let (replies, swarm) = (replies.clone(), swarm.to_owned());
    let (lines, steps) = (progress.clone(), progress.clone());
    let on_line: OnProgress = Box::new(move |_| lines.note_work());
    let on_step: GoesOn = Box::new(move || {
        steps.note_work();
        true
    });
    let source = ReplaySource {
        checkpoint,
        lines: Box::new(tail.into_iter()),
        entries,
        reply_for: Box::new(move |sender| rebuild_reply(&replies, &swarm, sender)),
        to: ReplayTarget::LastInput,
        on_progress: Some(on_line),
        goes_on: Some(on_step),
    };
    Ok(((spec, creation), source, resets))
}

/// The spec and the creation of a swarm.
pub(super) fn read_metadata(metadata: &[u8]) -> Result<(Spec, Option<Creation>), Box<dyn Error>> {
    let SwarmMetadata { spec, creation } = ciborium::from_reader(metadata)?;
    let spec = jostle_convert::spec::from_proto(&spec, jostle_convert::value::count(spec.n))?;
    Ok((spec, creation))
}

/// The epochs and steps at which the swarm was reset, according to these lines.
fn resets<'a>(lines: impl Iterator<Item = &'a Line>) -> Vec<(u64, u64)> {
    let (mut resets, mut scheduled) = (BTreeMap::new(), BTreeMap::new());
    for line in lines {
        match &line.record {
            Record::Input {
                sender, at_step, ..
            } if sender.verb == "reset" => {
                if let Some(step) = at_step {
                    scheduled.insert(line.number, *step);
                } else {
                    resets.insert(line.number, (line.epoch, line.step));
                }
            }
            Record::Outcome { input, seq, .. } => match seq {
                None => _ = resets.remove(input),
                Some(_) => {
                    // The outcome is at the start of the next epoch.
                    let at = scheduled.remove(input);
                    let at = at.map(|step| (line.epoch.saturating_sub(1), step));
                    resets.extend(at.map(|at| (line.number, at)));
                }
            },
            _ => {}
        }
    }
    resets.into_values().collect()
}

/// The lines after a checkpoint. If a line is damaged, an error takes its place and ends them.
pub(super) type Tail = Vec<Result<ReplayEntry, String>>;

pub(super) fn read_tail(store: &Store, swarm: &str, after: u64) -> Result<Tail, StoreError> {
    let lines = JournalReader::new(store, swarm, after, u64::MAX);
    let lines = lines.map(|line| match line {
        Ok(line) => Ok(Ok(line)),
        Err(LineError::Store(error)) => Err(error),
        Err(error @ (LineError::Damaged { .. } | LineError::Gone(_))) => {
            warn!(swarm, %error, "the journal is damaged");
            Ok(Err(error.to_string()))
        }
    });
    lines.collect()
}

/// If lines are damaged, replaces them by a fault, in one transaction: later lines then follow lines
/// that can be replayed.
fn truncate(store: &Store, swarm: &str, checkpoint: &Checkpoint, tail: &mut Tail) {
    let Some((Err(damage), intact)) = tail.split_last_mut() else {
        return;
    };
    let (number, epoch, step) = match intact.last() {
        Some(Ok((line, _))) => match line.record {
            Record::Resumed(epoch) => (line.number, epoch, line.step),
            _ => (line.number, line.epoch, line.step),
        },
        _ => {
            let simulation = &checkpoint.simulation;
            (checkpoint.lines, simulation.epoch, simulation.state.step)
        }
    };
    let line = Line {
        number: number + 1,
        epoch,
        step,
        record: Record::Fault(damage.clone()),
    };
    let truncation = Write::Truncate {
        swarm: swarm.to_owned(),
        after: number,
    };
    let fault = writes(swarm, Entry::Line(line.clone()));
    match store.commit(std::iter::once(truncation).chain(fault).collect()) {
        Ok(()) => {
            error!(swarm, damage, "truncated a damaged journal");
            tail.pop();
            tail.push(Ok((line, None)));
        }
        Err(fault) => {
            warn!(swarm, %fault, "failed to truncate a damaged journal: the swarm cannot continue yet");
        }
    }
}

/// The lines after `replied` up to a checkpoint whose commands have a request id, and no reply in the
/// cache.
fn unreplied(
    store: &Store,
    swarm: &str,
    checkpoint: &Checkpoint,
    replies: &impl ReplyCache,
    replied: u64,
) -> Result<Vec<Line>, StoreError> {
    let after = replied.max(checkpoint.lines.saturating_sub(MAX_REPLY_LINES));
    let mut missing: Vec<Line> = Vec::new();
    for line in read_lines(store, swarm, after, checkpoint.lines)? {
        match &line.record {
            Record::Input { sender, .. } => {
                if let Some(id) = &sender.request_id
                    && !replies.contains(&sender.client, id)
                {
                    missing.push(line);
                }
            }
            Record::Outcome {
                input, seq: None, ..
            } => missing.retain(|it| it.number != *input),
            _ => {}
        }
    }
    // The reply to a pending `step` has not been sent yet.
    if let Some((_, pending)) = &checkpoint.pending {
        let name = (&pending.client, &pending.request_id);
        missing.retain(|line| match &line.record {
            Record::Input { sender, .. } => (&sender.client, &sender.request_id) != name,
            _ => true,
        });
    }
    Ok(missing)
}

/// Replies to retries of a command that an earlier version of the model has accepted. A replay would give
/// another reply than the one that was lost, and the command must not be executed twice.
fn report_accepted(replies: &impl ReplyCache, model_version: u32, line: &Line) {
    let Record::Input { sender, .. } = &line.record else {
        return;
    };
    let Some((id, digest)) = sender.request_id.clone().zip(sender.digest) else {
        return;
    };
    if let Some(slot) = replies.begin_replayed((sender.client.clone(), id), digest) {
        let step = line.step;
        let error = EarlierModelError::Accepted {
            model_version,
            step,
        };
        let error = CommandError::from(error).to_wire(Some(step), &Place::of_verb(sender.verb));
        slot.write(&Err(Payload::json(&error)));
    }
}

/// The commands that were applied according to the lines before a checkpoint, for waits on events.
fn history_before(
    store: &Store,
    swarm: &str,
    checkpoint: &Checkpoint,
    lines: Vec<Line>,
) -> Result<Vec<history::Entry>, StoreError> {
    let dt = checkpoint.simulation.state.parameters.dt;
    let mut applied = AppliedInputs::default();
    // A copy executes commands that were scheduled in the journal of the original.
    let is_of_original =
        |line: &Line| matches!(line.record, Record::Outcome { input, .. } if input > line.number);
    if lines.iter().any(is_of_original)
        && let Some(oldest) = store.checkpoints(swarm)?.last()
        && let Ok(start) = read_stored(store, swarm, oldest.number)
    {
        for (_, scheduled) in start.scheduled {
            applied.wait_for(scheduled.input, scheduled.sender);
        }
    }
    let (mut recoveries, mut entries) = (Recoveries::new(store, swarm), Vec::new());
    for line in lines {
        if !recoveries.took_back(&line)? {
            entries.extend(applied.read(line).map(|input| input.entry(dt)));
        }
    }
    Ok(entries)
}

/// Receives the reply to a replayed command and puts it into the cache, for retries of the client.
fn rebuild_reply(replies: &impl ReplyCache, swarm: &str, sender: &Arc<Sender>) -> ReplyTo {
    let Some((id, digest)) = sender.request_id.clone().zip(sender.digest) else {
        return ReplyTo::ignored();
    };
    let Some(slot) = replies.begin_replayed((sender.client.clone(), id), digest) else {
        return ReplyTo::ignored();
    };
    let returns_state =
        journal_reader::parse_request(sender).is_ok_and(|(_, returns_state)| returns_state);
    let swarm = swarm.to_owned();
    let place = Place::of_verb(sender.verb);
    let to_payload =
        move |step, error| Payload::json(&CommandError::from(error).to_wire(step, &place));
    ReplyTo::new(move |reply| match reply {
        Ok((stamp, outcome)) => {
            let frame = returns_state.then_some(0);
            slot.write(&Ok(convert::outcome(&swarm, &stamp, outcome, frame)));
        }
        Err(Rejection {
            step,
            error: error @ SwarmError::Faulted(_),
        }) => slot.write(&Err(to_payload(step, error))),
        // A rejected command changed nothing and may be retried.
        Err(Rejection { step, error }) => slot.reject(&to_payload(step, error)),
    })
}
