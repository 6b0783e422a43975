//! The thread of a swarm: the only one that accesses its state.
//!
//! Between steps it handles messages in the order of arrival. It keeps the pace of the swarm and puts
//! frames and events into the output; it never waits for a subscriber.

mod commands;
mod controllers;
mod output;
mod places;
pub mod replay;
mod scheduled;
mod step;
mod waits;
mod watches;

#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant, SystemTime};

use jostle_physics::model::MODEL_VERSION;
use jostle_physics::simulation::{ReserveMemory, Simulation};
use parking_lot::Mutex;

use crate::failpoint;
use crate::suspension;
use crate::swarm::checkpoint::{Checkpoint, EarlierModel};
use crate::swarm::command::Command;
use crate::swarm::controllers::{Controllers, Effect, Input};
use crate::swarm::error::{SwarmError, WriteFault};
use crate::swarm::fault::Fault;
use crate::swarm::frame::{Event, EventKind, Stamp, Summary};
use crate::swarm::handle::{Handle, Message, Outcome, Rejection, ReplyTo, receive};
use crate::swarm::history::History;
use crate::swarm::journal::{Journal, JournalWriter, Record};
use crate::swarm::metrics::SwarmMetrics;
use crate::swarm::output::Output;
use crate::swarm::phase::{PauseReason, Phase};
use crate::swarm::runner::{End, Runner};
use crate::swarm::schedule::Schedule;
use crate::swarm::scheduler::{Pace, Share};
use crate::swarm::sender::{Creation, Sender};
use crate::swarm::waiters::Waiters;
use crate::swarm::waits::{ReservePast, Waits};
use crate::swarm::watch::Watches;

/// Messages handled between two steps: a flood of them slows a swarm but never stops it.
const MAX_MESSAGES_PER_STEP: usize = 64;

/// A checkpoint is due after this many steps or commands, or after this time.
const CHECKPOINT_STEPS: u64 = 10_000;
const CHECKPOINT_INPUTS: u64 = 4096;
const CHECKPOINT_INTERVAL: Duration = Duration::from_secs(30);

/// A checkpoint is also due after this much computing, if this interval has passed. It bounds the
/// computing that all swarms together repeat after a crash.
const CHECKPOINT_WORK: Duration = Duration::from_millis(30);
const MIN_CHECKPOINT_INTERVAL: Duration = Duration::from_secs(1);

pub struct Worker {
    simulation: Simulation,
    phase: Phase,
    rate: Option<f64>,
    pace: Pace,
    cpu_share: Share,
    output: Arc<Output>,
    history: Arc<History>,
    metrics: Arc<SwarmMetrics>,
    schedule: Schedule,
    watches: Watches,
    summary: Arc<Mutex<Option<Summary>>>,
    summary_updated: Instant,
    min_frame_interval: Duration,
    frame_due: Instant,
    /// How many annotations were applied; [`Worker::seq`] counts them, the simulation does not.
    annotations: u64,
    /// The number of changes by commands of a protocol.
    protocol_draws: u64,
    /// Whether it rejects `delete` and `reset`.
    is_protected: bool,
    /// The versions of the model that computed steps before this one, oldest first.
    earlier_models: Vec<EarlierModel>,
    /// The version that computed the state from which the recovery goes on, if it is another one.
    taken_over: Option<u32>,
    events: u64,
    pending: Option<Pending>,
    waiters: Waiters,
    waits: Waits,
    controllers: Controllers,
    /// Controllers without a token that are scheduled to join, and since when each may declare it.
    absent: BTreeMap<String, Instant>,
    /// Held while there are controllers, so that their times do not count while the daemon is suspended.
    suspensions: Option<suspension::Watch>,
    /// The effects of an input on the controllers while they are carried out; kept for its memory.
    effects: Vec<Effect>,
    journal: Journal,
    since_checkpoint: SinceCheckpoint,
    /// The wall-clock time in the journal and events of the command that is being executed, if one is.
    applied_at: Option<Option<f64>>,
    /// Where the last step led that was no replay, and when it was taken.
    stepped: Option<((u64, u64), SystemTime)>,
    /// What went wrong, if it has faulted.
    fault: Option<Fault>,
}

/// A `step` command that is being executed.
struct Pending {
    reply_to: ReplyTo,
    from: u64,
    sender: Arc<Sender>,
}

