//! What is stored of swarms, told again: all of them when the daemon starts, one when somebody asks.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::channel;

use jostle_physics::simulation::Spec;
use jostle_proto as proto;
use thiserror::Error;
use tracing::{error, info, warn};

use crate::convert::commands::CommandError;
use crate::convert::digest::Digest;
use crate::convert::{self, Payload, durable};
use crate::persistence::journal_reader::{self, LineError, Lines, PAGE};
use crate::persistence::writer::{About, writes};
use crate::store::{self, Store, StoreError, Write};
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::error::SwarmError;
use crate::swarm::journal::{Entry, Line, Record};
use crate::swarm::outcome::{Rejection, ReplyTo};
use crate::swarm::phase::Phase;
use crate::swarm::registry::{RegistryError, SwarmRegistry};
use crate::swarm::sender::Sender;
use crate::swarm::worker::replay::{Applied, JournalIndex, ReplaySource, To, Told};

/// Lines looked through for the commands that were applied before a checkpoint.
const LINES_FOR_ENTRIES: u64 = 10_000;

/// The replies to requests that have an id, which recovery reads and completes.
pub trait ReplyCache: Clone + Send + 'static {
    /// Adds the persisted replies, oldest first.
    fn fill(&self, replies: Vec<store::Answer>);

    /// Whether a request with this id is known.
    fn contains(&self, client: &Option<String>, id: &str) -> bool;

    /// Begins a request that was received before the restart and is replayed. Retries of it wait for
    /// its reply. `None` if it is known.
    fn begin_replayed(
        &self,
        name: (Option<String>, String),
        digest: Digest,
    ) -> Option<Box<dyn ReplySlot>>;
}

/// Where the reply to a request is written.
pub trait ReplySlot: Send {
    /// Remembers the reply.
    fn write(self: Box<Self>, reply: &Result<Payload, Payload>);

    /// Forgets the request, which changed nothing; retries that wait get the error.
    fn forget(self: Box<Self>, error: &Payload);
}

/// Why swarms cannot be brought back.
#[derive(Debug, Error)]
pub enum RecoveryError {
    /// The store cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// What is stored of a swarm means nothing to this daemon.
    #[error("swarm {swarm}: {problem}")]
    Unreadable {
        /// Which.
        swarm: String,
        /// What is wrong.
        problem: String,
    },
    /// A swarm's thread cannot be started.
    #[error("swarm {0}: {1}")]
    Host(String, RegistryError),
}

/// Checkpoints between a command whose answer is kept for sure and the newest one.
const SETTLED_CHECKPOINTS: usize = 8;

/// Brings every swarm back, and waits until each is as it was. Returns how many there are.
///
/// A swarm of which nothing can be read is left in the store and told of in the log.
///
/// # Errors
///
/// [`RecoveryError`] when the store as a whole cannot be read.
pub fn recover(
    host: &Arc<SwarmRegistry>,
    store: &Store,
    replies: &impl ReplyCache,
) -> Result<usize, RecoveryError> {
    replies.fill(store.answers()?);
    let (told, is_told) = channel();
    let mut count = 0;
    for (swarm, about) in store.swarms()? {
        let begun = recall(store, replies, &swarm, &about).and_then(|(recipe, past)| {
            let told = told.clone();
            host.recover(&swarm, recipe, past, move || {
                ReplyTo::new(move |_| {
                    let _ = told.send(());
                })
            })
            .map_err(|error| RecoveryError::Host(swarm.clone(), error))
        });
        match begun {
            Ok(()) => count += 1,
            Err(error) => error!(swarm, %error, "failed to bring back: it is left in the store"),
        }
    }
    drop(told);
    let back = is_told.iter().take(count).count();
    if back > 0 {
        info!(swarms = back, "brought back");
    }
    Ok(back)
}

