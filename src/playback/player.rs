//! A recording's thread: it plays the frames and tells the events of a film as a swarm would show
//! its own, and takes the orders that mean something to a film.

use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use jostle_physics::simulation::{Rate, Spec};
use tracing::warn;

use crate::playback::film::{Film, Mark, Shot, Told};
use crate::swarm::clock;
use crate::swarm::error::OrderError;
use crate::swarm::frame::{Event, EventKind, Frame, Place, Replay, Summary};
use crate::swarm::handle::{Command, Handle, Ticket, receive};
use crate::swarm::history::History;
use crate::swarm::order::{Order, Seek, Until, When};
use crate::swarm::outcome::{Outcome, Refusal};
use crate::swarm::outlet::Outlet;
use crate::swarm::phase::{self, Cue, PauseReason, Phase};
use crate::swarm::sender::Sender;
use crate::swarm::tally::Tally;
use crate::swarm::waiters::Waiters;
use crate::swarm::worker::End;

/// How often the summary of a moving film is renewed, and its rate measured.
const SUMMARY_PERIOD: Duration = Duration::from_millis(100);
const RATE_PERIOD: Duration = Duration::from_secs(1);

/// The tolerance between a requested time and a frame's, since decimals are rounded; frames are
/// further apart.
const TIME_ROUNDING: f64 = 1e-9;

/// A film that is shown.
pub struct Player {
    film: Box<dyn Film>,
    recipe: Arc<Spec>,
    outlet: Arc<Outlet>,
    history: Arc<History>,
    tally: Arc<Tally>,
    summary: Arc<Mutex<Option<Summary>>>,
    summary_renewed: Instant,
    shortest_between_frames: Duration,
    shown: Instant,
    at: usize,
    shot: Shot,
    /// Events that have been told, or passed over.
    told: usize,
    phase: Phase,
    rate: Rate,
    /// When it was at which position.
    since: (Instant, f64),
    measured: (Instant, f64),
    real_time_factor: Option<f64>,
    epoch: u64,
    seq: u64,
    events: u64,
    waiters: Waiters,
}

impl Player {
    /// A film at its first frame, paused.
    ///
    /// # Errors
    ///
    /// [`OrderError::Film`] when that cannot be read.
    pub fn new(
        mut film: Box<dyn Film>,
        handle: &Handle,
        shortest_between_frames: Duration,
    ) -> Result<Self, OrderError> {
        let shot = film.shot(0).map_err(OrderError::Film)?;
        let now = Instant::now();
        let mut player = Player {
            film,
            recipe: handle.recipe.clone(),
            outlet: handle.outlet.clone(),
            history: handle.history.clone(),
            tally: handle.tally.clone(),
            summary: handle.summary.clone(),
            summary_renewed: now,
            shortest_between_frames,
            shown: now,
            at: 0,
            shot,
            told: 0,
            phase: Phase::Paused(PauseReason::Created),
            rate: handle.recipe.rate,
            since: (now, 0.0),
            measured: (now, 0.0),
            real_time_factor: None,
            epoch: 0,
            seq: 0,
            events: 0,
            waiters: Waiters::default(),
        };
        player.told = player.told_before(0);
        player.tell(EventKind::Created);
        player.renew_summary();
        Ok(player)
    }

    /// The frame it is at.
    pub fn look(&self) -> (Place, Arc<Frame>) {
        (self.place(), self.frame())
    }

    /// Plays and takes tickets until it ends.
    pub fn run(mut self, tickets: &Receiver<Ticket>) -> End {
        let tally = self.tally.clone();
        loop {
            tally.pulse.beat();
            let next = self.play(Instant::now());
            tally.pulse.rest();
            let end = match receive(tickets, next) {
                Ok(ticket) => {
                    tally.pulse.beat();
                    self.take(ticket)
                }
                Err(RecvTimeoutError::Timeout) => None,
                Err(RecvTimeoutError::Disconnected) => Some(End::Stopped),
            };
            if let Some(end) = end {
                tally.pulse.rest();
                return end;
            }
        }
    }

