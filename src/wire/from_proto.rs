//! What clients send, checked as far as it can be without a swarm.

use jostle_proto as proto;
use jostle_proto::verbs::{self, Pose, Region, Select};
use serde_json::Value;
use thiserror::Error;

use crate::model::injection;
use crate::model::parameters::{Attraction, ContactRule, Parameters, Stepping};
use crate::model::selection::Selection;
use crate::swarm::control::{Departure, Miss, Mode, News, OnTimeout};
use crate::swarm::order::{Rate, Recipe, Start};

/// The largest whole number that every client can hold: doubles are exact up to here.
const LARGEST_WHOLE: u64 = (1 << 53) - 1;

/// The fastest rate, in time units per second of wall clock.
const FASTEST_RATE: f64 = 1e6;

/// The most steps between two published states.
const LONGEST_PUBLISHING: u64 = 1_000_000_000;

/// Why a value that crossed the wire is refused.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum WireError {
    /// A number is outside its range.
    #[error("{field} = {value} is outside its range")]
    OutOfRange {
        /// Which.
        field: &'static str,
        /// The value refused.
        value: Value,
    },
    /// A column does not have one number for each individual.
    #[error("{field} has {length} numbers, n is {n}")]
    Length {
        /// Which column.
        field: &'static str,
        /// Its length.
        length: usize,
        /// What it should be.
        n: u64,
    },
}

impl WireError {
    /// A number outside its range.
    pub fn out_of_range<V: Copy + Into<Value> + ToString>(field: &'static str, value: V) -> Self {
        WireError::OutOfRange {
            field,
            // What JSON has no number for is spelled out.
            value: match value.into() {
                Value::Null => value.to_string().into(),
                value => value,
            },
        }
    }
}

/// What a spec of `n` individuals describes. `n` has been admitted.
///
/// # Errors
///
/// [`WireError`] names the first field that is wrong; parameters are the model's to check.
pub fn recipe(spec: &proto::Spec, n: usize) -> Result<Recipe, WireError> {
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
    Ok(Recipe {
        n,
        parameters,
        seed: whole("seed", spec.seed)?,
        start,
        publish_every: publish_every(spec.publish_every)?,
        rate: rate(spec.rate)?,
    })
}

/// The rule by which contacts are chosen.
pub fn contact_rule(rule: proto::ContactRule) -> ContactRule {
    match rule {
        proto::ContactRule::Endpoints => ContactRule::Endpoints,
        proto::ContactRule::Closest => ContactRule::Closest,
        proto::ContactRule::Clamped => ContactRule::Clamped,
    }
}

/// What contacts limit.
pub fn stepping(stepping: proto::Stepping) -> Stepping {
    match stepping {
        proto::Stepping::Position => Stepping::Position,
        proto::Stepping::Velocity => Stepping::Velocity,
    }
}

/// Whether a second program is solved.
///
/// # Errors
///
/// [`WireError::OutOfRange`] for more than one.
pub fn relinearise(programs: u8) -> Result<bool, WireError> {
    match programs {
        0 => Ok(false),
        1 => Ok(true),
        more => Err(WireError::out_of_range("relinearise", more)),
    }
}

/// The law of attraction.
pub fn attraction(law: proto::Attraction) -> Attraction {
    match law {
        proto::Attraction::All { accuracy } => Attraction::All { accuracy },
        proto::Attraction::Voronoi {} => Attraction::Voronoi,
        proto::Attraction::Metric { radius } => Attraction::Metric { radius },
        proto::Attraction::Topological { neighbours } => Attraction::Topological { neighbours },
        proto::Attraction::Power { exponent } => Attraction::Power { exponent },
    }
}

/// Set-points that were put, in CBOR or JSON.
///
/// # Errors
///
/// What is wrong with them.
pub fn control(bytes: &[u8], is_cbor: bool) -> Result<verbs::Control, String> {
    match is_cbor {
        true => ciborium::from_reader(bytes).map_err(|error| error.to_string()),
        false => serde_json::from_slice(bytes).map_err(|error| error.to_string()),
    }
}