/// What is stored of a swarm, read back.
fn recall(
    store: &Store,
    replies: &impl ReplyCache,
    swarm: &str,
    about: &[u8],
) -> Result<(Spec, ReplaySource), RecoveryError> {
    let unreadable = |problem: String| RecoveryError::Unreadable {
        swarm: swarm.to_owned(),
        problem,
    };
    let about: About =
        ciborium::from_reader(about).map_err(|error| unreadable(error.to_string()))?;
    let recipe =
        jostle_convert::spec::from_proto(&about.spec, jostle_convert::value::count(about.spec.n))
            .map_err(|error| unreadable(error.to_string()))?;
    let mut newest = None;
    let mut problem = "no checkpoint of it is kept".to_owned();
    let marks = store.checkpoints(swarm)?;
    // A reply is stored soon after its command, so replies to commands before an older checkpoint
    // were stored before the newest one: if the store has ever evicted a reply, a missing one was
    // evicted, not lost.
    let settled = marks.get(SETTLED_CHECKPOINTS);
    let settled = settled.filter(|_| store.has_forgotten());
    let answered = settled.map_or(0, |mark| mark.number);
    for mark in marks {
        let checkpoint = store
            .checkpoint(swarm, mark.number)
            .map_err(|error| error.to_string())
            .and_then(|kept| read_checkpoint(&kept.body));
        match checkpoint {
            Ok(checkpoint) => {
                let past = lines_after(store, swarm, checkpoint)?;
                if past.damage.is_some() && newest.is_some() {
                    // What is sure goes before what was answered.
                    break;
                }
                let is_answered =
                    past.is_answered(replies, store, swarm, (answered, mark.number))?;
                if is_answered {
                    let entries = entries_before(store, swarm, past.checkpoint.lines)?;
                    let past = past.cut(store, swarm);
                    return Ok((recipe, past.told_to(replies.clone(), swarm, entries)));
                }
                // An answer was lost: from an older checkpoint on it comes about again.
                newest.get_or_insert(past);
            }
            Err(error) => {
                warn!(swarm, step = mark.step, %error, "a checkpoint is damaged: an older one is taken");
                problem = error;
            }
        }
    }
    match newest {
        Some(past) => {
            let entries = entries_before(store, swarm, past.checkpoint.lines)?;
            let past = past.cut(store, swarm);
            Ok((recipe, past.told_to(replies.clone(), swarm, entries)))
        }
        None => Err(unreadable(problem)),
    }
}

/// A swarm's past, told again.
pub struct Replayed {
    /// The step it was told from.
    pub from: u64,
    /// The swarm at the end of it.
    pub checkpoint: Checkpoint,
    /// How many hashes came out as they had been.
    pub same: u64,
    /// The first epoch and step that came out otherwise.
    pub differs_at: Option<(u64, u64)>,
}

/// Tells a swarm's past again: to a step from the last checkpoint before it, else from the oldest.
/// Passes the share of the journal's lines that are done, from 0 to 1, to `on_progress`.
///
/// # Errors
///
/// [`CommandError::History`] when what is needed is no longer kept, or damaged.
pub fn replay_to(
    store: &Store,
    swarm: &str,
    to: To,
    on_progress: impl Fn(f64) + Clone + Send + 'static,
) -> Result<Replayed, CommandError> {
    // Nothing, which is written after everything before it; if it cannot be, the rest tells.
    let _ = store.commit(Vec::new());
    let history = |problem: String| CommandError::History(problem);
    let mut marks = store
        .checkpoints(swarm)
        .map_err(|it| history(it.to_string()))?;
    match to {
        To::Step(step) => marks.retain(|mark| mark.step <= step),
        To::LastInput | To::LastHash | To::Place(..) => marks.reverse(),
    }
    let mut problem = "so old a history is not kept: get/status says from where on".to_owned();
    for mark in marks {
        let kept = store.checkpoint(swarm, mark.number);
        let checkpoint = match kept
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
        for line in Lines::new(store, swarm, after, None) {
            index.learn(&line.map_err(|it| history(it.to_string()))?);
        }
        // Lines that are written from now on are not told.
        let until = index.last().unwrap_or(after);
        let on_progress = on_progress.clone();
        let lines = Lines::new(store, swarm, after, Some(until)).inspect(move |line| {
            if let Ok((line, _)) = line {
                on_progress((line.number - after - 1) as f64 / (until - after) as f64);
            }
        });
        let past = ReplaySource {
            checkpoint,
            lines: Box::new(lines.map(|line| line.map_err(|it| it.to_string()))),
            index,
            damage: None,
            entries: Vec::new(),
            recall: Box::new(|_| ReplyTo::ignored()),
            to,
        };
        let (checkpoint, replay) = past.replay();
        if let Some(problem) = replay.broken_off {
            return Err(history(problem));
        }
        match (to, &checkpoint.phase) {
            (To::Step(_), Phase::Faulted(reason)) if replay.differs_at.is_some() => {
                return Err(history(reason.clone()));
            }
            (To::Step(step) | To::Place(_, step), _)
                if replay.differs_at.is_none() && !is_there(&checkpoint, to) =>
            {
                return Err(history(format!(
                    "step {step} is not on the disk yet, which the journal there reaches up to {}: \
                     ask again in a moment, or once the disk has room",
                    checkpoint.simulation.state.step
                )));
            }
            _ => {}
        }
        return Ok(Replayed {
            from: mark.step,
            checkpoint,
            same: replay.same,
            differs_at: replay.differs_at,
        });
    }
    Err(history(problem))
}