struct SinceCheckpoint {
    saved_at: Instant,
    steps: u64,
    inputs: u64,
    work: Duration,
}

impl SinceCheckpoint {
    fn new() -> Self {
        SinceCheckpoint {
            saved_at: Instant::now(),
            steps: 0,
            inputs: 0,
            work: Duration::ZERO,
        }
    }

    fn is_due(&self, now: Instant) -> bool {
        let elapsed = now.saturating_duration_since(self.saved_at);
        let is_long = elapsed >= CHECKPOINT_INTERVAL
            || (self.work >= CHECKPOINT_WORK && elapsed >= MIN_CHECKPOINT_INTERVAL);
        self.steps >= CHECKPOINT_STEPS
            || self.inputs >= CHECKPOINT_INPUTS
            || (is_long && self.steps > 0)
    }
}

impl Runner for Worker {
    fn run(self: Box<Self>, messages: &Receiver<Message>) -> End {
        let metrics = self.metrics.clone();
        let end = self.run_loop(messages);
        metrics.activity.end();
        end
    }
}

impl Worker {
    /// A worker that starts from a checkpoint and has published nothing. `reply_for` makes the receivers of
    /// the replies to its pending `step` and `advance` commands.
    pub fn restore(
        checkpoint: Checkpoint,
        handle: &Handle,
        min_frame_interval: Duration,
        (writer, reserve): (Arc<dyn JournalWriter>, ReserveMemory),
        reply_for: &dyn Fn(&Arc<Sender>) -> ReplyTo,
    ) -> Self {
        let is_earlier = checkpoint.is_of_earlier_model();
        let taken_over = is_earlier.then_some(checkpoint.model_version);
        let checkpoint = checkpoint.taken_over();
        let simulation = Simulation::from_checkpoint(&checkpoint.simulation, reserve);
        let (now, state) = (Instant::now(), &simulation.state);
        let mut worker = Worker {
            pace: Pace::new(checkpoint.rate, state.parameters.dt, now),
            cpu_share: handle.cores.share(handle.owner(), handle.waker()),
            journal: Journal::new(
                writer,
                checkpoint.lines,
                state.step,
                handle.progress.clone(),
            ),
            since_checkpoint: SinceCheckpoint::new(),
            applied_at: None,
            stepped: None,
            fault: match &checkpoint.phase {
                Phase::Faulted(reason) => Some(Fault::of(&simulation, reason)),
                _ => None,
            },
            simulation,
            phase: checkpoint.phase,
            rate: checkpoint.rate,
            output: handle.output.clone(),
            history: handle.history.clone(),
            metrics: handle.metrics.clone(),
            schedule: Schedule::default(),
            watches: Watches::restore(checkpoint.watches, checkpoint.past),
            summary: handle.summary.clone(),
            summary_updated: now,
            min_frame_interval,
            frame_due: now,
            annotations: checkpoint.annotations,
            protocol_draws: checkpoint.protocol_draws,
            is_protected: checkpoint.is_protected,
            earlier_models: checkpoint.earlier_models,
            taken_over,
            events: checkpoint.events,
            pending: checkpoint.pending.map(|(from, sender)| Pending {
                reply_to: reply_for(&sender),
                from,
                sender,
            }),
            waiters: Waiters::default(),
            waits: Waits::default(),
            controllers: Controllers::restore(checkpoint.controllers, reply_for),
            absent: BTreeMap::new(),
            suspensions: None,
            effects: Vec::new(),
        };
        for (at_step, scheduled) in checkpoint.scheduled {
            worker.schedule.add(at_step, scheduled);
        }
        worker.reset_pace();
        worker
    }

    /// Publishes the first summary, and that the swarm was created, unless events precede it: then its
    /// creation is added to the history, which a recovered swarm has lost.
    pub fn publish_created(&mut self, creation: Option<Arc<Creation>>) {
        let unix_secs = creation.as_ref().and_then(|it| it.unix_secs);
        match creation {
            creation if self.events == 0 => {
                self.applied_at(unix_secs, |it| it.push_event(EventKind::Created(creation)));
            }
            Some(creation) => {
                let stamp = Stamp {
                    // As in `Checkpoint::for_another`.
                    epoch: 1,
                    step: creation.step,
                    time: creation.step as f64 * self.simulation.state.parameters.dt,
                    phase: Phase::Paused(PauseReason::Created),
                    seq: 0,
                };
                self.history.record_event(&Event {
                    number: 1,
                    stamp,
                    unix_secs,
                    kind: EventKind::Created(Some(creation)),
                });
            }
            None => {}
        }
        self.update_summary();
    }

