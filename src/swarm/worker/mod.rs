//! A swarm's thread: the only one that touches its state, and its only clock.
//!
//! It takes tickets between steps in the order of arrival, paces itself, and puts what is to be
//! published in its outlet. It never waits for a reader.

mod orders;
pub mod replay;
mod steering;

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use fail::fail_point;
use tracing::warn;

use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::clock;
use crate::swarm::command::Command;
use crate::swarm::controllers::Controllers;
use crate::swarm::cpu_scheduler::Share;
use crate::swarm::crash;
use crate::swarm::error::SwarmError;
use crate::swarm::frame::{Event, EventKind, Frame, Place, Summary};
use crate::swarm::handle::{Handle, Message, receive};
use crate::swarm::history::History;
use crate::swarm::journal::{Journal, JournalWriter, Record};
use crate::swarm::outcome::{DeferredReply, Outcome, Rejection, ReplyTo};
use crate::swarm::outlet::Outlet;
use crate::swarm::pace::{MAX_BACKLOG, Pace};
use crate::swarm::phase::{PauseReason, Phase, PhaseInput};
use crate::swarm::schedule::Schedule;
use crate::swarm::sender::Sender;
use crate::swarm::tally::Tally;
use crate::swarm::waiters::Waiters;
use crate::swarm::worker::replay::Replay;
use jostle_physics::simulation::Simulation;

/// Tickets taken between two steps, so that a flood of them slows a swarm but never stops it.
const TICKETS_PER_STEP: usize = 64;

/// How often the summary of a moving swarm is renewed.
const SUMMARY_PERIOD: Duration = Duration::from_millis(100);

/// After so many steps, so many commands or so long a swarm is kept as it is.
const CHECKPOINT_STEPS: u64 = 10_000;
const CHECKPOINT_INPUTS: u64 = 4096;
const CHECKPOINT_PERIOD: Duration = Duration::from_secs(30);

/// A swarm that has computed for so long is kept too, though not more than once a second: after a
/// crash all swarms together compute again what they have computed since.
const CHECKPOINT_WORK: Duration = Duration::from_millis(30);
const CHECKPOINT_PAUSE: Duration = Duration::from_secs(1);

/// Steps between two hashes in the journal.
const HASH_EVERY: u64 = 500;

/// A running swarm, owned by its thread.
pub struct Worker {
    simulation: Simulation,
    phase: Phase,
    rate: Option<f64>,
    pace: Pace,
    seat: Share,
    outlet: Arc<Outlet>,
    history: Arc<History>,
    tally: Arc<Tally>,
    schedule: Schedule,
    summary: Arc<Mutex<Option<Summary>>>,
    summary_renewed: Instant,
    shortest_between_frames: Duration,
    frame_due: Instant,
    events: u64,
    pending: Option<Pending>,
    waiters: Waiters,
    controllers: Controllers,
    journal: Journal,
    since: Since,
    /// The wall-clock time that the journal and events give for what is being carried out, while a
    /// command is.
    applied_at: Option<Option<f64>>,
    replay: Replay,
}

/// A `step` command that is being carried out.
struct Pending {
    answer: ReplyTo,
    from: u64,
    sender: Arc<Sender>,
}

/// What has come about since the last checkpoint.
struct Since {
    kept: Instant,
    steps: u64,
    inputs: u64,
    work: Duration,
}

impl Since {
    fn new() -> Self {
        Since {
            kept: Instant::now(),
            steps: 0,
            inputs: 0,
            work: Duration::ZERO,
        }
    }

    fn is_due(&self, now: Instant) -> bool {
        let elapsed = now.saturating_duration_since(self.kept);
        let is_long = elapsed >= CHECKPOINT_PERIOD
            || (self.work >= CHECKPOINT_WORK && elapsed >= CHECKPOINT_PAUSE);
        self.steps >= CHECKPOINT_STEPS
            || self.inputs >= CHECKPOINT_INPUTS
            || (is_long && self.steps > 0)
    }
}