fn is_there(checkpoint: &Checkpoint, to: To) -> bool {
    let here = (
        checkpoint.simulation.epoch,
        checkpoint.simulation.state.step,
    );
    match to {
        To::Step(step) => here.1 == step,
        To::Place(epoch, step) => here == (epoch, step),
        To::LastInput | To::LastHash => true,
    }
}

/// Reads a snapshot that was sent.
///
/// # Errors
///
/// What is wrong with it.
pub fn read_snapshot(file: &[u8]) -> Result<Checkpoint, String> {
    let snapshot = proto::Snapshot::from_file(file)?;
    durable::checkpoint(&snapshot, &journal_reader::read_order).map_err(|error| error.to_string())
}

/// Reads a checkpoint that was kept; the store has seen to it that it is whole.
fn read_checkpoint(body: &[u8]) -> Result<Checkpoint, String> {
    let snapshot = proto::Snapshot::from_cbor(body)?;
    durable::checkpoint(&snapshot, &journal_reader::read_order).map_err(|error| error.to_string())
}

/// What the journal says after a checkpoint.
struct Story {
    checkpoint: Checkpoint,
    lines: Vec<Told>,
    damage: Option<String>,
}

fn lines_after(store: &Store, swarm: &str, checkpoint: Checkpoint) -> Result<Story, RecoveryError> {
    let mut story = Story {
        lines: Vec::new(),
        damage: None,
        checkpoint,
    };
    for line in Lines::new(store, swarm, story.checkpoint.lines, None) {
        match line {
            Ok(line) => story.lines.push(line),
            Err(LineError::Store(error)) => return Err(error.into()),
            Err(error @ (LineError::Damaged { .. } | LineError::Gone(_))) => {
                warn!(swarm, %error, "the journal is damaged");
                story.damage = Some(error.to_string());
            }
        }
    }
    Ok(story)
}

impl Story {
    /// Where lines are damaged, has the journal end before them with a fault that says so: what is
    /// written from then on follows what can be told again. Both are safe, or neither.
    fn cut(mut self, store: &Store, swarm: &str) -> Self {
        let Some(damage) = self.damage.take() else {
            return self;
        };
        let (number, epoch, step) = match self.lines.last() {
            Some((line, _)) => {
                let epoch = match line.record {
                    Record::Resumed(epoch) => epoch,
                    _ => line.epoch,
                };
                (line.number, epoch, line.step)
            }
            None => {
                let Checkpoint {
                    lines, simulation, ..
                } = &self.checkpoint;
                (*lines, simulation.epoch, simulation.state.step)
            }
        };
        let line = Line {
            number: number + 1,
            epoch,
            step,
            record: Record::Fault(damage.clone()),
        };
        let cut = Write::Cut {
            swarm: swarm.to_owned(),
            after: number,
        };
        let fault = writes(swarm, Entry::Line(line.clone()));
        match store.commit(std::iter::once(cut).chain(fault).collect()) {
            Ok(()) => {
                error!(swarm, damage, "the journal is cut where it is damaged");
                self.lines.push((line, None));
            }
            Err(fault) => {
                warn!(swarm, %fault, "failed to cut a damaged journal: nothing can follow it yet");
                self.damage = Some(damage);
            }
        }
        self
    }

