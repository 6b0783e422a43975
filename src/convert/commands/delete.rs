//! `delete`: the end of a swarm.

use jostle_proto::verbs::DeleteArgs;

use crate::swarm::command::Command;

/// Ends the swarm.
pub fn order(DeleteArgs {}: DeleteArgs) -> Command {
    Command::Delete
}