    /// Goes as far as it is time for; when there is more to be shown, if it moves.
    fn play(&mut self, now: Instant) -> Option<Instant> {
        if !self.phase.is_moving() {
            return None;
        }
        let frame_due = self.shown + self.shortest_between_frames;
        if now < frame_due {
            return Some(frame_due);
        }
        let marks = self.film.marks();
        let last = marks.len() - 1;
        let due = match self.rate {
            None => self.at + 1,
            Some(rate) => {
                let (from, position) = self.since;
                let reached = position + now.saturating_duration_since(from).as_secs_f64() * rate;
                marks.partition_point(|mark| mark.position <= reached) - 1
            }
        };
        let target = due.clamp(self.at, last);
        let end = self.phase.until().and_then(|until| {
            (self.at..=target).find(|&frame| {
                marks[frame].step >= until && marks[frame].epoch == marks[self.at].epoch
            })
        });
        let target = end.unwrap_or(target);
        let next = marks.get(target + 1).map(|mark| mark.position);
        if target > self.at {
            self.go_on_to(target);
        }
        if self.phase.is_moving() && (end.is_some() || target == last) {
            self.enter(Phase::Paused(PauseReason::Finished));
            self.show();
        }
        self.measure(now);
        self.answer_waiters();
        if !self.phase.is_moving() {
            return None;
        }
        let frame_due = self.shown + self.shortest_between_frames;
        Some(match (self.rate, next) {
            (Some(rate), Some(next)) => {
                let (from, position) = self.since;
                let wait = Duration::try_from_secs_f64((next - position).max(0.0) / rate);
                let due = wait.ok().and_then(|wait| from.checked_add(wait));
                // What the clock cannot hold is looked at again now and then.
                due.unwrap_or(now + Duration::from_secs(3600))
                    .max(frame_due)
            }
            _ => frame_due,
        })
    }

    /// Goes on to a later frame, and tells what happened on the way.
    fn go_on_to(&mut self, target: usize) {
        let until = self.told_before(target);
        let told: Vec<Told> = self.film.told()[self.told..until].to_vec();
        for Told {
            step,
            time,
            unix_secs,
            what,
            ..
        } in told
        {
            let place = Place {
                step,
                time,
                ..self.place()
            };
            self.tell_at(place, unix_secs, EventKind::Told(what));
        }
        let marks = self.film.marks();
        if marks[target].epoch != marks[self.at].epoch {
            self.epoch += 1;
        }
        self.put(target);
    }

    /// Puts a frame on show.
    fn put(&mut self, frame: usize) {
        match self.film.shot(frame) {
            Ok(shot) => {
                self.shot = shot;
                self.at = frame;
                self.told = self.told_before(frame);
                self.show();
            }
            Err(reason) => {
                warn!(swarm = self.outlet.name, reason, "faulted");
                self.phase = Phase::Faulted(reason.clone());
                self.tell(EventKind::Fault(reason));
                self.show();
                self.renew_summary();
            }
        }
    }

    /// How many events come before a frame.
    fn told_before(&self, frame: usize) -> usize {
        self.film.told().partition_point(|told| told.after <= frame)
    }

    fn take(&mut self, ticket: Ticket) -> Option<End> {
        match ticket {
            Ticket::Look(answer) => answer.send(Ok((self.place(), Outcome::Seen(self.frame())))),
            Ticket::Wait(waiter) => {
                self.waiters.add(waiter);
                self.answer_waiters();
                if let Some((answer, error)) = self.waiters.displace() {
                    answer.send(Err(self.refusal(error)));
                }
            }
            Ticket::Copy(answer) => answer.send(Err(self.refusal(OrderError::Recorded))),
            Ticket::Seek(seek, sender, answer) => match self.sought(seek) {
                Ok(frame) => {
                    self.applied(&sender);
                    self.jump_to(frame);
                    answer.send(Ok((self.place(), Outcome::Done)));
                }
                Err(error) => answer.send(Err(self.refusal(error))),
            },
            Ticket::Command(command) => return self.command(command),
            Ticket::RecordingFailed(recording, reason) => {
                self.tell(EventKind::RecordingFailed(recording, reason));
            }
            Ticket::Put(..) | Ticket::Lost(_) | Ticket::Awake => {}
            Ticket::Stop => return Some(End::Stopped),
        }
        None
    }

    fn command(&mut self, command: Command) -> Option<End> {
        let Command {
            order,
            when,
            sender,
            answer,
        } = command;
        if order == Order::Delete {
            self.tell(EventKind::Deleted);
            self.waiters.answer_all(|| {
                Err(Refusal {
                    step: None,
                    error: OrderError::Gone,
                })
            });
            let place = self.place();
            return Some(End::Deleted(Box::new(move || {
                answer.send(Ok((place, Outcome::Done)));
            })));
        }
        let done = self.is_when(when).and_then(|()| self.carry_out(&order));
        match done {
            Ok(outcome) => {
                self.applied(&sender);
                answer.send(Ok((self.place(), outcome)));
            }
            Err(error) => answer.send(Err(self.refusal(error))),
        }
        self.answer_waiters();
        None
    }

