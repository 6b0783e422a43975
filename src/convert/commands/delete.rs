//! `delete`: deletes a swarm.

use jostle_proto::verbs::DeleteArgs;

use crate::swarm::command::Command;

/// Converts the arguments.
pub fn order(DeleteArgs {}: DeleteArgs) -> Command {
    Command::Delete
}
