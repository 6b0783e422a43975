//! The places of users: how many commands a user may schedule in a swarm, and how many controllers a user
//! may have in it. The cost of conditions and the weights of scheduled changes are checked here, too.
//!
//! They are checked when a command is received and not when it is executed, so that a replay does not
//! depend on them.

use std::collections::BTreeSet;

use jostle_physics::simulation::{Change, check_weights};

use crate::swarm::command::Command;
use crate::swarm::error::SwarmError;
use crate::swarm::handle::CommandMessage;
use crate::swarm::schedule::MAX_SCHEDULED;
use crate::swarm::sender::Sender;
use crate::swarm::watch::Watch;
use crate::swarm::worker::Worker;

/// Commands that a user who is no operator may schedule in a swarm, and the bytes of their text: they are
/// a part of each checkpoint and snapshot.
const USER_SCHEDULED: (usize, usize) = (64, 32 * 1024);

/// Controllers that a user who is no operator may have in a swarm.
const USER_CONTROLLERS: usize = 64;

impl Worker {
    /// Checks that there is a place for a command. `accepted` are those that were received with it and
    /// are executed before it.
    pub(super) fn check_places(
        &self,
        message: &CommandMessage,
        accepted: &[CommandMessage],
    ) -> Result<(), SwarmError> {
        let step = self.simulation.state.step;
        let is_scheduled = |it: &CommandMessage| it.when.at_step.is_some_and(|at| at > step);
        if is_scheduled(message) || matches!(message.command, Command::Watch(_)) {
            self.check_weights(&message.command, accepted)?;
        }
        if is_scheduled(message) {
            let accepted = accepted.iter().filter(|it| is_scheduled(it));
            let waiting = self.schedule.iter().map(|it| &*it.sender);
            check_scheduled(message, waiting.chain(accepted.map(|it| &*it.sender)))?;
        }
        let options = match &message.command {
            Command::Join(options) => options,
            Command::Watch(watch) => return self.check_cost(watch),
            _ => return Ok(()),
        };
        let Some(user) = message.user.as_ref().filter(|it| !it.is_operator()) else {
            return Ok(());
        };
        let scheduled = self.schedule.iter().map(|it| &it.command);
        let received = scheduled.chain(accepted.iter().map(|it| &it.command));
        let joining = received.filter_map(|command| match command {
            Command::Join(options) => Some(options.controller.as_str()),
            _ => None,
        });
        let names = self.controllers.names().chain(joining);
        let own: BTreeSet<&str> = names.filter(|name| user.owns(name)).collect();
        if own.len() >= USER_CONTROLLERS && !own.contains(options.controller.as_str()) {
            return Err(SwarmError::TooManyOfUser {
                count: own.len(),
                user: user.name.clone(),
            });
        }
        Ok(())
    }
}

impl Worker {
    /// Checks the weights of changes that are executed later, unless another command may set `pi2` before:
    /// they are checked once more when they are executed.
    fn check_weights(
        &self,
        command: &Command,
        accepted: &[CommandMessage],
    ) -> Result<(), SwarmError> {
        let scheduled = self.schedule.iter().map(|it| it.command.changes());
        let accepted = accepted.iter().map(|it| it.command.changes());
        let mut others = scheduled.chain(accepted).chain(self.watches.changes());
        let sets_pi2 = |it: &Change| matches!(it, Change::Set(settings) if settings.pi2.is_some());
        if others.any(|changes| changes.iter().any(sets_pi2)) {
            return Ok(());
        }
        let checked = check_weights(command.changes(), self.simulation.state.parameters.pi2);
        checked.map_err(|(index, error)| match command {
            Command::Change(_) => error.into(),
            _ => SwarmError::in_batch((index, error)),
        })
    }

    /// Checks that a condition does not cost too much beside those that wait or are scheduled. No other one is
    /// received with it: [`Worker::handle_batch`] ends there.
    fn check_cost(&self, watch: &Watch) -> Result<(), SwarmError> {
        // A faulted swarm has a better error.
        if self.is_faulted() {
            return Ok(());
        }
        let scheduled = self.schedule.iter().filter_map(|it| match &it.command {
            Command::Watch(watch) => Some(&**watch),
            _ => None,
        });
        let n = self.simulation.state.configuration.n();
        self.watches.check_cost(watch, scheduled, n)
    }
}

/// Checks that a command may be scheduled besides those of `waiting` that take places of the same user, or
/// without users besides all.
fn check_scheduled<'a>(
    message: &CommandMessage,
    waiting: impl Iterator<Item = &'a Sender>,
) -> Result<(), SwarmError> {
    let user = message.user.as_ref();
    let is_counted = |it: &&Sender| user.is_none_or(|user| user.sent(it.client.as_deref()));
    let sizes = waiting.filter(is_counted).map(Sender::bytes);
    let (count, bytes) = sizes.fold((0, 0), |(count, sum), bytes| (count + 1, sum + bytes));
    let is_limited = user.is_some_and(|user| !user.is_operator());
    let (limit, max_bytes) = match is_limited {
        true => USER_SCHEDULED,
        false => MAX_SCHEDULED,
    };
    let is_over = bytes + message.sender.bytes() > max_bytes;
    if count >= limit || (is_over && (is_limited || count > 0)) {
        return Err(SwarmError::TooManyScheduled {
            count,
            max_bytes,
            user: user.map(|user| user.name.clone()),
        });
    }
    Ok(())
}
