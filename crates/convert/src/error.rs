//! Codes and details of error replies.

use jostle_physics::model::injection::InjectionError;
use jostle_physics::model::parameters::ParametersError;
use jostle_physics::model::reshape::ReshapeError;
use jostle_physics::model::selection::SelectionError;
use jostle_physics::model::start::StartError;
use jostle_physics::simulation::{ChangeError, ReserveError};
use jostle_proto::{ErrorCode, RequestError, keys};
use serde_json::{Map, Value, json};

use crate::WireError;

/// The code and the details with which an error is sent to a client.
pub trait WireCode {
    /// Returns the code that clients branch on.
    fn code(&self) -> ErrorCode;

    /// Returns the details for programs, such as `field` and `range`.
    fn details(&self) -> Map<String, Value> {
        Map::new()
    }
}

impl WireCode for RequestError {
    fn code(&self) -> ErrorCode {
        ErrorCode::InvalidArgument
    }

    fn details(&self) -> Map<String, Value> {
        if self.field.is_empty() {
            return Map::new();
        }
        // The range of an unknown field does not help.
        let is_known = !self.problem.starts_with("unknown");
        let range = is_known.then(|| range_of(&self.field)).flatten();
        named(&self.field, Value::Null, range)
    }
}

impl WireCode for WireError {
    fn code(&self) -> ErrorCode {
        ErrorCode::InvalidArgument
    }

    fn details(&self) -> Map<String, Value> {
        match self {
            WireError::OutOfRange { field, value } => named(field, value.clone(), range_of(field)),
            WireError::Length { field, length, n } => {
                object(json!({"field": field, "length": length, "n": n}))
            }
        }
    }
}

impl WireCode for ChangeError {
    fn code(&self) -> ErrorCode {
        match self {
            ChangeError::Parameters(_) | ChangeError::Selection(_) | ChangeError::NoneLeft(_) => {
                ErrorCode::InvalidArgument
            }
            ChangeError::AxesCross { .. } => ErrorCode::IncorrectState,
            ChangeError::Start(StartError::NoRoom { .. })
            | ChangeError::Injection(InjectionError::NoRoom { .. })
            | ChangeError::Reserve(_) => ErrorCode::ResourceExhausted,
            ChangeError::Start(_)
            | ChangeError::Injection(_)
            | ChangeError::Reshape(ReshapeError::Parameters(_)) => ErrorCode::InvalidArgument,
            ChangeError::Reshape(_) => ErrorCode::ResourceExhausted,
        }
    }

    fn details(&self) -> Map<String, Value> {
        object(match self {
            ChangeError::Reserve(ReserveError::NoMemory { n, needed, free }) => {
                json!({"field": "n", "n": n, "needed": needed, "free": free})
            }
            ChangeError::Reserve(ReserveError::TooMany { n, limit }) => {
                json!({"field": "n", "n": n, "limit": limit})
            }
            ChangeError::Parameters(error)
            | ChangeError::Start(StartError::Parameters(error))
            | ChangeError::Selection(SelectionError::Number(error))
            | ChangeError::Injection(InjectionError::Parameters(error))
            | ChangeError::Reshape(ReshapeError::Parameters(error)) => return error.details(),
            ChangeError::NoneLeft(n) => json!({"field": "select", "selected": n, "n": n}),
            ChangeError::Injection(InjectionError::Pose { index, error }) => {
                let mut details = error.details();
                if let Some(Value::String(field)) = details.get_mut("field") {
                    *field = format!("at[{index}].{field}");
                }
                return details;
            }
            ChangeError::Injection(InjectionError::Overlap { index, gap }) => {
                json!({"field": format!("at[{index}]"), "gap": gap})
            }
            ChangeError::Injection(InjectionError::NoRoom { placed, .. }) => {
                json!({"field": "count", "placed": placed})
            }
            ChangeError::AxesCross { pairs } => json!({"field": "contacts", "pairs": pairs}),
            ChangeError::Start(StartError::NoRoom { placed, radius, .. }) => {
                json!({"field": "start.radius", "value": radius, "placed": placed})
            }
            ChangeError::Start(_) => json!({"field": "start"}),
            ChangeError::Selection(SelectionError::Count {
                field, candidates, ..
            }) => json!({"field": field, "range": format!("[0, {candidates}]")}),
            ChangeError::Selection(_) => json!({"field": "select.ids"}),
            _ => Value::Null,
        })
    }
}

impl WireCode for ParametersError {
    fn code(&self) -> ErrorCode {
        ErrorCode::InvalidArgument
    }

    fn details(&self) -> Map<String, Value> {
        match *self {
            ParametersError::OutOfRange {
                field,
                value,
                range,
            } => named(field, number(value), range_of(field).or(Some(range))),
            ParametersError::Clash { field, .. } => named(field, Value::Null, None),
            ParametersError::StepTooLong { dt, largest } => object(json!({
                "field": "dt", "value": dt, "range": format!("(0, {largest}]"),
            })),
        }
    }
}

/// Returns the fields of a JSON object, and none of another value.
pub fn object(value: Value) -> Map<String, Value> {
    match value {
        Value::Object(fields) => fields,
        _ => Map::new(),
    }
}

/// Returns the details of an invalid field: its name, its value unless null, and its range if
/// given.
pub fn named(field: &str, value: Value, range: Option<&str>) -> Map<String, Value> {
    let mut details = object(json!({"field": field}));
    if !value.is_null() {
        details.insert("value".to_owned(), value);
    }
    if let Some(range) = range {
        details.insert("range".to_owned(), range.into());
    }
    details
}