/// What ended a swarm's thread.
pub enum End {
    /// Its deletion; the answer is due once clients can no longer reach it.
    Deleted(DeferredReply),
    /// The daemon stops.
    Stopped,
}

impl Worker {
    /// A paused worker around a swarm that was just built.
    pub fn new(
        simulation: Simulation,
        handle: &Handle,
        shortest_between_frames: Duration,
        writer: Arc<dyn JournalWriter>,
    ) -> Self {
        let journal = Journal::new(writer, 0, simulation.state.step);
        let mut worker = Worker::around(simulation, handle, shortest_between_frames, journal);
        worker.tell(EventKind::Created);
        worker.renew_summary();
        worker
    }

    fn around(
        simulation: Simulation,
        handle: &Handle,
        shortest_between_frames: Duration,
        journal: Journal,
    ) -> Self {
        let now = Instant::now();
        let rate = simulation.spec.rate;
        Worker {
            pace: Pace::new(rate, simulation.spec.parameters.dt, now),
            seat: handle.seat(),
            journal,
            since: Since::new(),
            applied_at: None,
            replay: Replay::default(),
            simulation,
            phase: Phase::Paused(PauseReason::Created),
            rate,
            outlet: handle.outlet.clone(),
            history: handle.history.clone(),
            tally: handle.tally.clone(),
            schedule: Schedule::default(),
            summary: handle.summary.clone(),
            summary_renewed: now,
            shortest_between_frames,
            frame_due: now,
            events: 0,
            pending: None,
            waiters: Waiters::default(),
            controllers: Controllers::default(),
        }
    }

    /// The size of the group.
    pub fn n(&self) -> usize {
        self.simulation.state.configuration.n()
    }

    /// What telling its past again has shown.
    pub fn into_replay(self) -> Replay {
        self.replay
    }

    /// All of the swarm as it is now.
    pub fn checkpoint(&self) -> Checkpoint {
        let pending = self.pending.as_ref();
        Checkpoint {
            simulation: self.simulation.checkpoint(),
            phase: self.phase.clone(),
            rate: self.rate,
            scheduled: self.schedule.list(),
            pending: pending.map(|pending| (pending.from, pending.sender.clone())),
            controllers: self.controllers.kept(),
            events: self.events,
            lines: self.journal.lines(),
            is_last: false,
        }
    }

    /// The swarm as it is now.
    pub fn look(&self) -> (Place, Arc<Frame>) {
        (self.place(), self.frame(true))
    }

    /// The swarm as it is now, its controllers too.
    fn look_at_all(&self) -> (Place, Arc<Frame>) {
        let (place, frame) = self.look();
        if self.controllers.is_empty() {
            return (place, frame);
        }
        let mut frame = Arc::unwrap_or_clone(frame);
        frame.controllers = self.controllers.seen(Instant::now());
        (place, Arc::new(frame))
    }

    /// Steps and takes tickets until the swarm ends.
    pub fn run(self, messages: &Receiver<Message>) -> End {
        let tally = self.tally.clone();
        let end = self.live(messages);
        tally.pulse.end();
        end
    }

