//! The controllers of a swarm: what happens is passed to them, and their effects are carried out.
//!
//! A deadline that fires, a token that is lost and set-points that are applied are internal commands,
//! which are journaled when they are executed: a replay executes them at the same steps.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::suspension;
use crate::swarm::command::Command;
use crate::swarm::controllers::{Effect, Expiry, Input, Swarm, TimeLimits};
use crate::swarm::error::SwarmError;
use crate::swarm::frame::EventKind;
use crate::swarm::handle::{Outcome, ReplyTo};
use crate::swarm::history::Entry;
use crate::swarm::phase::Phase;
use crate::swarm::sender::Sender;
use crate::swarm::worker::{End, Worker};

impl Worker {
    /// Passes an input that is no command to the controllers.
    pub(super) fn notify_controllers(&mut self, input: Input) {
        if !self.controllers.is_empty() {
            // Only commands are rejected.
            let _ = self.control(input, None);
        }
    }

    /// Passes an input to the controllers and carries out its effects. A command comes with the number
    /// of its journal line, 0 if it has none.
    pub(super) fn control(
        &mut self,
        input: Input,
        command: Option<(u64, &Arc<Sender>)>,
    ) -> Result<Outcome, SwarmError> {
        // The buffer is kept, so that an exchange allocates none.
        let mut effects = std::mem::take(&mut self.effects);
        let mut swarm = Swarm {
            simulation: &mut self.simulation,
            phase: self.phase.clone(),
            now: Instant::now(),
            is_replaying: self.journal.is_replaying(),
            effects: &mut effects,
        };
        let outcome = self.controllers.on(input, &mut swarm);
        let mut reached = None;
        for effect in effects.drain(..) {
            match (effect, command) {
                (Effect::Enter(phase), _) => {
                    let was_moving = std::mem::replace(&mut self.phase, phase).is_moving();
                    match self.phase {
                        Phase::Stepping { until } => self.journal.append_step(until),
                        _ => self.journal.interrupt(self.simulation.state.step),
                    }
                    if !was_moving {
                        self.reset_pace();
                    }
                }
                (Effect::Pause(reason), _) => {
                    let paused = Phase::Paused(reason);
                    self.reply_to_pending(&paused);
                    self.enter(paused);
                }
                (Effect::Advanced(reply_to, from, news, phase), _) => {
                    let (stamp, durable_step, frame) = reached.get_or_insert_with(|| {
                        let (stamp, frame) = self.stamp_and_frame();
                        let durable_step = self.journal.durable_step_of(stamp.step);
                        (stamp, durable_step, frame)
                    });
                    stamp.phase = phase;
                    let outcome = Outcome::Advanced {
                        steps: stamp.step - from,
                        durable_step: *durable_step,
                        frame: frame.clone(),
                        news,
                    };
                    reply_to.send(Ok((stamp.clone(), outcome)));
                }
                (Effect::Reject(reply_to, error), _) => self.reject(reply_to, error),
                (Effect::Journal(until), Some((line, sender))) => {
                    let record = self.applied_record(line, sender);
                    self.journal.append(self.at(), record, until);
                }
                (Effect::Record, Some((_, sender))) => self.history.record_command(Entry {
                    stamp: self.stamp(),
                    unix_secs: self.unix_secs(),
                    sender: sender.clone(),
                }),
                (Effect::Publish, Some((_, sender))) => {
                    self.push_event(EventKind::Command(sender.clone()));
                }
                (Effect::PublishState, _) if !self.phase.is_moving() => self.push_frame(),
                // Only commands are journaled and published.
                (Effect::Journal(_) | Effect::Record | Effect::Publish, None)
                | (Effect::PublishState, _) => {}
            }
        }
        self.effects = effects;
        let is_watching = !self.controllers.is_empty() && !self.journal.is_replaying();
        if is_watching != self.suspensions.is_some() {
            self.suspensions = is_watching.then(suspension::watch);
        }
        outcome
    }

    /// When something runs out next for a controller. A faulted swarm keeps its last good state, with its
    /// controllers, until a reset.
    pub(super) fn controllers_due(&self) -> Option<Instant> {
        // Without controllers the heartbeat is not read, which all swarms share.
        if self.controllers.is_empty() || self.is_faulted() {
            return None;
        }
        self.controllers.due(&self.time_limits())
    }