    fn carry_out(&mut self, order: &Order) -> Result<Outcome, OrderError> {
        match order {
            Order::Run { until, rate } => {
                let marks = self.film.marks();
                let here = marks[self.at];
                let until = match *until {
                    Some(Until::Step(step)) if step < here.step => {
                        return Err(OrderError::Past {
                            until: step,
                            step: here.step,
                        });
                    }
                    Some(Until::Step(step)) => Some(step),
                    Some(Until::Time(time)) => {
                        let mut run = self.present().iter();
                        let reached = run.find(|mark| mark.time >= time);
                        match reached.map(|mark| mark.step) {
                            Some(until) if until < here.step => {
                                let step = here.step;
                                return Err(OrderError::Past { until, step });
                            }
                            until => until,
                        }
                    }
                    None => None,
                };
                let is_over = self.at + 1 == marks.len();
                let phase = phase::next(&self.phase, Cue::Run(until))?;
                if let Some(rate) = rate {
                    self.rate = *rate;
                }
                // A film that is over begins anew.
                if is_over && until.is_none() {
                    self.jump_to(0);
                }
                self.anchor();
                self.enter(phase);
                Ok(Outcome::Runs(until, self.rate))
            }
            Order::Pause => {
                let phase = phase::next(&self.phase, Cue::Pause)?;
                if phase != self.phase {
                    self.enter(phase);
                    self.show();
                }
                Ok(Outcome::Done)
            }
            &Order::Step(steps) => {
                let marks = self.film.marks();
                let from = marks[self.at].step;
                phase::next(&self.phase, Cue::Step(from.saturating_add(steps)))?;
                let target = from.saturating_add(steps);
                let later = (self.at + 1..marks.len())
                    .find(|&frame| marks[frame].step >= target || marks[frame].step < from);
                let later = later.unwrap_or(marks.len() - 1);
                if later > self.at {
                    self.go_on_to(later);
                }
                self.enter(Phase::Paused(PauseReason::Finished));
                let step = self.film.marks()[self.at].step;
                Ok(Outcome::Stepped {
                    steps: step.saturating_sub(from),
                    safe_step: step,
                    seen: self.frame(),
                })
            }
            Order::Reset(None) => {
                self.phase = phase::next(&self.phase, Cue::Reset)?;
                self.jump_to(0);
                self.enter(Phase::Paused(PauseReason::Reset));
                Ok(Outcome::Reset(self.frame()))
            }
            _ => Err(OrderError::Recorded),
        }
    }

    fn is_when(&self, when: When) -> Result<(), OrderError> {
        if when.at_step.is_some() {
            return Err(OrderError::Recorded);
        }
        let step = self.film.marks()[self.at].step;
        let expected = [
            ("epoch", when.expect_epoch, self.epoch),
            ("step", when.expect_step, step),
        ];
        for (what, expected, actual) in expected {
            if let Some(expected) = expected
                && expected != actual
            {
                return Err(OrderError::Conflict {
                    what,
                    expected,
                    actual,
                });
            }
        }
        Ok(())
    }

    /// The frame that is sought: the last that is not later, steps and times counted within the
    /// present run of the recorded swarm.
    ///
    /// # Errors
    ///
    /// [`OrderError::OutsideRecording`] before the first frame of that run and after its last.
    fn sought(&self, seek: Seek) -> Result<usize, OrderError> {
        let marks = self.film.marks();
        let (from, run) = (self.present_from(), self.present());
        let [first, last] = [marks[from], marks[from + run.len() - 1]];
        let (field, value, range, count) = match seek {
            Seek::Step(step) => {
                let range = (first.step as f64, last.step as f64);
                let count = run.partition_point(|mark| mark.step <= step);
                ("step", step as f64, range, count)
            }
            Seek::Time(time) => {
                let count = run.partition_point(|mark| mark.time <= time + TIME_ROUNDING);
                ("time", time, (first.time, last.time), count)
            }
            Seek::Fraction(fraction) => {
                let position = fraction * self.duration();
                let count = marks.partition_point(|mark| mark.position <= position);
                return Ok(count.saturating_sub(1));
            }
        };
        let (first, last) = range;
        if count == 0 || value > last + TIME_ROUNDING {
            return Err(OrderError::OutsideRecording {
                field,
                value,
                first,
                last,
            });
        }
        Ok(from + count - 1)
    }

    /// The first frame of the present run of the recorded swarm.
    fn present_from(&self) -> usize {
        let marks = self.film.marks();
        let is_other = |mark: &Mark| mark.epoch != marks[self.at].epoch;
        let before = marks[..self.at].iter().rposition(is_other);
        before.map_or(0, |before| before + 1)
    }

