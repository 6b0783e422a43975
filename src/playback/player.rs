//! Plays a recording on the thread of a hosted name: publishes its frames and events as a swarm
//! publishes its own.

use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use jostle_physics::simulation::{Rate, Spec};
use parking_lot::Mutex;
use tracing::warn;

use crate::playback::mcap::{BYTES_PER_ENTRY, McapSource};
use crate::playback::source::{FrameIndex, RecordedFrame};
use crate::swarm::error::SwarmError;
use crate::swarm::fault::Fault;
use crate::swarm::frame::{self, Event, EventKind, Frame, Replay, Stamp, Summary};
use crate::swarm::handle::{Handle, Message, Outcome, Rejection, ReplyTo, receive};
use crate::swarm::history::History;
use crate::swarm::metrics::SwarmMetrics;
use crate::swarm::output::Output;
use crate::swarm::phase::{PauseReason, Phase};
use crate::swarm::registry::memory_of;
use crate::swarm::runner::{Built, End, Playback, Runner};
use crate::swarm::sender::Sender;
use crate::swarm::waiters::{EventStatus, Waiters};

/// The intervals at which the summary is renewed and the rate is measured while it plays.
const SUMMARY_PERIOD: Duration = Duration::from_millis(100);
const RATE_PERIOD: Duration = Duration::from_secs(1);

impl Playback for McapSource {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn memory_bytes(&self) -> u64 {
        let text: usize = self.events.iter().map(|event| event.what.len()).sum();
        let entries = self.events.len() + 2 * self.index().len();
        let contents = (text + BYTES_PER_ENTRY * entries) as u64;
        memory_of(self.max_individuals).saturating_add(contents)
    }

    fn start(
        self: Box<Self>,
        handle: &Handle,
        min_interval: Duration,
    ) -> Result<Built, SwarmError> {
        let player = Player::new(*self, handle, min_interval)?;
        Ok(((player.stamp(), player.frame()), Box::new(player)))
    }
}

pub struct Player {
    pub(super) source: McapSource,
    spec: Arc<Spec>,
    pub(super) output: Arc<Output>,
    history: Arc<History>,
    metrics: Arc<SwarmMetrics>,
    summary: Arc<Mutex<Option<Summary>>>,
    summary_renewed: Instant,
    min_interval: Duration,
    published: Instant,
    /// The number of the present frame, from 0.
    pub(super) at: usize,
    frame: RecordedFrame,
    passed: usize,
    pub(super) phase: Phase,
    pub(super) rate: Rate,
    /// The time and position from which the present position is computed.
    since: (Instant, f64),
    measured: (Instant, f64),
    real_time_factor: Option<f64>,
    pub(super) epoch: u64,
    seq: u64,
    events: u64,
    pub(super) waiters: Waiters,
}

impl Runner for Player {
    fn run(mut self: Box<Self>, messages: &Receiver<Message>) -> End {
        let metrics = self.metrics.clone();
        loop {
            metrics.activity.begin();
            let next = self.play(Instant::now());
            metrics.activity.end();
            let end = match receive(messages, next) {
                Ok(message) => {
                    metrics.activity.begin();
                    self.handle(message)
                }
                Err(RecvTimeoutError::Timeout) => None,
                Err(RecvTimeoutError::Disconnected) => Some(End::Stopped),
            };
            if let Some(end) = end {
                metrics.activity.end();
                return end;
            }
        }
    }
}

impl Player {
    fn new(
        mut source: McapSource,
        handle: &Handle,
        min_interval: Duration,
    ) -> Result<Self, SwarmError> {
        let frame = source.frame(0).map_err(SwarmError::Playback)?;
        let now = Instant::now();
        let mut player = Player {
            source,
            spec: handle.spec.clone(),
            output: handle.output.clone(),
            history: handle.history.clone(),
            metrics: handle.metrics.clone(),
            summary: handle.summary.clone(),
            summary_renewed: now,
            min_interval,
            published: now,
            at: 0,
            frame,
            passed: 0,
            phase: Phase::Paused(PauseReason::Created),
            rate: handle.spec.rate,
            since: (now, 0.0),
            measured: (now, 0.0),
            real_time_factor: None,
            epoch: 0,
            seq: 0,
            events: 0,
            waiters: Waiters::default(),
        };
        player.passed = player.events_before(0);
        player.publish_event(EventKind::Created(handle.record.creation.clone()));
        player.renew_summary();
        Ok(player)
    }

