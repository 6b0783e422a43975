//! The commands that a playback executes: run, pause, step, reset, seek and delete.

use tracing::info;

use super::player::Player;
use crate::swarm::command::{Command, Seek, Until, When};
use crate::swarm::error::SwarmError;
use crate::swarm::frame::EventKind;
use crate::swarm::handle::{CommandMessage, DeferredReply, Message, Outcome};
use crate::swarm::phase::{self, PauseReason, Phase, PhaseInput};
use crate::swarm::runner::End;

/// The tolerance between a requested time and a frame's, since decimals are rounded; frames are
/// further apart.
const TIME_ROUNDING: f64 = 1e-9;

impl Player {
    /// Handles a message. Returns how the playback ends, if it does.
    pub(super) fn handle(&mut self, message: Message) -> Option<End> {
        match message {
            Message::Query(answer) => answer.send(Ok((self.stamp(), Outcome::State(self.frame())))),
            Message::Wait(waiter) => {
                self.waiters.add(waiter);
                self.reply_to_waiters();
            }
            Message::WaitFor(wait) => self.reject(wait.reply_to, SwarmError::NoConditions),
            Message::TakeCheckpoint(answer) => self.reject(answer, SwarmError::Recorded),
            Message::Seek(seek, sender, answer) => match self.find(seek) {
                Ok(frame) => {
                    self.applied(&sender);
                    self.jump_to(frame);
                    answer.send(Ok((self.stamp(), Outcome::Done)));
                }
                Err(error) => self.reject(answer, error),
            },
            Message::Command(command) => return self.command(command),
            Message::RecordingFailed(recording, reason) => {
                self.publish_event(EventKind::RecordingFailed(recording, reason));
            }
            Message::Put(..)
            | Message::TokenLost(_)
            | Message::TokenDeclared(_)
            | Message::Wake => {}
            Message::Stop => return Some(End::Stopped),
        }
        None
    }

    fn command(&mut self, message: CommandMessage) -> Option<End> {
        let CommandMessage {
            command,
            when,
            sender,
            reply_to,
            ..
        } = message;
        if command == Command::Delete {
            info!(swarm = self.output.name, client = sender.client, "deleted");
            self.publish_event(EventKind::Deleted(sender));
            self.waiters.reject_all(None);
            let stamp = self.stamp();
            let reply = DeferredReply::new(reply_to, Ok((stamp, Outcome::Done)));
            return Some(End::Deleted(reply));
        }
        let done = self.check(when).and_then(|()| self.execute(&command));
        match done {
            Ok(outcome) => {
                self.applied(&sender);
                reply_to.send(Ok((self.stamp(), outcome)));
            }
            Err(error) => self.reject(reply_to, error),
        }
        self.reply_to_waiters();
        None
    }

    fn execute(&mut self, command: &Command) -> Result<Outcome, SwarmError> {
        match command {
            Command::Run { until, rate } => {
                let index = self.source.index();
                let until = match *until {
                    Some(Until::Step(step)) => Some(step),
                    Some(Until::Time(time)) => {
                        let mut run = self.present().iter();
                        run.find(|it| it.time >= time).map(|it| it.step)
                    }
                    None => None,
                };
                SwarmError::check_not_past(until, index[self.at].step)?;
                let is_over = self.at + 1 == index.len();
                let phase = phase::next(&self.phase, PhaseInput::Run(until))?;
                if let Some(rate) = rate {
                    self.rate = *rate;
                }
                // At the end it restarts.
                if is_over && until.is_none() {
                    self.jump_to(0);
                }
                self.anchor();
                self.enter(phase);
                Ok(Outcome::Runs(until, self.rate))
            }
            Command::Pause => {
                let phase = phase::next(&self.phase, PhaseInput::Pause)?;
                if phase != self.phase {
                    self.enter(phase);
                    self.publish_frame();
                }
                Ok(Outcome::Done)
            }
            &Command::Step(steps) => {
                let index = self.source.index();
                let from = index[self.at].step;
                phase::next(&self.phase, PhaseInput::Step(from.saturating_add(steps)))?;
                let target = from.saturating_add(steps);
                let later = (self.at + 1..index.len())
                    .find(|&frame| index[frame].step >= target || index[frame].step < from);
                let later = later.unwrap_or(index.len() - 1);
                if later > self.at {
                    self.advance_to(later);
                }
                self.enter(Phase::Paused(PauseReason::Finished));
                let step = self.source.index()[self.at].step;
                Ok(Outcome::Stepped {
                    steps: step.saturating_sub(from),
                    durable_step: step,
                    frame: self.frame(),
                })
            }
            Command::Reset(None) => {
                self.phase = phase::next(&self.phase, PhaseInput::Reset)?;
                self.jump_to(0);
                self.enter(Phase::Paused(PauseReason::Reset));
                Ok(Outcome::Reset(self.frame()))
            }
            Command::Reset(Some(_))
            | Command::Change(_)
            | Command::Batch { .. }
            | Command::Join(_)
            | Command::Advance { .. }
            | Command::Leave(_)
            | Command::Deadline(_)
            | Command::Lost(_)
            | Command::Idle(_)
            | Command::Control { .. }
            | Command::Annotate
            | Command::Protect(_)
            | Command::Watch(_)
            | Command::Unwatch(_)
            | Command::Fired(_)
            | Command::Delete => Err(SwarmError::Recorded),
        }
    }

    fn check(&self, when: When) -> Result<(), SwarmError> {
        if when.at_step.is_some() {
            return Err(SwarmError::Recorded);
        }
        when.check(self.epoch, self.source.index()[self.at].step)
    }

    /// The frame that `seek` names: the last one that is not later. Steps and times are those of the
    /// present epoch of the recorded swarm.
    ///
    /// # Errors
    ///
    /// [`SwarmError::OutsideRecording`] before the first frame of that epoch and after its last.
    fn find(&self, seek: Seek) -> Result<usize, SwarmError> {
        let index = self.source.index();
        let (from, run) = (self.present_from(), self.present());
        let [first, last] = [index[from], index[from + run.len() - 1]];
        let (field, value, range, count) = match seek {
            Seek::Step(step) => {
                let range = (first.step as f64, last.step as f64);
                let count = run.partition_point(|it| it.step <= step);
                ("step", step as f64, range, count)
            }
            Seek::Time(time) => {
                let count = run.partition_point(|it| it.time <= time + TIME_ROUNDING);
                ("time", time, (first.time, last.time), count)
            }
            Seek::Fraction(fraction) => {
                let position = fraction * self.duration();
                let count = index.partition_point(|it| it.position <= position);
                return Ok(count.saturating_sub(1));
            }
        };
        let (first, last) = range;
        if count == 0 || value > last + TIME_ROUNDING {
            return Err(SwarmError::OutsideRecording {
                field,
                value,
                first,
                last,
            });
        }
        Ok(from + count - 1)
    }
}
