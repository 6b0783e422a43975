//! The places of users: how many commands a user may schedule in a swarm, and how many controllers a user
//! may have in it.
//!
//! They are checked when a command is received and not when it is executed, so that a replay does not
//! depend on them.

use std::collections::BTreeSet;

use crate::swarm::command::Command;
use crate::swarm::error::SwarmError;
use crate::swarm::handle::CommandMessage;
use crate::swarm::schedule::MAX_SCHEDULED;
use crate::swarm::sender::Sender;
use crate::swarm::worker::Worker;

/// Commands that a user who is no operator may schedule in a swarm.
const USER_SCHEDULED: usize = 64;

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
        if is_scheduled(message) {
            let accepted = accepted.iter().filter(|it| is_scheduled(it));
            let waiting = self.schedule.iter().map(|it| &*it.sender);
            check_scheduled(message, waiting.chain(accepted.map(|it| &*it.sender)))?;
        }
        let Command::Join(options) = &message.command else {
            return Ok(());
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
    let (limit, max_bytes) = match user {
        Some(user) if !user.is_operator() => (USER_SCHEDULED, MAX_SCHEDULED.1),
        _ => MAX_SCHEDULED,
    };
    if count >= limit || (count > 0 && bytes + message.sender.bytes() > max_bytes) {
        return Err(SwarmError::TooManyScheduled {
            count,
            user: user.map(|user| user.name.clone()),
        });
    }
    Ok(())
}
