//! The controllers of a swarm: what happens is passed to them, and their effects are carried out.
//!
//! A deadline that fires, a token that is lost and set-points that are applied are internal commands,
//! which are journaled when they are executed: a replay executes them at the same steps.

use std::sync::Arc;
use std::time::Instant;

use crate::swarm::command::Command;
use crate::swarm::controllers::{Effect, Input, Swarm};
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
        outcome
    }

    pub(super) fn fire_deadlines(&mut self) -> Option<End> {
        let mut overdue = self.controllers.overdue(Instant::now()).into_iter();
        overdue.find_map(|controller| {
            let sender = internal_sender("deadline", &controller);
            self.apply_internal(Command::Deadline(controller), sender)
        })
    }

    pub(super) fn remove_lost(&mut self, controller: String) -> Option<End> {
        // One that has left drops its token too: then the command is rejected, without a trace.
        let sender = internal_sender("lost", &controller);
        self.apply_internal(Command::Lost(controller), sender)
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
        if matches!(self.phase, Phase::Faulted(_)) {
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