    /// Advances to the frame that is due. Returns when the next one is, if it plays.
    fn play(&mut self, now: Instant) -> Option<Instant> {
        if !self.phase.is_moving() {
            return None;
        }
        let frame_due = self.published + self.min_interval;
        if now < frame_due {
            return Some(frame_due);
        }
        let index = self.source.index();
        let last = index.len() - 1;
        let due = match self.rate {
            None => self.at + 1,
            Some(rate) => {
                let (from, position) = self.since;
                let reached = position + now.saturating_duration_since(from).as_secs_f64() * rate;
                index.partition_point(|it| it.position <= reached) - 1
            }
        };
        let target = due.clamp(self.at, last);
        let end = self.phase.until().and_then(|until| {
            (self.at..=target).find(|&frame| {
                index[frame].step >= until && index[frame].epoch == index[self.at].epoch
            })
        });
        let target = end.unwrap_or(target);
        let next = index.get(target + 1).map(|it| it.position);
        if target > self.at {
            self.advance_to(target);
        }
        if self.phase.is_moving() && (end.is_some() || target == last) {
            self.enter(Phase::Paused(PauseReason::Finished));
            self.publish_frame();
        }
        self.measure(now);
        self.reply_to_waiters();
        if !self.phase.is_moving() {
            return None;
        }
        let frame_due = self.published + self.min_interval;
        Some(match (self.rate, next) {
            (Some(rate), Some(next)) => {
                let (from, position) = self.since;
                let wait = Duration::try_from_secs_f64((next - position).max(0.0) / rate);
                let due = wait.ok().and_then(|wait| from.checked_add(wait));
                // Beyond the range of the clock: check again later.
                due.unwrap_or(now + Duration::from_secs(3600))
                    .max(frame_due)
            }
            _ => frame_due,
        })
    }

    /// Advances to a later frame, and publishes the events before it.
    pub(super) fn advance_to(&mut self, target: usize) {
        let until = self.events_before(target);
        let events = self.source.events[self.passed..until].to_vec();
        for event in events {
            let stamp = Stamp {
                step: event.step,
                time: event.time,
                ..self.stamp()
            };
            self.publish_event_at(stamp, event.unix_secs, EventKind::Recorded(event.what));
        }
        let index = self.source.index();
        if index[target].epoch != index[self.at].epoch {
            self.epoch += 1;
        }
        self.set_frame(target);
    }

    fn set_frame(&mut self, number: usize) {
        match self.source.frame(number) {
            Ok(frame) => {
                self.frame = frame;
                self.at = number;
                self.passed = self.events_before(number);
                self.publish_frame();
            }
            Err(reason) => {
                warn!(swarm = self.output.name, reason, "faulted");
                self.phase = Phase::Faulted(reason.clone());
                self.publish_event(EventKind::Fault(reason));
                self.publish_frame();
                self.renew_summary();
            }
        }
    }

    fn events_before(&self, frame: usize) -> usize {
        let events = &self.source.events;
        events.partition_point(|event| event.after <= frame)
    }

    /// The first frame of the present epoch of the recorded swarm.
    pub(super) fn present_from(&self) -> usize {
        let index = self.source.index();
        let is_other = |it: &FrameIndex| it.epoch != index[self.at].epoch;
        let before = index[..self.at].iter().rposition(is_other);
        before.map_or(0, |before| before + 1)
    }

    /// The frames of the present epoch of the recorded swarm.
    pub(super) fn present(&self) -> &[FrameIndex] {
        let index = self.source.index();
        let is_other = |it: &FrameIndex| it.epoch != index[self.at].epoch;
        let end = index[self.at..].iter().position(is_other);
        &index[self.present_from()..end.map_or(index.len(), |end| self.at + end)]
    }

    /// Goes to a frame in a new epoch.
    pub(super) fn jump_to(&mut self, frame: usize) {
        self.epoch += 1;
        self.set_frame(frame);
        self.anchor();
        self.renew_summary();
        self.reply_to_waiters();
    }

    /// Restarts the clock of the playback at the present frame.
    pub(super) fn anchor(&mut self) {
        let here = (Instant::now(), self.source.index()[self.at].position);
        (self.since, self.measured) = (here, here);
        self.real_time_factor = None;
    }