    /// Begins a new epoch after a replay, and journals it. If that fails, the line is queued instead,
    /// and the swarm continues.
    pub fn resume(&mut self, reserve: ReserveMemory) -> Result<(), WriteFault> {
        self.simulation.set_reserve(reserve);
        let (before, epoch) = (self.at(), self.simulation.epoch + 1);
        self.simulation.epoch = epoch;
        self.reset_pace();
        let written = self.journal.commit(before, vec![Record::Resumed(epoch)]);
        failpoint::kill("swarm-resumed");
        if written.is_err() {
            // The later lines belong to this epoch, so this line is queued before them.
            self.journal.append(before, Record::Resumed(epoch), None);
        }
        if let Some(from) = self.taken_over.take() {
            let to = MODEL_VERSION;
            self.push_event(EventKind::Model { from, to });
        }
        self.push_event(EventKind::Phase);
        self.save_checkpoint();
        self.update_summary();
        self.notify_controllers(Input::Updated);
        written.map(drop)
    }

    /// Reserves the memory of the earlier states that waits need by `reserve` from now on.
    pub fn set_reserve_of_waits(&mut self, reserve: ReservePast) {
        self.waits.set_reserve(reserve);
    }

    fn reset_pace(&mut self) {
        let rate = match self.phase {
            Phase::Stepping { .. } => None,
            _ => self.rate,
        };
        let dt = self.simulation.state.parameters.dt;
        self.pace = Pace::new(rate, dt, Instant::now());
    }

    pub fn n(&self) -> usize {
        self.simulation.state.configuration.n()
    }

    pub fn checkpoint(&self) -> Checkpoint {
        let pending = self.pending.as_ref();
        Checkpoint {
            simulation: self.simulation.checkpoint(),
            phase: self.phase.clone(),
            rate: self.rate,
            scheduled: self.schedule.list(),
            watches: self.watches.list(),
            past: self.watches.past().clone(),
            pending: pending.map(|pending| (pending.from, pending.sender.clone())),
            controllers: self.controllers.states(),
            annotations: self.annotations,
            protocol_draws: self.protocol_draws,
            is_protected: self.is_protected,
            model_version: MODEL_VERSION,
            earlier_models: self.earlier_models.clone(),
            events: self.events,
            lines: self.journal.lines(),
            is_last: false,
        }
    }

    /// Steps and handles messages until the swarm ends.
    fn run_loop(mut self, messages: &Receiver<Message>) -> End {
        let queued = || messages.try_iter();
        loop {
            if self.controllers_due().is_some()
                && let Some(end) = self.fire_deadlines()
            {
                return end;
            }
            if self.phase.is_moving() {
                self.metrics.activity.begin();
                if let Some(end) = self.handle_batch(queued()) {
                    return end;
                }
            }
            let wait = self.wait();
            let is_output_full = wait == Some(Duration::ZERO) && !self.output.has_room();
            if wait == Some(Duration::ZERO) && !is_output_full && self.may_compute() {
                self.metrics.activity.begin();
                if let Some(end) = self.step() {
                    return end;
                }
                continue;
            }
            self.metrics.activity.end();
            let wakes_at = match wait {
                // A lossless recording whose queue is full wakes this thread once it has room.
                Some(Duration::ZERO) if is_output_full => {
                    self.cpu_share.leave();
                    self.controllers_due()
                }
                // The scheduler wakes this thread when it may compute.
                Some(Duration::ZERO) => None,
                wait => {
                    self.cpu_share.leave();
                    let next = wait.map(|wait| Instant::now() + wait);
                    next.into_iter().chain(self.controllers_due()).min()
                }
            };
            match receive(messages, wakes_at.into_iter().chain(self.waits.due()).min()) {
                Ok(message) => {
                    self.metrics.activity.begin();
                    let all = std::iter::once(message).chain(queued());
                    if let Some(end) = self.handle_batch(all) {
                        return end;
                    }
                }
                Err(RecvTimeoutError::Timeout) => self.sweep_waits(Instant::now()),
                Err(RecvTimeoutError::Disconnected) => return End::Stopped,
            }
        }
    }

