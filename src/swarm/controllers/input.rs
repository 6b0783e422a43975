//! The inputs and effects of the controllers of a swarm.

use std::sync::Arc;
use std::time::Instant;

use jostle_physics::simulation::Simulation;

use crate::swarm::command::Command;
use crate::swarm::error::SwarmError;
use crate::swarm::handle::ReplyTo;
use crate::swarm::membership::{News, Put};
use crate::swarm::phase::{PauseReason, Phase};
use crate::swarm::sender::Sender;

/// A command of a controller, or what happens to the swarm.
pub enum Input<'a> {
    /// A command, who sent it, and who receives the reply to an `advance`.
    Command(&'a Command, &'a Arc<Sender>, &'a mut ReplyTo),
    /// A controller puts set-points for the next step, `None` if they could not be parsed, and for an
    /// epoch if it is known.
    Put(&'a str, Option<u64>, Option<Put>),
    /// The swarm has reached the step at which it pauses.
    Reached,
    /// Another command ends the pending advances; this phase follows.
    Interrupted(Phase),
    Faulted(SwarmError),
    /// The liveliness token of a controller is gone, and may be declared again since this time.
    Away(&'a str, Instant),
    /// The liveliness token of a controller is declared.
    Returned(&'a str),
    /// The swarm is back at its start; this phase follows.
    Restarted(Phase),
    Changed,
    /// The phase has changed, or set-points were applied.
    Updated,
}

/// What the thread of the swarm does after an input.
pub enum Effect {
    /// Enter a phase without an event: the controllers know it from their replies.
    Enter(Phase),
    /// Pause, also a `step` that is being executed, with an event.
    Pause(PauseReason),
    /// Reply to an advance that began at this step: the news, and the phase of the swarm in the reply.
    Advanced(ReplyTo, u64, News, Phase),
    Reject(ReplyTo, SwarmError),
    /// Journal the command. Once its line is durable, so are the steps up to this one.
    Journal(Option<u64>),
    /// Record the command for `get/journal` without an event: thousands of these a second would
    /// displace all other events.
    Record,
    Publish,
    /// Publish the state if the swarm does not move.
    PublishState,
}

pub struct Swarm<'a> {
    pub simulation: &'a mut Simulation,
    /// Its phase, after the effects so far.
    pub phase: Phase,
    pub now: Instant,
    /// Whether the input is of the journal.
    pub is_replaying: bool,
    pub effects: &'a mut Vec<Effect>,
}

impl Swarm<'_> {
    pub(super) fn step(&self) -> u64 {
        self.simulation.state.step
    }

    pub(super) fn enter(&mut self, phase: Phase) {
        if self.phase != phase {
            self.phase = phase.clone();
            self.effects.push(Effect::Enter(phase));
        }
    }

    pub(super) fn reject(&mut self, reply_to: Option<ReplyTo>, error: SwarmError) {
        let rejected = reply_to.map(|reply_to| Effect::Reject(reply_to, error));
        self.effects.extend(rejected);
    }
}