    /// The frames of the present run of the recorded swarm.
    fn present(&self) -> &[Mark] {
        let marks = self.film.marks();
        let is_other = |mark: &Mark| mark.epoch != marks[self.at].epoch;
        let end = marks[self.at..].iter().position(is_other);
        &marks[self.present_from()..end.map_or(marks.len(), |end| self.at + end)]
    }

    /// Goes to a frame that does not follow the one before.
    fn jump_to(&mut self, frame: usize) {
        self.epoch += 1;
        self.put(frame);
        self.anchor();
        self.renew_summary();
        self.answer_waiters();
    }

    /// Plays on from where it is now.
    fn anchor(&mut self) {
        let here = (Instant::now(), self.film.marks()[self.at].position);
        (self.since, self.measured) = (here, here);
        self.real_time_factor = None;
    }

    fn measure(&mut self, now: Instant) {
        let (from, position) = self.measured;
        let elapsed = now.saturating_duration_since(from);
        if elapsed >= RATE_PERIOD {
            let here = self.film.marks()[self.at].position;
            self.real_time_factor = Some((here - position) / elapsed.as_secs_f64());
            self.measured = (now, here);
        }
        if now.saturating_duration_since(self.summary_renewed) >= SUMMARY_PERIOD {
            self.renew_summary();
        }
    }

    fn enter(&mut self, phase: Phase) {
        self.phase = phase;
        self.tell(EventKind::Phase);
        self.renew_summary();
    }

    /// Counts and tells of a command that was carried out.
    fn applied(&mut self, sender: &Arc<Sender>) {
        self.seq += 1;
        self.tell(EventKind::Command(sender.clone()));
        self.renew_summary();
    }

    fn answer_waiters(&mut self) {
        let mut waiters = std::mem::take(&mut self.waiters);
        let step = self.film.marks()[self.at].step;
        waiters.answer(step, &self.phase, || {
            Ok((self.place(), Outcome::Seen(self.frame())))
        });
        self.waiters = waiters;
    }

    fn refusal(&self, error: OrderError) -> Refusal {
        Refusal {
            step: Some(self.film.marks()[self.at].step),
            error,
        }
    }

    fn place(&self) -> Place {
        let mark = self.film.marks()[self.at];
        Place {
            epoch: self.epoch,
            step: mark.step,
            time: mark.time,
            phase: self.phase.clone(),
            seq: self.seq,
        }
    }

    fn duration(&self) -> f64 {
        self.film.marks().last().map_or(0.0, |mark| mark.position)
    }

    fn frame(&self) -> Arc<Frame> {
        let marks = self.film.marks();
        let Shot {
            parameters,
            configuration,
            order,
            means,
            exactness,
            gaps,
        } = self.shot.clone();
        Arc::new(Frame {
            place: self.place(),
            parameters,
            publish_every: self.recipe.publish_every,
            seed: self.recipe.seed,
            scheduled: 0,
            configuration,
            order,
            means,
            exactness,
            rate: self.rate,
            real_time_factor: self.real_time_factor.filter(|_| self.phase.is_moving()),
            controllers: Vec::new(),
            hash: None,
            gaps: OnceLock::from(gaps),
            replay: Some(Replay {
                of: self.film.swarm().clone(),
                frame: self.at as u64 + 1,
                frames: marks.len() as u64,
                position: marks[self.at].position,
                duration: self.duration(),
            }),
        })
    }

    fn show(&mut self) {
        self.shown = Instant::now();
        let Place { epoch, step, .. } = self.place();
        self.outlet.state((epoch, step), || self.frame());
        if self.outlet.is_watched(self.phase.is_moving()) {
            self.outlet.show(self.frame());
        }
    }

    fn tell(&mut self, kind: EventKind) {
        self.tell_at(self.place(), clock::unix_secs(), kind);
    }

    fn tell_at(&mut self, place: Place, unix_secs: Option<f64>, kind: EventKind) {
        self.events += 1;
        let event = Event {
            number: self.events,
            place,
            unix_secs,
            kind,
        };
        self.history.tell(&event);
        self.outlet.tell(event);
    }

    fn renew_summary(&mut self) {
        self.summary_renewed = Instant::now();
        let configuration = &self.shot.configuration;
        let summary = Summary {
            place: self.place(),
            n: configuration.n(),
            informed: configuration.weight.iter().filter(|w| **w > 0.0).count(),
            order: self.shot.order.order,
            rate: self.rate,
            real_time_factor: self.real_time_factor.filter(|_| self.phase.is_moving()),
            is_replay: true,
        };
        *self.summary.lock().unwrap_or_else(PoisonError::into_inner) = Some(summary);
    }
}