/// Returns a number in JSON. NaN and infinity, which JSON cannot represent, are text.
fn number(value: f64) -> Value {
    if value.is_finite() {
        json!(value)
    } else {
        json!(value.to_string())
    }
}

/// Descriptions of the valid values of fields. A name with a dot is a full path, which is looked up
/// before the last part alone.
const RANGES: &[(&str, &str)] = &[
    ("n", "a whole number from 1 to the daemon's max_individuals"),
    ("pi1", "a number from 1 to 32"),
    ("pi2", "a number from 0 to 1e6"),
    ("pi3", "a number above 0, at most 1e6"),
    ("pi4", "a number above 0, at most 1e6"),
    (
        "dt",
        "a number above 0, at most 2r / (1 + h ω): 0.02 fits most swarms",
    ),
    ("contacts", "\"endpoints\", \"closest\" or \"clamped\""),
    ("stepping", "\"position\" or \"velocity\""),
    ("relinearise", "0 or 1"),
    (
        "attraction",
        "{\"kind\": \"all\"}, optionally with \"accuracy\"; or of kind \"voronoi\", \"metric\" \
         with \"radius\", \"topological\" with \"neighbours\", \"power\" with \"exponent\"",
    ),
    ("neighbours", "a whole number from 1"),
    ("exponent", "a number from -8 to 8"),
    ("accuracy", "a number from 1e-9 to 1e-3"),
    ("noise", "a number from 0 to 1e6"),
    ("seed", "a whole number from 0 to 9007199254740991"),
    (
        "start",
        "{\"kind\": \"disc\"} or {\"kind\": \"given\", \"x\", \"y\", \"alpha\"}",
    ),
    ("publish_every", "a whole number from 1 to 1e9"),
    (
        "rate",
        "a number above 0, at most 1e6, or null for as fast as possible",
    ),
    ("until_step", "a whole number from 0 to 9007199254740991"),
    ("until_time", "a number from 0 to 1e12"),
    ("begin.steps", "a whole number from 1 to 9007199254740991"),
    ("steps", "a whole number from 1 to 1e9"),
    ("bytes", "base64 of a piece of the file"),
    ("offset", "a whole number of bytes"),
    ("length", "a whole number of bytes"),
    (
        "snapshot",
        "the `result` of get/snapshot, its CBOR in base64",
    ),
    ("return", "\"none\" or \"state\""),
    (
        "select",
        "one of {\"ids\": […]}, {\"count\": 5}, {\"fraction\": 0.1}, \
         {\"within\": {\"x\", \"y\", \"radius\"}}, {\"foremost\": {\"count\", \"along\"}}",
    ),
    ("ids", "a list of ids of individuals in the swarm"),
    ("count", "a whole number of individuals"),
    ("fraction", "a number from 0 to 1"),
    ("time", "a number from 0 to 1e12"),
    ("radius", "a number above 0, at most 1e6"),
    ("x", "a number from -1e6 to 1e6"),
    ("y", "a number from -1e6 to 1e6"),
    ("alpha", "a number from -1e6 to 1e6"),
    ("along", "a number from -1e6 to 1e6"),
    ("direction", "a number from -1e6 to 1e6"),
    ("turn", "null, or a number from -1e6 to 1e6"),
    ("speed", "null, or a number from 0 to 1"),
    ("set.weight", "a number from 0 to 1e6"),
    ("weight", "a number above 0, at most 1e6"),
    ("for_time", "a number above 0, at most 1e9"),
    ("mode", "\"lockstep\" or \"free_running\""),
    ("deadline_secs", "a number above 0, at most 60"),
    ("on_timeout", "\"hold\", \"free\" or \"pause\""),
    (
        "set",
        "{\"ids\": […], \"direction\": […]}, optionally with \"weight\": […]",
    ),
    ("make_room", "true or false"),
    ("exist_ok", "true or false"),
    ("again", "true or false"),
    ("driving", "true or false"),
    ("drop_when_behind", "true or false"),
    ("temporary", "true or false"),
    ("timeout_secs", "a number above 0, at most 3600"),
    ("at_step", "a whole number from 0 to 9007199254740991"),
    ("expect_step", "a whole number, 0 or more"),
    ("expect_epoch", "a whole number, 0 or more"),
    ("step", "a whole number, 0 or more"),
    ("after", "a whole number, 0 or more"),
    ("limit", "a whole number from 1 to 1000"),
    (
        "commands",
        "a list of 1 to 256 of {\"verb\": \"set\" | \"inform\" | \"uninform\" | \"inject\" | \
         \"remove\", \"args\": {…}}",
    ),
    ("part", "a whole number, 0 or more"),
    ("phase", "paused, running or faulted"),
    ("format", "json or cbor"),
    ("every", "a whole number from 1 to 9007199254740991"),
    ("max_bytes", "a whole number from 1 to 9007199254740991"),
    (
        "request_id",
        "at most 256 bytes of text without control or bidirectional characters",
    ),
    (
        "client",
        "at most 256 bytes of text without control or bidirectional characters",
    ),
    ("name", keys::NAME_RULE),
    ("controller", keys::NAME_RULE),
    ("recording", keys::NAME_RULE),
    ("swarm", keys::NAME_RULE),
];

/// Returns a description of the valid values of a field. `field` may be a path with indices.
pub fn range_of(field: &str) -> Option<&'static str> {
    let parts = field.split('.');
    let names: Vec<&str> = parts.filter_map(|part| part.split('[').next()).collect();
    let path = names.join(".");
    [path.as_str(), names.last()?]
        .into_iter()
        .find_map(|wanted| RANGES.iter().find(|(name, _)| *name == wanted))
        .map(|(_, range)| *range)
}
