//! `pause`: stand still between two steps.

use jostle_proto::verbs::PauseArgs;

use crate::swarm::command::Command;

/// Pauses the swarm.
pub fn order(PauseArgs {}: PauseArgs) -> Command {
    Command::Pause
}