/// How a controller takes part.
pub fn mode(mode: verbs::Mode) -> Mode {
    match mode {
        verbs::Mode::Lockstep => Mode::Lockstep,
        verbs::Mode::FreeRunning => Mode::FreeRunning,
    }
}

/// What becomes of the individuals of a controller that is late.
pub fn on_timeout(on_timeout: verbs::OnTimeout) -> OnTimeout {
    match on_timeout {
        verbs::OnTimeout::Hold => OnTimeout::Hold,
        verbs::OnTimeout::Free => OnTimeout::Free,
        verbs::OnTimeout::Pause => OnTimeout::Pause,
    }
}

/// What a controller is to be told.
pub fn news(news: verbs::News) -> News {
    let missed = news.missed.into_iter().map(|miss| Miss {
        controller: miss.controller,
        step: miss.step,
        misses: miss.misses,
    });
    let left = news.left.into_iter().map(|departed| {
        let why = match departed.why {
            verbs::Departure::Left => Departure::Left,
            verbs::Departure::Lost => Departure::Lost,
            verbs::Departure::Late => Departure::Late,
        };
        (departed.controller, why)
    });
    News {
        missed: missed.collect(),
        left: left.collect(),
        removed: news.removed,
    }
}

/// A whole number that every client can hold.
///
/// # Errors
///
/// [`WireError::OutOfRange`].
pub fn whole(field: &'static str, number: u64) -> Result<u64, WireError> {
    if number <= LARGEST_WHOLE {
        return Ok(number);
    }
    Err(WireError::out_of_range(field, number))
}

/// A rate.
///
/// # Errors
///
/// [`WireError::OutOfRange`].
pub fn rate(rate: Rate) -> Result<Rate, WireError> {
    match rate {
        Some(rate) if !(rate > 0.0 && rate <= FASTEST_RATE) => {
            Err(WireError::out_of_range("rate", rate))
        }
        rate => Ok(rate),
    }
}

/// Steps between two published states.
///
/// # Errors
///
/// [`WireError::OutOfRange`].
pub fn publish_every(steps: u64) -> Result<u64, WireError> {
    if (1..=LONGEST_PUBLISHING).contains(&steps) {
        return Ok(steps);
    }
    Err(WireError::out_of_range("publish_every", steps))
}

/// The weight of someone who is to be informed: 0 would inform nobody.
///
/// # Errors
///
/// [`WireError::OutOfRange`]; the upper end is the model's to check.
pub fn weight(weight: f64) -> Result<f64, WireError> {
    if weight > 0.0 {
        return Ok(weight);
    }
    Err(WireError::out_of_range("weight", weight))
}

/// A number of individuals; more than fit a machine word are more than there can be.
pub fn count(count: u64) -> usize {
    usize::try_from(count).unwrap_or(usize::MAX)
}

/// Which individuals.
///
/// # Errors
///
/// [`WireError::OutOfRange`] for a radius below 0.
pub fn selection(select: Select) -> Result<Selection, WireError> {
    Ok(match select {
        Select::Ids(ids) => Selection::Ids(ids),
        Select::Count(number) => Selection::Count(count(number)),
        Select::Fraction(fraction) => Selection::Fraction(fraction),
        Select::Within(Region { x, y, radius }) => {
            if radius.is_nan() || radius < 0.0 {
                return Err(WireError::out_of_range("select.within.radius", radius));
            }
            Selection::Within { x, y, radius }
        }
        Select::Foremost(foremost) => Selection::Foremost {
            count: count(foremost.count),
            along: foremost.along,
        },
    })
}

/// Where a body is to be.
pub fn pose(Pose { x, y, alpha }: Pose) -> crate::model::body::Pose {
    crate::model::body::Pose { x, y, alpha }
}

/// A disc.
pub fn region(Region { x, y, radius }: Region) -> injection::Region {
    injection::Region { x, y, radius }
}