    /// Whether every named command of the rows after `answered` up to `number`, the checkpoint's,
    /// has its answer in the replies.
    fn is_answered(
        &self,
        replies: &impl ReplyCache,
        store: &Store,
        swarm: &str,
        (answered, number): (u64, u64),
    ) -> Result<bool, RecoveryError> {
        let after = answered.max(number.saturating_sub(PAGE as u64));
        let rows = store.rows(swarm, after, PAGE)?;
        let mut unanswered = Vec::new();
        for row in rows.rows.into_iter().filter(|row| row.number <= number) {
            let number = row.number;
            match journal_reader::read(&row) {
                Ok((
                    Line {
                        record: Record::Input { sender, .. },
                        ..
                    },
                    _,
                )) => {
                    if let Some(id) = &sender.request_id
                        && !replies.contains(&sender.client, id)
                    {
                        unanswered.push(number);
                    }
                }
                Ok((
                    Line {
                        record:
                            Record::Became {
                                input, seq: None, ..
                            },
                        ..
                    },
                    _,
                )) => unanswered.retain(|it| *it != input),
                _ => {}
            }
        }
        // A step under way has its answer still before it.
        if let Some((_, sender)) = &self.checkpoint.pending
            && sender.request_id.is_some()
        {
            unanswered.pop();
        }
        Ok(unanswered.is_empty())
    }

    fn told_to(self, replies: impl ReplyCache, swarm: &str, entries: Vec<Applied>) -> ReplaySource {
        let swarm = swarm.to_owned();
        ReplaySource {
            entries,
            checkpoint: self.checkpoint,
            index: self.lines.iter().collect(),
            lines: Box::new(self.lines.into_iter().map(Ok)),
            damage: self.damage,
            recall: Box::new(move |sender| remember(&replies, &swarm, sender)),
            to: To::LastInput,
        }
    }
}

/// The commands that were applied up to a line, as many as `get/journal` shows.
fn entries_before(store: &Store, swarm: &str, line: u64) -> Result<Vec<Applied>, RecoveryError> {
    let mut after = line.saturating_sub(LINES_FOR_ENTRIES);
    let (mut inputs, mut entries) = (BTreeMap::new(), Vec::new());
    while after < line {
        let rows = store.rows(swarm, after, PAGE)?.rows;
        let Some(last) = rows.last().map(|row| row.number) else {
            break;
        };
        for row in rows.into_iter().take_while(|row| row.number <= line) {
            let (number, epoch, step) = (row.number, row.epoch, row.step);
            let applied = match durable::read_record(&row.body) {
                Ok(Record::Input {
                    sender,
                    seq,
                    unix_secs,
                    ..
                }) => {
                    inputs.insert(number, sender.clone());
                    seq.zip(Some((sender, unix_secs)))
                }
                Ok(Record::Became {
                    input,
                    seq,
                    unix_secs,
                }) => seq.zip(inputs.remove(&input).map(|sender| (sender, unix_secs))),
                _ => None,
            };
            if let Some((seq, (sender, unix_secs))) = applied {
                entries.push(Applied {
                    epoch,
                    step,
                    seq,
                    unix_secs,
                    sender,
                });
            }
        }
        after = last;
    }
    Ok(entries)
}

/// Takes what a command came to, for its sender to ask for again.
fn remember(replies: &impl ReplyCache, swarm: &str, sender: &Arc<Sender>) -> ReplyTo {
    let Some((id, digest)) = sender.request_id.clone().zip(sender.digest) else {
        return ReplyTo::ignored();
    };
    let Some(slot) = replies.begin_replayed((sender.client.clone(), id), digest) else {
        return ReplyTo::ignored();
    };
    let returns_state =
        journal_reader::read_command(sender).is_ok_and(|command| command.returns_state);
    let swarm = swarm.to_owned();
    let worded = |step, error| Payload::json(&CommandError::from(error).to_wire(step));
    ReplyTo::new(move |answered| match answered {
        Ok((place, outcome)) => {
            let frame = returns_state.then_some(0);
            slot.write(&Ok(convert::outcome(&swarm, &place, outcome, frame)));
        }
        Err(Rejection {
            step,
            error: error @ SwarmError::Faulted(_),
        }) => slot.write(&Err(worded(step, error))),
        // What was refused changed nothing, and may be tried again.
        Err(Rejection { step, error }) => slot.forget(&worded(step, error)),
    })
}
