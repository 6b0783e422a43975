//! Recovers all stored swarms when the daemon starts.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::channel;

use jostle_physics::simulation::Spec;
use thiserror::Error;
use tracing::{error, info, warn};

use crate::convert::commands::CommandError;
use crate::convert::{self, Payload, durable};
use crate::persistence::checkpoints::read_checkpoint;
use crate::persistence::journal_reader::{self, JournalReader, LineError, PAGE_LINES};
use crate::persistence::reply_cache::ReplyCache;
use crate::persistence::writer::{SwarmMetadata, writes};
use crate::store::{Store, StoreError, Write};
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::error::SwarmError;
use crate::swarm::journal::{Entry, Line, Record};
use crate::swarm::outcome::{Rejection, ReplyTo};
use crate::swarm::registry::{RegistryError, SwarmRegistry};
use crate::swarm::sender::Sender;
use crate::swarm::worker::journal_index::ReplayEntry;
use crate::swarm::worker::replay::{Applied, ReplaySource, ReplayTarget};

/// Lines before a checkpoint that are read for the commands in the hitail.
const MAX_HISTORY_LINES: u64 = 10_000;

/// Why a swarm cannot be recovered.
#[derive(Debug, Error)]
pub enum RecoveryError {
    /// The store cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The stored data of a swarm cannot be parsed.
    #[error("swarm {swarm}: {problem}")]
    Unreadable {
        /// Its name.
        swarm: String,
        /// The problem.
        problem: String,
    },
    /// The thread of a swarm cannot be started.
    #[error("swarm {0}: {1}")]
    Host(String, RegistryError),
}

/// The number of checkpoints after which the reply to a command is certainly stored.
const SETTLED_CHECKPOINTS: usize = 8;

