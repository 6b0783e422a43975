//! Commands that are scheduled for a later step.

use std::sync::Arc;
use std::sync::mpsc::channel;

use crate::swarm::command::Command;
use crate::swarm::error::SwarmError;
use crate::swarm::frame::{self, EventKind};
use crate::swarm::handle::{Rejection, ReplyTo};
use crate::swarm::phase::{self, PhaseInput};
use crate::swarm::schedule::Scheduled;
use crate::swarm::sender::Sender;
use crate::swarm::worker::{End, Worker};

impl Worker {
    /// Schedules a command for `at_step`, after the checks that do not depend on that step.
    pub(super) fn schedule_command(
        &mut self,
        input: u64,
        at_step: u64,
        command: Command,
        sender: Arc<Sender>,
    ) -> Result<(), SwarmError> {
        if !matches!(command, Command::Reset(_) | Command::Delete) {
            phase::next(&self.phase, PhaseInput::Change)?;
        }
        match &command {
            // Now, while its client waits; if the swarm is protected at that step, it is rejected there.
            Command::Reset(_) | Command::Delete if self.is_protected => {
                return Err(self.protected());
            }
            Command::Change(change) => self.simulation.check(change)?,
            Command::Batch { changes, .. } => self.check_changes(changes)?,
            Command::Watch(watch) => self.check_watch(watch)?,
            _ => {}
        }
        let command = Scheduled {
            input,
            command,
            sender: sender.clone(),
        };
        self.schedule.add(at_step, command);
        self.push_event(EventKind::Scheduled(at_step, sender));
        Ok(())
    }

    /// Executes the commands scheduled for this step. Their clients have got their replies, so a
    /// rejection is published as an event.
    pub(super) fn execute_due(&mut self) -> Option<End> {
        while let Some(due) = self.schedule.take(self.simulation.state.step) {
            let end = self.execute_waiting(due);
            if end.is_some() {
                return end;
            }
        }
        None
    }

    /// Executes a command whose client does not wait. A rejection is published as an event.
    pub(super) fn execute_waiting(&mut self, waiting: Scheduled) -> Option<End> {
        let Scheduled {
            input,
            command,
            sender,
        } = waiting;
        let (replied, reply) = channel();
        let reply_to = ReplyTo::new(move |reply| drop(replied.send(reply)));
        let unix_secs = match self.journal.is_replaying() {
            true => self
                .journal
                .outcome(input)
                .and_then(|(_, unix_secs)| unix_secs),
            false => frame::unix_secs(),
        };
        self.applied_at(unix_secs, |it| {
            let end = it.execute(input, command, sender.clone(), reply_to);
            if let Ok(Err(Rejection { error, .. })) = reply.try_recv() {
                it.push_event(EventKind::Rejected(sender, error));
            }
            end
        })
    }

    /// Rejects all scheduled commands, each with the error for its step: after a reset or the end of a
    /// protocol, their steps belong to another run.
    pub(super) fn drop_scheduled(&mut self, to_error: fn(u64) -> SwarmError) {
        for (at_step, Scheduled { input, sender, .. }) in self.schedule.clear() {
            let error = to_error(at_step);
            self.record_outcome(input, Err(&error));
            self.push_event(EventKind::Rejected(sender, error));
        }
    }
}
