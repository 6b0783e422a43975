//! Converts specs and parameters from and to their messages.

use jostle_physics::model::parameters::{Attraction, ContactRule, Parameters, Stepping};
use jostle_physics::simulation::{Spec, Start};
use jostle_proto as proto;

use crate::measures::{published, published_to_proto};
use crate::value::{WireError, publish_every, rate, whole};

/// Converts the spec in a message. `n` is its number of individuals, which the caller has checked.
///
/// # Errors
///
/// [`WireError`] names the first field that is wrong. The model checks the parameters.
pub fn from_proto(spec: &proto::Spec, n: usize) -> Result<Spec, WireError> {
    let proto::Spec {
        pi1,
        pi2,
        pi3,
        pi4,
        dt,
        noise,
        ..
    } = *spec;
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
    let parameters = Parameters {
        pi1,
        pi2,
        pi3,
        pi4,
        dt,
        contacts: contact_rule(spec.contacts),
        stepping: stepping(spec.stepping),
        relinearise: relinearise(spec.relinearise)?,
        attraction: attraction(spec.attraction),
        noise,
    };
    Ok(Spec {
        n,
        parameters,
        seed: whole("seed", spec.seed)?,
        start,
        publish_every: publish_every(spec.publish_every)?,
        measures: published(spec.measures.as_deref().unwrap_or_default())?,
        rate: rate(spec.rate)?,
    })
}

/// Converts a contact rule.
pub fn contact_rule(rule: proto::ContactRule) -> ContactRule {
    match rule {
        proto::ContactRule::Endpoints => ContactRule::Endpoints,
        proto::ContactRule::Closest => ContactRule::Closest,
        proto::ContactRule::Clamped => ContactRule::Clamped,
    }
}

/// Converts the stepping.
pub fn stepping(stepping: proto::Stepping) -> Stepping {
    match stepping {
        proto::Stepping::Position => Stepping::Position,
        proto::Stepping::Velocity => Stepping::Velocity,
    }
}

/// Converts `relinearise`, the number of additional programs that a step solves.
///
/// # Errors
///
/// [`WireError::OutOfRange`] if it exceeds 1.
pub fn relinearise(programs: u8) -> Result<bool, WireError> {
    match programs {
        0 => Ok(false),
        1 => Ok(true),
        more => Err(WireError::out_of_range("relinearise", more)),
    }
}

/// Converts a law of attraction.
pub fn attraction(law: proto::Attraction) -> Attraction {
    match law {
        proto::Attraction::All { accuracy } => Attraction::All { accuracy },
        proto::Attraction::Voronoi {} => Attraction::Voronoi,
        proto::Attraction::Metric { radius } => Attraction::Metric { radius },
        proto::Attraction::Topological { neighbours } => Attraction::Topological { neighbours },
        proto::Attraction::Power { exponent } => Attraction::Power { exponent },
    }
}

/// Returns the message of a spec, with `seed` as its seed.
pub fn to_proto(spec: &Spec, seed: u64) -> proto::Spec {
    let Parameters {
        pi1,
        pi2,
        pi3,
        pi4,
        dt,
        contacts,
        stepping,
        relinearise,
        attraction,
        noise,
    } = spec.parameters;
    proto::Spec {
        n: spec.n as u64,
        pi1,
        pi2,
        pi3,
        pi4,
        dt,
        contacts: contact_rule_to_proto(contacts),
        stepping: stepping_to_proto(stepping),
        relinearise: u8::from(relinearise),
        seed,
        start: match &spec.start {
            Start::Disc(radius) => proto::Start::Disc { radius: *radius },
            Start::Given { x, y, alpha } => proto::Start::Given {
                x: x.clone(),
                y: y.clone(),
                alpha: alpha.clone(),
            },
        },
        attraction: attraction_to_proto(attraction),
        noise,
        publish_every: spec.publish_every,
        measures: published_to_proto(&spec.measures),
        rate: spec.rate,
    }
}

/// Returns the message of a contact rule.
pub fn contact_rule_to_proto(rule: ContactRule) -> proto::ContactRule {
    match rule {
        ContactRule::Endpoints => proto::ContactRule::Endpoints,
        ContactRule::Closest => proto::ContactRule::Closest,
        ContactRule::Clamped => proto::ContactRule::Clamped,
    }
}

/// Returns the message of a stepping.
pub fn stepping_to_proto(stepping: Stepping) -> proto::Stepping {
    match stepping {
        Stepping::Position => proto::Stepping::Position,
        Stepping::Velocity => proto::Stepping::Velocity,
    }
}

/// Returns the message of a law of attraction.
pub fn attraction_to_proto(law: Attraction) -> proto::Attraction {
    match law {
        Attraction::All { accuracy } => proto::Attraction::All { accuracy },
        Attraction::Voronoi => proto::Attraction::Voronoi {},
        Attraction::Metric { radius } => proto::Attraction::Metric { radius },
        Attraction::Topological { neighbours } => proto::Attraction::Topological { neighbours },
        Attraction::Power { exponent } => proto::Attraction::Power { exponent },
    }
}

/// Returns the message of parameters, and of what else `set` changes.
pub fn parameter_values(
    parameters: Parameters,
    publish_every: u64,
    measures: &[String],
    max_idle_secs: Option<f64>,
) -> proto::ParameterValues {
    proto::ParameterValues {
        pi1: parameters.pi1,
        pi2: parameters.pi2,
        pi3: parameters.pi3,
        pi4: parameters.pi4,
        contacts: contact_rule_to_proto(parameters.contacts),
        stepping: stepping_to_proto(parameters.stepping),
        relinearise: u8::from(parameters.relinearise),
        attraction: attraction_to_proto(parameters.attraction),
        noise: parameters.noise,
        publish_every,
        measures: published_to_proto(measures),
        max_idle_secs,
    }
}
