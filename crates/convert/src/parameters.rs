//! Converts parameters from and to their messages. Nowhere else do both sides of a parameter meet: each
//! struct is written and read in full, so that the compiler asks for a new one.

use jostle_physics::model::parameters::{Attraction, ContactRule, Parameters, Stepping};
use jostle_physics::simulation::Settings;
use jostle_proto as proto;
use jostle_proto::ParameterValues;
use jostle_proto::verbs::SetArgs;

use crate::measures::{published, published_to_proto};
use crate::value::{self, ArgsError, WireError};

/// Converts the values of parameters.
///
/// # Errors
///
/// [`WireError::OutOfRange`] for `relinearise`. The model checks the others.
pub fn parameters(values: &ParameterValues, dt: f64) -> Result<Parameters, WireError> {
    let ParameterValues {
        pi1,
        pi2,
        pi3,
        pi4,
        contacts,
        stepping,
        relinearise,
        attraction,
        noise,
        publish_every: _,
        measures: _,
        max_idle_secs: _,
    } = *values;
    Ok(Parameters {
        pi1,
        pi2,
        pi3,
        pi4,
        dt,
        contacts: to_contact_rule(contacts),
        stepping: to_stepping(stepping),
        relinearise: to_relinearise(relinearise)?,
        attraction: to_attraction(attraction),
        noise,
    })
}

/// Returns the message of parameters, and of what else `set` changes.
pub fn values(
    parameters: Parameters,
    publish_every: u64,
    measures: &[String],
    max_idle_secs: Option<f64>,
) -> ParameterValues {
    let Parameters {
        pi1,
        pi2,
        pi3,
        pi4,
        dt: _,
        contacts,
        stepping,
        relinearise,
        attraction,
        noise,
    } = parameters;
    ParameterValues {
        pi1,
        pi2,
        pi3,
        pi4,
        contacts: contact_rule_to_proto(contacts),
        stepping: stepping_to_proto(stepping),
        relinearise: u8::from(relinearise),
        attraction: attraction_to_proto(attraction),
        noise,
        publish_every,
        measures: published_to_proto(measures),
        max_idle_secs,
    }
}

/// Converts the arguments of `set`.
///
/// # Errors
///
/// [`ArgsError`] names the first field that is wrong.
pub fn settings(args: SetArgs) -> Result<Settings, ArgsError> {
    let is_empty = args == SetArgs::default();
    let SetArgs {
        pi1,
        pi2,
        pi3,
        pi4,
        contacts,
        stepping,
        relinearise,
        attraction,
        noise,
        publish_every,
        measures,
        max_idle_secs,
        make_room,
    } = args;
    if make_room && pi1.is_none() {
        return Err(ArgsError::Field {
            field: "make_room",
            problem: "requires a new pi1: give both",
        });
    }
    if is_empty {
        return Err(ArgsError::Field {
            field: "args",
            problem: SetArgs::NONE,
        });
    }
    let publish_every = publish_every.map(value::publish_every).transpose()?;
    let measures = measures.as_deref().map(published).transpose();
    let measures = measures.map_err(WireError::from)?;
    let max_idle_secs = max_idle_secs.map(value::max_idle_secs).transpose()?;
    Ok(Settings {
        pi1,
        pi2,
        pi3,
        pi4,
        contacts: contacts.map(to_contact_rule),
        stepping: stepping.map(to_stepping),
        relinearise: relinearise.map(to_relinearise).transpose()?,
        attraction: attraction.map(to_attraction),
        noise,
        publish_every,
        measures,
        max_idle_secs,
        make_room,
    })
}

/// Returns the arguments of `set`, which [`settings`] converts to the same settings.
pub fn set_args(settings: &Settings) -> SetArgs {
    let Settings {
        pi1,
        pi2,
        pi3,
        pi4,
        contacts,
        stepping,
        relinearise,
        attraction,
        noise,
        publish_every,
        ref measures,
        max_idle_secs,
        make_room,
    } = *settings;
    SetArgs {
        pi1,
        pi2,
        pi3,
        pi4,
        contacts: contacts.map(contact_rule_to_proto),
        stepping: stepping.map(stepping_to_proto),
        relinearise: relinearise.map(u8::from),
        attraction: attraction.map(attraction_to_proto),
        noise,
        publish_every,
        measures: measures.clone(),
        max_idle_secs: max_idle_secs.map(Option::unwrap_or_default),
        make_room,
    }
}

/// Converts a contact rule.
fn to_contact_rule(rule: proto::ContactRule) -> ContactRule {
    match rule {
        proto::ContactRule::Endpoints => ContactRule::Endpoints,
        proto::ContactRule::Closest => ContactRule::Closest,
        proto::ContactRule::Clamped => ContactRule::Clamped,
    }
}

/// Converts the stepping.
fn to_stepping(stepping: proto::Stepping) -> Stepping {
    match stepping {
        proto::Stepping::Position => Stepping::Position,
        proto::Stepping::Velocity => Stepping::Velocity,
    }
}

/// Converts `relinearise`, the number of additional programs that a step solves.
fn to_relinearise(programs: u8) -> Result<bool, WireError> {
    match programs {
        0 => Ok(false),
        1 => Ok(true),
        more => Err(WireError::out_of_range("relinearise", more)),
    }
}

/// Converts a law of attraction.
fn to_attraction(law: proto::Attraction) -> Attraction {
    match law {
        proto::Attraction::All { accuracy } => Attraction::All { accuracy },
        proto::Attraction::Voronoi {} => Attraction::Voronoi,
        proto::Attraction::Metric { radius } => Attraction::Metric { radius },
        proto::Attraction::Topological { neighbours } => Attraction::Topological { neighbours },
        proto::Attraction::Power { exponent } => Attraction::Power { exponent },
    }
}

/// Returns the message of a contact rule.
fn contact_rule_to_proto(rule: ContactRule) -> proto::ContactRule {
    match rule {
        ContactRule::Endpoints => proto::ContactRule::Endpoints,
        ContactRule::Closest => proto::ContactRule::Closest,
        ContactRule::Clamped => proto::ContactRule::Clamped,
    }
}

/// Returns the message of a stepping.
fn stepping_to_proto(stepping: Stepping) -> proto::Stepping {
    match stepping {
        Stepping::Position => proto::Stepping::Position,
        Stepping::Velocity => proto::Stepping::Velocity,
    }
}

/// Returns the message of a law of attraction.
fn attraction_to_proto(law: Attraction) -> proto::Attraction {
    match law {
        Attraction::All { accuracy } => proto::Attraction::All { accuracy },
        Attraction::Voronoi => proto::Attraction::Voronoi {},
        Attraction::Metric { radius } => proto::Attraction::Metric { radius },
        Attraction::Topological { neighbours } => proto::Attraction::Topological { neighbours },
        Attraction::Power { exponent } => proto::Attraction::Power { exponent },
    }
}