    fn time_limits(&self) -> TimeLimits {
        let max_idle = self.simulation.max_idle_secs;
        TimeLimits {
            max_idle: max_idle.map(Duration::from_secs_f64),
            resumed: suspension::resumed(),
        }
    }

    pub(super) fn fire_deadlines(&mut self) -> Option<End> {
        let limits = self.time_limits();
        let mut overdue = self
            .controllers
            .overdue(Instant::now(), &limits)
            .into_iter();
        overdue.find_map(|(controller, expiry)| self.expire(controller, expiry))
    }

    fn expire(&mut self, controller: String, expiry: Expiry) -> Option<End> {
        let (verb, command): (_, fn(String) -> Command) = match expiry {
            Expiry::Deadline => ("deadline", Command::Deadline),
            Expiry::Lost => ("lost", Command::Lost),
            Expiry::Idle => ("idle", Command::Idle),
        };
        // One that has left drops its token too: then the command is rejected, without a trace.
        let sender = internal_sender(verb, &controller);
        self.apply_internal(command(controller), sender)
    }

    /// After a restart, of which clients may learn only now: a controller whose token is not `declared` may
    /// declare it, as after a suspension.
    pub fn await_tokens(&mut self, declared: &BTreeSet<String>) {
        let now = Instant::now();
        let is_absent = |name: &&str| !declared.contains(*name);
        let joined = self.controllers.names().filter(is_absent);
        let joined: Vec<String> = joined.map(str::to_owned).collect();
        for controller in joined {
            self.notify_controllers(Input::Away(&controller, now));
        }
        let joining = self.schedule.iter().filter_map(|it| match &it.command {
            Command::Join(options) => Some(options.controller.as_str()),
            _ => None,
        });
        let joining = joining.filter(is_absent).map(|it| (it.to_owned(), now));
        self.absent.extend(joining);
    }

    /// Removes a controller whose token is gone: after a suspension of the daemon only if the controller
    /// does not connect again within the grace, and in a faulted swarm after a reset.
    pub(super) fn token_lost(&mut self, controller: String) -> Option<End> {
        let (now, resumed) = (Instant::now(), suspension::resumed_within_grace());
        let away_since = resumed.or_else(|| now.checked_sub(suspension::GRACE));
        let away_since = away_since.unwrap_or(now);
        let joins =
            |command: &Command| matches!(command, Command::Join(it) if it.controller == controller);
        if self.schedule.iter().any(|it| joins(&it.command)) {
            self.absent.insert(controller.clone(), away_since);
        }
        if resumed.is_none() && !self.is_faulted() {
            return self.expire(controller, Expiry::Lost);
        }
        self.notify_controllers(Input::Away(&controller, away_since));
        None
    }

    /// Notes that the token of a controller is declared.
    pub(super) fn token_declared(&mut self, controller: &str) {
        self.absent.remove(controller);
        self.notify_controllers(Input::Returned(controller));
    }

    /// If a controller that was scheduled to join has lost its token before it did, it is away from then on.
    /// Without a grace it is lost before the next step, after all commands that are scheduled for this one: a
    /// replay has them in this order.
    pub(super) fn joined(&mut self, controller: &str) {
        if let Some(since) = self.absent.remove(controller) {
            self.notify_controllers(Input::Away(controller, since));
        }
    }

    pub(super) fn apply_puts(&mut self) {
        let puts = self.controllers.take_puts();
        if puts.is_empty() {
            return;
        }
        for (command, sender) in puts {
            // Set-points never end a swarm.
            let _ = self.apply_internal(command, sender);
        }
        self.notify_controllers(Input::Updated);
    }

    fn apply_internal(&mut self, command: Command, sender: Arc<Sender>) -> Option<End> {
        // A faulted swarm keeps its last good state until a reset.
        if self.is_faulted() {
            return None;
        }
        self.since_checkpoint.inputs += 1;
        self.applied_at(self.unix_secs(), |it| {
            it.execute(0, command, sender, ReplyTo::ignored())
        })
    }
}

/// The sender of an internal command about a controller. Names of controllers need no JSON escapes.
fn internal_sender(verb: &'static str, controller: &str) -> Arc<Sender> {
    Arc::new(Sender {
        verb,
        args: format!("{{\"controller\":\"{controller}\"}}"),
        ..Sender::default()
    })
}
