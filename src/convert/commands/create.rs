//! `create`: creates a swarm.

use jostle_physics::simulation::{ChangeError, Spec};
use jostle_proto::verbs::CreateArgs;

use crate::convert::commands::{CommandError, check_name};
use crate::swarm::error::SwarmError;
use crate::swarm::frame::check_sizes;
use crate::swarm::registry::Limits;

/// Checks the name and the spec of a new swarm.
pub fn spec(args: &CreateArgs, limits: Limits) -> Result<Spec, CommandError> {
    check_name("name", &args.name)?;
    let n = usize::try_from(args.spec.n)
        .ok()
        .filter(|n| (1..=limits.max_individuals).contains(n));
    let spec = match n {
        Some(n) => checked(args, n),
        None => Err(CommandError::Individuals {
            n: args.spec.n,
            limit: limits.max_individuals,
        }),
    };
    spec.map_err(within_spec)
}

fn checked(args: &CreateArgs, n: usize) -> Result<Spec, CommandError> {
    let spec = jostle_convert::spec::from_proto(&args.spec, n)?;
    check_sizes(&spec.measures, n).map_err(SwarmError::from)?;
    Ok(spec)
}

/// Returns the error of a swarm that cannot be created from its spec.
pub fn explain(error: SwarmError) -> CommandError {
    match error {
        SwarmError::Change(ChangeError::Parameters(_) | ChangeError::Start(_)) => {
            within_spec(error.into())
        }
        other => other.into(),
    }
}

fn within_spec(error: CommandError) -> CommandError {
    error.within("spec".into())
}
