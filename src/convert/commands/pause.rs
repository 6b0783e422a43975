//! `pause`: stops between two steps.

use jostle_proto::verbs::PauseArgs;

use crate::swarm::command::Command;

/// Converts the arguments.
pub fn order(PauseArgs {}: PauseArgs) -> Command {
    Command::Pause
}