/// Recovers every swarm, and waits until all are replayed. Returns their number.
///
/// A swarm that cannot be recovered stays in the store, and an error is logged.
///
/// # Errors
///
/// [`RecoveryError::Store`] if the list of swarms or the replies cannot be read.
pub fn recover(
    host: &Arc<SwarmRegistry>,
    store: &Store,
    replies: &impl ReplyCache,
) -> Result<usize, RecoveryError> {
    replies.fill(store.answers()?);
    let (replayed, all_replayed) = channel();
    let mut count = 0;
    for (swarm, metadata) in store.swarms()? {
        let started = load(store, replies, &swarm, &metadata).and_then(|(spec, source)| {
            let replayed = replayed.clone();
            host.recover(&swarm, spec, source, move || {
                ReplyTo::new(move |_| {
                    let _ = replayed.send(());
                })
            })
            .map_err(|error| RecoveryError::Host(swarm.clone(), error))
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
    Ok(recovered)
}

/// Loads the spec, a checkpoint and the journal of a swarm.
fn load(
    store: &Store,
    replies: &impl ReplyCache,
    swarm: &str,
    metadata: &[u8],
) -> Result<(Spec, ReplaySource), RecoveryError> {
    let unreadable = |problem: String| RecoveryError::Unreadable {
        swarm: swarm.to_owned(),
        problem,
    };
    let metadata: SwarmMetadata =
        ciborium::from_reader(metadata).map_err(|error| unreadable(error.to_string()))?;
    let spec = jostle_convert::spec::from_proto(
        &metadata.spec,
        jostle_convert::value::count(metadata.spec.n),
    )
    .map_err(|error| unreadable(error.to_string()))?;
    let mut newest = None;
    let mut problem = "it has no checkpoint".to_owned();
    let checkpoints = store.checkpoints(swarm)?;
    // A reply is stored soon after its command, so replies to commands before an older checkpoint
    // were stored before the newest one: if the store has ever evicted a reply, a missing one was
    // evicted, not lost.
    let settled = checkpoints.get(SETTLED_CHECKPOINTS);
    let settled = settled.filter(|_| store.has_forgotten());
    let replied = settled.map_or(0, |it| it.number);
    for stored in checkpoints {
        let checkpoint = store
            .checkpoint(swarm, stored.number)
            .map_err(|error| error.to_string())
            .and_then(|it| read_checkpoint(&it.body));
        match checkpoint {
            Ok(checkpoint) => {
                let tail = read_tail(store, swarm, checkpoint)?;
                if tail.damage.is_some() && newest.is_some() {
                    // Intact lines are more important than lost replies.
                    break;
                }
                let has_replies =
                    tail.has_replies(replies, store, swarm, (replied, stored.number))?;
                if has_replies {
                    let history = history_before(store, swarm, tail.checkpoint.lines)?;
                    let tail = tail.truncate(store, swarm);
                    return Ok((spec, tail.into_source(replies.clone(), swarm, history)));
                }
                // A reply was lost: a replay from an older checkpoint produces it again.
                newest.get_or_insert(tail);
            }
            Err(error) => {
                warn!(swarm, step = stored.step, %error, "a checkpoint is damaged: using an older one");
                problem = error;
            }
        }
    }
    match newest {
        Some(tail) => {
            let history = history_before(store, swarm, tail.checkpoint.lines)?;
            let tail = tail.truncate(store, swarm);
            Ok((spec, tail.into_source(replies.clone(), swarm, history)))
        }
        None => Err(unreadable(problem)),
    }
}

/// A checkpoint and the journal after it.
struct JournalTail {
    checkpoint: Checkpoint,
    lines: Vec<ReplayEntry>,
    damage: Option<String>,
}

fn read_tail(
    store: &Store,
    swarm: &str,
    checkpoint: Checkpoint,
) -> Result<JournalTail, RecoveryError> {
    let mut tail = JournalTail {
        lines: Vec::new(),
        damage: None,
        checkpoint,
    };
    for line in JournalReader::new(store, swarm, tail.checkpoint.lines, None) {
        match line {
            Ok(line) => tail.lines.push(line),
            Err(LineError::Store(error)) => return Err(error.into()),
            Err(error @ (LineError::Damaged { .. } | LineError::Gone(_))) => {
                warn!(swarm, %error, "the journal is damaged");
                tail.damage = Some(error.to_string());
            }
        }
    }
    Ok(tail)
}

impl JournalTail {
    /// If lines are damaged, replaces them by a fault, in one transaction: later lines then follow lines
    /// that can be replayed.
    fn truncate(mut self, store: &Store, swarm: &str) -> Self {
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
        let truncation = Write::Cut {
            swarm: swarm.to_owned(),
            after: number,
        };
        let fault = writes(swarm, Entry::Line(line.clone()));
        match store.commit(std::iter::once(truncation).chain(fault).collect()) {
            Ok(()) => {
                error!(swarm, damage, "truncated a damaged journal");
                self.lines.push((line, None));
            }
            Err(fault) => {
                warn!(swarm, %fault, "failed to truncate a damaged journal: the swarm cannot continue yet");
                self.damage = Some(damage);
            }
        }
        self
    }

    /// Whether the cache has the reply to every command with a request id on the lines after `replied`
    /// up to `number`, the line of the checkpoint.
    fn has_replies(
        &self,
        replies: &impl ReplyCache,
        store: &Store,
        swarm: &str,
        (replied, number): (u64, u64),
    ) -> Result<bool, RecoveryError> {
        let after = replied.max(number.saturating_sub(PAGE_LINES as u64));
        let rows = store.rows(swarm, after, PAGE_LINES)?;
        let mut missing = Vec::new();
        for row in rows.rows.into_iter().filter(|row| row.number <= number) {
            let number = row.number;
            match journal_reader::parse_line(&row) {
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
                        missing.push(number);
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
                )) => missing.retain(|it| *it != input),
                _ => {}
            }
        }
        // The reply to a pending `step` has not been sent yet.
        if let Some((_, sender)) = &self.checkpoint.pending
            && sender.request_id.is_some()
        {
            missing.pop();
        }
        Ok(missing.is_empty())
    }

    fn into_source(
        self,
        replies: impl ReplyCache,
        swarm: &str,
        entries: Vec<Applied>,
    ) -> ReplaySource {
        let swarm = swarm.to_owned();
        ReplaySource {
            entries,
            checkpoint: self.checkpoint,
            index: self.lines.iter().collect(),
            lines: Box::new(self.lines.into_iter().map(Ok)),
            damage: self.damage,
            reply_for: Box::new(move |sender| rebuild_reply(&replies, &swarm, sender)),
            to: ReplayTarget::LastInput,
        }
    }
}

/// The commands that were applied up to a line, for `get/journal`.
fn history_before(store: &Store, swarm: &str, line: u64) -> Result<Vec<Applied>, RecoveryError> {
    let mut after = line.saturating_sub(MAX_HISTORY_LINES);
    let (mut inputs, mut entries) = (BTreeMap::new(), Vec::new());
    while after < line {
        let rows = store.rows(swarm, after, PAGE_LINES)?.rows;
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

/// Receives the reply to a replayed command and puts it into the cache, for retries of the client.
fn rebuild_reply(replies: &impl ReplyCache, swarm: &str, sender: &Arc<Sender>) -> ReplyTo {
    let Some((id, digest)) = sender.request_id.clone().zip(sender.digest) else {
        return ReplyTo::ignored();
    };
    let Some(slot) = replies.begin_replayed((sender.client.clone(), id), digest) else {
        return ReplyTo::ignored();
    };
    let returns_state =
        journal_reader::parse_request(sender).is_ok_and(|command| command.returns_state);
    let swarm = swarm.to_owned();
    let to_payload = |step, error| Payload::json(&CommandError::from(error).to_wire(step));
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
        Err(Rejection { step, error }) => slot.forget(&to_payload(step, error)),
    })
}
