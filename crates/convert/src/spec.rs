//! Converts specs from and to their messages.

use jostle_physics::simulation::{Spec, Start};
use jostle_proto as proto;

use crate::measures::published;
use crate::parameters::{parameters, values};
use crate::value::{WireError, publish_every, rate, whole};

/// Converts the spec in a message. `n` is its number of individuals, which the caller has checked.
///
/// # Errors
///
/// [`WireError`] names the first field that is wrong. The model checks the parameters.
pub fn from_proto(spec: &proto::Spec, n: usize) -> Result<Spec, WireError> {
    let start = match &spec.start {
        proto::Start::Disc { radius } => Start::Disc(*radius),
        proto::Start::Given { x, y, alpha } => {
            for (field, column) in [("start.x", x), ("start.y", y), ("start.alpha", alpha)] {
                if column.len() != n {
                    return Err(WireError::Length {
                        field,
                        length: column.len(),
                        n: spec.n,
                    });
                }
            }
            Start::Given {
                x: x.clone(),
                y: y.clone(),
                alpha: alpha.clone(),
            }
        }
    };
    Ok(Spec {
        n,
        parameters: parameters(&spec.values(), spec.dt)?,
        seed: whole("seed", spec.seed)?,
        start,
        publish_every: publish_every(spec.publish_every)?,
        measures: published(spec.measures.as_deref().unwrap_or_default())?,
        rate: rate(spec.rate)?,
    })
}

/// Returns the message of a spec, with `seed` as its seed.
pub fn to_proto(spec: &Spec, seed: u64) -> proto::Spec {
    let start = match &spec.start {
        Start::Disc(radius) => proto::Start::Disc { radius: *radius },
        Start::Given { x, y, alpha } => proto::Start::Given {
            x: x.clone(),
            y: y.clone(),
            alpha: alpha.clone(),
        },
    };
    let values = values(spec.parameters, spec.publish_every, &spec.measures, None);
    let (n, dt) = (spec.n as u64, spec.parameters.dt);
    proto::Spec::of(n, dt, seed, start, values, spec.rate)
}