    fn live(mut self, messages: &Receiver<Message>) -> End {
        let others = || messages.try_iter();
        loop {
            if self.controllers.due().is_some()
                && let Some(end) = self.fire_overdue()
            {
                return end;
            }
            if self.phase.is_moving() {
                self.tally.pulse.begin();
                if let Some(end) = self.take_with_others(others()) {
                    return end;
                }
            }
            let wait = self.wait();
            let is_held_up = wait == Some(Duration::ZERO) && !self.outlet.has_room();
            if wait == Some(Duration::ZERO) && !is_held_up && self.has_core() {
                self.tally.pulse.begin();
                if let Some(end) = self.step() {
                    return end;
                }
                continue;
            }
            self.tally.pulse.end();
            let wakes_at = match wait {
                // A recording that cannot take another state wakes it once it can.
                Some(Duration::ZERO) if is_held_up => {
                    self.seat.leave();
                    self.controllers.due()
                }
                // It is called when there is a core for it.
                Some(Duration::ZERO) => None,
                wait => {
                    self.seat.leave();
                    let next = wait.map(|wait| Instant::now() + wait);
                    next.into_iter().chain(self.controllers.due()).min()
                }
            };
            match receive(messages, wakes_at) {
                Ok(message) => {
                    self.tally.pulse.begin();
                    let all = std::iter::once(message).chain(others());
                    if let Some(end) = self.take_with_others(all) {
                        return end;
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return End::Stopped,
            }
        }
    }

    /// Whether it may step now.
    fn has_core(&mut self) -> bool {
        let now = Instant::now();
        let is_behind = matches!(self.phase, Phase::Stepping { .. }) || self.pace.is_behind(now);
        self.seat.may_compute(now, is_behind)
    }

    /// How long until the next step; `None` if there is none to be taken.
    fn wait(&self) -> Option<Duration> {
        match self.phase {
            Phase::Stepping { .. } => Some(Duration::ZERO),
            Phase::Running { .. } => Some(
                self.pace
                    .until_due(Instant::now())
                    .unwrap_or(Duration::ZERO),
            ),
            Phase::Paused(_) | Phase::Faulted(_) => None,
        }
    }

    /// Takes the tickets that have come. Commands that follow each other are made
    /// safe together; what comes after one that starts over has another step, and what comes after
    /// a `step`, which is written down when it is carried out, is to stand on a later line.
    fn take_with_others(&mut self, messages: impl Iterator<Item = Message>) -> Option<End> {
        let mut messages: VecDeque<Message> = messages.take(TICKETS_PER_STEP).collect();
        let mut together = Vec::new();
        while let Some(message) = messages.pop_front() {
            match message {
                Message::Command(command) => {
                    let order = &command.order;
                    let is_last = matches!(order, Command::Reset(_)) || order.is_group_committed();
                    together.push(command);
                    let goes_on = matches!(messages.front(), Some(Message::Command(_)));
                    if (is_last || !goes_on)
                        && let Some(end) = self.commands(std::mem::take(&mut together))
                    {
                        return Some(end);
                    }
                }
                other => {
                    if let Some(end) = self.take(other) {
                        return Some(end);
                    }
                }
            }
        }
        self.keep_if_due(Instant::now());
        None
    }

    fn take(&mut self, message: Message) -> Option<End> {
        match message {
            Message::Look(answer) => {
                let (place, frame) = self.look_at_all();
                answer.send(Ok((place, Outcome::Seen(frame))));
                None
            }
            Message::Put(controller, epoch, put) => {
                let is_of_now = epoch.is_none_or(|epoch| epoch == self.simulation.epoch);
                match put {
                    Some(put) => self.controllers.put(&controller, put, is_of_now),
                    None => self.controllers.refuse_put(&controller),
                }
                None
            }
            Message::Lost(controller) => self.lost(controller),
            Message::RecordingFailed(recording, reason) => {
                self.tell(EventKind::RecordingFailed(recording, reason));
                // The journal has no line of it: without a checkpoint the events after it would have
                // other numbers when they are told again.
                self.keep();
                None
            }
            Message::Wait(waiter) => {
                self.waiters.add(waiter);
                self.answer_waiters();
                if let Some((answer, error)) = self.waiters.displace() {
                    answer.send(Err(self.refusal(error)));
                }
                None
            }
            Message::Copy(answer) => {
                let whole = Outcome::Whole(Box::new(self.checkpoint()));
                answer.send(Ok((self.place(), whole)));
                None
            }
            Message::Seek(_, _, answer) => {
                answer.send(Err(self.refusal(SwarmError::NotRecorded)));
                None
            }
            Message::Command(command) => self.commands(vec![command]),
            // It looks for itself, before its next step.
            Message::Awake => None,
            Message::Stop => {
                self.journal.keep(Checkpoint {
                    is_last: true,
                    ..self.checkpoint()
                });
                Some(End::Stopped)
            }
        }
    }

    /// Takes one step, and carries out what was put off until the step reached.
    fn step(&mut self) -> Option<End> {
        self.apply_puts();
        let began = Instant::now();
        let late = self.pace.late_by(began);
        let simulation = &mut self.simulation;
        let stepped = catch_unwind(AssertUnwindSafe(|| {
            fail_point!("step");
            simulation.step()
        }));
        let now = Instant::now();
        match stepped {
            Ok(Ok(report)) => {
                self.pace.stepped(now);
                let took = now.saturating_duration_since(began);
                self.since.steps += 1;
                self.since.work += took;
                // What is told again was counted when it was first taken.
                if !self.journal.is_replaying() {
                    self.tally.stepped(took, late, &report);
                }
                if !self.hash_step() {
                    return None;
                }
                if !report.lapsed.is_empty() {
                    self.tell(EventKind::Lapsed(report.lapsed));
                }
            }
            Ok(Err(error)) => {
                self.fault(error.to_string());
                return None;
            }
            Err(_) => {
                self.fault("a defect: the step panicked".into());
                return None;
            }
        }
        let step = self.simulation.state.step;
        if self.phase.until().is_some_and(|until| step >= until) {
            if matches!(self.phase, Phase::Stepping { .. }) {
                self.phase = Phase::Paused(PauseReason::Finished);
            } else {
                self.enter_by(PhaseInput::Reached(step));
            }
            self.record_state();
            self.show();
            self.renew_summary();
            if let Some(end) = self.execute_due() {
                return Some(end);
            }
            // Unless what was due has begun to step anew, or has answered it.
            if !matches!(self.phase, Phase::Stepping { .. }) {
                self.answer_pending(&self.phase.clone());
            }
            self.answer_arrived();
        } else {
            self.record_state();
            if step.is_multiple_of(self.simulation.publish_every) && now >= self.frame_due {
                // Counted from when it was due, so that what a swarm makes good is shown too.
                let grace = self.shortest_between_frames.max(MAX_BACKLOG);
                let grace = now.checked_sub(grace).unwrap_or(now);
                self.frame_due = self.frame_due.max(grace) + self.shortest_between_frames;
                self.show();
            }
            if now.saturating_duration_since(self.summary_renewed) >= SUMMARY_PERIOD {
                self.renew_summary();
            }
            if let Some(end) = self.execute_due() {
                return Some(end);
            }
        }
        self.answer_waiters();
        self.keep_if_due(now);
        None
    }

    /// Writes the hash down now and then. Told again, a step must have the hash it had; false if
    /// it has not.
    fn hash_step(&mut self) -> bool {
        let at = self.at();
        if !at.1.is_multiple_of(HASH_EVERY) {
            return true;
        }
        let hash = self.simulation.state.hash();
        match self.replay.is_as_it_was(at, hash) {
            Some(false) => {
                let step = at.1;
                self.fault(format!(
                    "told again from the journal, step {step} has another hash than it had: the \
                     journal or this build of the daemon is not the one that took it"
                ));
                false
            }
            _ => {
                self.journal.append(at, Record::Hash(hash), None);
                true
            }
        }
    }

    /// The epoch and the step it is at.
    fn at(&self) -> (u64, u64) {
        (self.simulation.epoch, self.simulation.state.step)
    }

    fn keep_if_due(&mut self, now: Instant) {
        if self.since.is_due(now) {
            self.keep();
        }
    }

    /// Has the swarm kept as it is.
    fn keep(&mut self) {
        if !self.journal.is_replaying() {
            self.journal.keep(self.checkpoint());
            crash::point("swarm-kept");
            self.since = Since::new();
        }
    }

    /// Keeps the last good state and says why.
    fn fault(&mut self, reason: String) {
        // A past that is only told again is nobody's.
        if !self.outlet.name.is_empty() {
            warn!(swarm = self.outlet.name, reason, "faulted");
        }
        self.tally.faulted();
        self.phase = Phase::Faulted(reason.clone());
        let at = self.at();
        self.journal.append(at, Record::Fault(reason.clone()), None);
        self.tell(EventKind::Fault(reason.clone()));
        self.show();
        self.renew_summary();
        let faulted = SwarmError::Faulted(reason);
        if let Some(pending) = self.pending.take() {
            pending.answer.send(Err(self.refusal(faulted.clone())));
        }
        for answer in self.controllers.give_up() {
            answer.send(Err(self.refusal(faulted.clone())));
        }
        self.answer_waiters();
    }

    pub(super) fn answer_waiters(&mut self) {
        let mut waiters = std::mem::take(&mut self.waiters);
        let step = self.simulation.state.step;
        waiters.answer(step, &self.phase, || {
            let (place, frame) = self.look_at_all();
            Ok((place, Outcome::Seen(frame)))
        });
        self.waiters = waiters;
    }

    pub(super) fn refusal(&self, error: SwarmError) -> Rejection {
        Rejection {
            step: Some(self.simulation.state.step),
            error,
        }
    }

    pub(super) fn place(&self) -> Place {
        Place {
            epoch: self.simulation.epoch,
            step: self.simulation.state.step,
            time: self.simulation.state.time(),
            phase: self.phase.clone(),
            seq: self.simulation.seq,
        }
    }

    pub(super) fn frame(&self, hashed: bool) -> Arc<Frame> {
        let simulation = &self.simulation;
        Arc::new(Frame {
            place: self.place(),
            parameters: simulation.state.parameters,
            publish_every: simulation.publish_every,
            seed: simulation.state.seed,
            scheduled: self.schedule.count(),
            configuration: simulation.state.configuration.clone(),
            order: simulation.order(),
            means: simulation.means,
            exactness: simulation.exactness,
            rate: self.rate,
            real_time_factor: self.real_time_factor(),
            replay: None,
            controllers: Vec::new(),
            hash: hashed.then(|| simulation.state.hash()),
            gaps: OnceLock::new(),
        })
    }

    fn real_time_factor(&self) -> Option<f64> {
        self.phase
            .is_moving()
            .then(|| self.pace.real_time_factor())
            .flatten()
    }

    /// Shows the state to whoever reads.
    pub(super) fn show(&self) {
        if self.outlet.is_watched(self.phase.is_moving()) {
            self.outlet.show(self.frame(false));
        }
    }

    /// The wall-clock time to give for what happens now, in seconds since 1970. In a replay only
    /// what the journal says is known.
    pub(super) fn unix_secs(&self) -> Option<f64> {
        match self.applied_at {
            Some(at) => at,
            None if self.journal.is_replaying() => None,
            None => clock::unix_secs(),
        }
    }

    /// Executes `work` with one wall-clock time, which its journal line and its events share.
    pub(super) fn applied_at<T>(
        &mut self,
        unix_secs: Option<f64>,
        work: impl FnOnce(&mut Self) -> T,
    ) -> T {
        let outer = self.applied_at.replace(unix_secs);
        let done = work(self);
        self.applied_at = outer;
        done
    }

    /// Passes the state to the recordings, whether or not it is published.
    pub(super) fn record_state(&self) {
        self.outlet.state(self.at(), || self.frame(false));
    }

    pub(super) fn tell(&mut self, kind: EventKind) {
        self.events += 1;
        let event = Event {
            number: self.events,
            place: self.place(),
            unix_secs: self.unix_secs(),
            kind,
        };
        self.history.tell(&event);
        // Whoever read it when it came about is not told again.
        if !self.journal.is_replaying() {
            self.outlet.tell(event);
        }
    }

    pub(super) fn renew_summary(&mut self) {
        self.summary_renewed = Instant::now();
        let configuration = &self.simulation.state.configuration;
        let summary = Summary {
            place: self.place(),
            n: configuration.n(),
            informed: configuration.weight.iter().filter(|w| **w > 0.0).count(),
            order: self.simulation.order().order,
            rate: self.rate,
            real_time_factor: self.real_time_factor(),
            is_replay: false,
        };
        *self.summary.lock().unwrap_or_else(PoisonError::into_inner) = Some(summary);
    }
}