    fn may_compute(&mut self) -> bool {
        let now = Instant::now();
        self.cpu_share.may_compute(now, self.pace.need(now))
    }

    /// The time until the next step; `None` if the swarm does not move.
    fn wait(&self) -> Option<Duration> {
        let until_due = || self.pace.until_due(Instant::now());
        let is_moving = self.phase.is_moving();
        is_moving.then(|| until_due().unwrap_or_default())
    }

    /// Handles queued messages. Consecutive commands are journaled together. A batch ends after
    /// `reset`, since the commands after it get another step, after a command about conditions, beside which
    /// the next one is checked, and after a group-committed command, which is journaled when it is executed:
    /// the line of the next command must follow its line.
    fn handle_batch(&mut self, messages: impl Iterator<Item = Message>) -> Option<End> {
        let mut messages: VecDeque<Message> = messages.take(MAX_MESSAGES_PER_STEP).collect();
        let mut batch = Vec::new();
        while let Some(message) = messages.pop_front() {
            match message {
                Message::Command(message) => {
                    let is_last = matches!(
                        message.command,
                        Command::Reset(_) | Command::Watch(_) | Command::Unwatch(_)
                    ) || message.command.is_group_committed();
                    batch.push(message);
                    let continues = matches!(messages.front(), Some(Message::Command(_)));
                    if (is_last || !continues)
                        && let Some(end) = self.commands(std::mem::take(&mut batch))
                    {
                        return Some(end);
                    }
                }
                other => {
                    if let Some(end) = self.handle(other) {
                        return Some(end);
                    }
                }
            }
        }
        let now = Instant::now();
        self.sweep_waits(now);
        self.checkpoint_if_due(now);
        None
    }

    fn handle(&mut self, message: Message) -> Option<End> {
        match message {
            Message::Query(reply_to) => {
                self.sweep_waits(Instant::now());
                let (stamp, frame) = self.state_with_controllers();
                reply_to.send(Ok((stamp, Outcome::State(frame))));
            }
            Message::Put(controller, epoch, put) => {
                self.notify_controllers(Input::Put(&controller, epoch, put));
            }
            Message::TokenLost(controller) => return self.token_lost(controller),
            Message::TokenDeclared(controller) => {
                self.token_declared(&controller);
            }
            Message::RecordingFailed(recording, reason) => {
                self.push_event(EventKind::RecordingFailed(recording, reason));
                // The journal has no line for this event: without a checkpoint, a replay would give
                // later events other numbers.
                self.save_checkpoint();
            }
            Message::Wait(waiter) => {
                self.waiters.add(waiter);
                self.reply_to_waiters();
            }
            Message::WaitFor(wait) => self.wait_for(*wait),
            Message::TakeCheckpoint(reply_to) => {
                let checkpoint = Outcome::Checkpoint(Box::new(self.checkpoint()));
                reply_to.send(Ok((self.stamp(), checkpoint)));
            }
            Message::Seek(_, _, reply_to) => self.reject(reply_to, SwarmError::NotRecorded),
            Message::Command(command) => return self.commands(vec![command]),
            // The loop checks the phase, the scheduler and the output after each batch.
            Message::Wake => {}
            Message::Stop => {
                self.update_summary();
                let checkpoint = Checkpoint {
                    is_last: true,
                    ..self.checkpoint()
                };
                self.journal.append_checkpoint(checkpoint);
                return Some(End::Stopped);
            }
        }
        None
    }

    pub(super) fn reject(&self, reply_to: ReplyTo, error: SwarmError) {
        let step = Some(self.simulation.state.step);
        reply_to.send(Err(Rejection { step, error }));
    }

    /// The number of the last command. The simulation does not count annotations, since its number
    /// keys the random draws of commands, which an annotation must not change.
    fn seq(&self) -> u64 {
        self.simulation.seq + self.annotations
    }

    fn is_faulted(&self) -> bool {
        matches!(self.phase, Phase::Faulted(_))
    }

    fn at(&self) -> (u64, u64) {
        (self.simulation.epoch, self.simulation.state.step)
    }
}