    fn measure(&mut self, now: Instant) {
        let (from, position) = self.measured;
        let elapsed = now.saturating_duration_since(from);
        if elapsed >= RATE_PERIOD {
            let here = self.source.index()[self.at].position;
            self.real_time_factor = Some((here - position) / elapsed.as_secs_f64());
            self.measured = (now, here);
        }
        if now.saturating_duration_since(self.summary_renewed) >= SUMMARY_PERIOD {
            self.renew_summary();
        }
    }

    pub(super) fn enter(&mut self, phase: Phase) {
        self.phase = phase;
        self.publish_event(EventKind::Phase);
        self.renew_summary();
    }

    pub(super) fn applied(&mut self, sender: &Arc<Sender>) {
        self.seq += 1;
        self.publish_event(EventKind::Command(sender.clone()));
        self.renew_summary();
    }

    pub(super) fn reply_to_waiters(&mut self) {
        let mut waiters = std::mem::take(&mut self.waiters);
        let step = self.source.index()[self.at].step;
        let state = || Ok((self.stamp(), Outcome::State(self.frame())));
        // A playback has no conditions.
        waiters.reply(step, &self.phase, state, |_| EventStatus::Unknown);
        self.waiters = waiters;
    }

    pub(super) fn reject(&self, reply_to: ReplyTo, error: SwarmError) {
        let step = Some(self.source.index()[self.at].step);
        reply_to.send(Err(Rejection { step, error }));
    }

    pub(super) fn stamp(&self) -> Stamp {
        let at = self.source.index()[self.at];
        Stamp {
            epoch: self.epoch,
            step: at.step,
            time: at.time,
            phase: self.phase.clone(),
            seq: self.seq,
        }
    }

    pub(super) fn duration(&self) -> f64 {
        self.source.index().last().map_or(0.0, |it| it.position)
    }

    pub(super) fn frame(&self) -> Arc<Frame> {
        let index = self.source.index();
        let recorded = self.frame.clone();
        Arc::new(Frame {
            stamp: self.stamp(),
            parameters: recorded.parameters,
            publish_every: self.spec.publish_every,
            measures: Vec::new(),
            max_idle_secs: None,
            is_protected: false,
            earlier_models: Vec::new(),
            seed: self.spec.seed,
            scheduled: 0,
            conditions: Vec::new(),
            configuration: recorded.configuration,
            order: recorded.order,
            means: recorded.means,
            exactness: recorded.exactness,
            fault: matches!(self.phase, Phase::Faulted(_)).then_some(Fault::OTHER),
            rate: self.rate,
            real_time_factor: self.real_time_factor.filter(|_| self.phase.is_moving()),
            is_behind: false,
            published_hz: None,
            // A playback takes no steps.
            stepped: None,
            sequences: BTreeMap::new(),
            controllers: Vec::new(),
            waits: Vec::new(),
            hash: None,
            gaps: OnceLock::from(recorded.gaps),
            values: OnceLock::new(),
            replay: Some(Replay {
                of: self.source.swarm.clone(),
                frame: self.at as u64 + 1,
                frames: index.len() as u64,
                position: index[self.at].position,
                duration: self.duration(),
            }),
        })
    }

    pub(super) fn publish_frame(&mut self) {
        self.published = Instant::now();
        let Stamp { epoch, step, .. } = self.stamp();
        self.output.push_state((epoch, step), || self.frame());
        let is_moving = self.phase.is_moving();
        self.output.push_frame(is_moving, || self.frame());
    }

    pub(super) fn publish_event(&mut self, kind: EventKind) {
        self.publish_event_at(self.stamp(), frame::unix_secs(), kind);
    }

    fn publish_event_at(&mut self, stamp: Stamp, unix_secs: Option<f64>, kind: EventKind) {
        self.events += 1;
        let event = Event {
            number: self.events,
            stamp,
            unix_secs,
            kind,
        };
        self.history.record_event(&event);
        self.output.push_event(&event);
    }

    fn renew_summary(&mut self) {
        self.summary_renewed = Instant::now();
        let configuration = &self.frame.configuration;
        let summary = Summary {
            stamp: self.stamp(),
            n: configuration.n(),
            informed: configuration.weight.iter().filter(|w| **w > 0.0).count(),
            order: self.frame.order.order,
            rate: self.rate,
            real_time_factor: self.real_time_factor.filter(|_| self.phase.is_moving()),
            is_behind: false,
            is_replay: true,
            is_protected: false,
            earlier_models: Vec::new(),
        };
        *self.summary.lock() = Some(summary);
    }
}
