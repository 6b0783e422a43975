//! `restore`: a new swarm from a snapshot.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_physics::simulation::ReserveError;
use jostle_proto::keys;
use jostle_proto::verbs::RestoreArgs;

use crate::api::context::{Context, Parsed};
use crate::convert::commands::{CommandError, check_name};
use crate::convert::validate;
use crate::persistence::checkpoints;
use crate::swarm::error::SwarmError;
use crate::swarm::sender::OriginKind;

impl Context {
    pub(super) fn restore(
        &self,
        command: &Parsed<'_>,
        RestoreArgs { name, snapshot }: RestoreArgs,
    ) -> Result<(), CommandError> {
        check_name("name", &name)?;
        let (from, checkpoint) = STANDARD
            .decode(snapshot.as_bytes())
            .map_err(|error| error.to_string())
            .and_then(|bytes| checkpoints::read_snapshot(&bytes))
            .and_then(|it| match validate::check(&it.1) {
                Ok(()) => Ok(it),
                Err(error) => Err(error.to_string()),
            })
            .map_err(CommandError::Snapshot)?;
        // Its size now, and its size after a reset.
        let simulation = &checkpoint.simulation;
        let n = simulation.state.configuration.n().max(simulation.spec.n);
        let limit = self.registry.limits().max_individuals;
        if n > limit {
            return Err(SwarmError::from(ReserveError::TooMany { n, limit }).into());
        }
        // Perhaps a swarm of another daemon.
        let from = (Some(from).filter(|it| keys::is_name(it)), None);
        self.swarm_from_checkpoint(name, (OriginKind::Restore, from), command)
            .create(checkpoint);
        Ok(())
    }
}
