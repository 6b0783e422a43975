//! Codes and details of error replies.

use jostle_measures::{MAX_COSTLY_INDIVIDUALS, TooCostly, histograms};
use jostle_physics::model::injection::InjectionError;
use jostle_physics::model::parameters::ParametersError;
use jostle_physics::model::reshape::ReshapeError;
use jostle_physics::model::selection::SelectionError;
use jostle_physics::model::start::StartError;
use jostle_physics::simulation::{ChangeError, ReserveError};
use jostle_proto::{ErrorCode, RequestError};
use serde_json::{Map, Value, json};

use crate::measures::MeasuresError;
use crate::place::Place;
use crate::value::WireError;

/// The code and the details with which an error is sent to a client.
pub trait WireCode {
    /// Returns the code that clients branch on.
    fn code(&self) -> ErrorCode;

    /// Returns the details for programs, such as `field` and `range`: the range that the field has at `place`.
    fn details(&self, _place: &Place) -> Map<String, Value> {
        Map::new()
    }
}

impl WireCode for RequestError {
    fn code(&self) -> ErrorCode {
        ErrorCode::InvalidArgument
    }

    fn details(&self, place: &Place) -> Map<String, Value> {
        if self.field.is_empty() {
            return Map::new();
        }
        // The range of an unknown field does not help.
        let is_known = !self.problem.starts_with("unknown");
        let range = is_known.then(|| place.range(&self.field)).flatten();
        named(&self.field, Value::Null, range)
    }
}

impl WireCode for WireError {
    fn code(&self) -> ErrorCode {
        ErrorCode::InvalidArgument
    }

    fn details(&self, place: &Place) -> Map<String, Value> {
        match self {
            WireError::OutOfRange { field, value } => {
                named(field, value.clone(), place.range(field))
            }
            WireError::Measures(_) => object(json!({"field": "measures"})),
            WireError::Length { field, length, n } => {
                object(json!({"field": field, "length": length, "n": n}))
            }
        }
    }
}

impl WireCode for ChangeError {
    fn code(&self) -> ErrorCode {
        match self {
            ChangeError::Parameters(_)
            | ChangeError::Selection(_)
            | ChangeError::Column { .. }
            | ChangeError::NoneLeft(_)
            | ChangeError::Weightless => ErrorCode::InvalidArgument,
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

    fn details(&self, place: &Place) -> Map<String, Value> {
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
            | ChangeError::Reshape(ReshapeError::Parameters(error)) => return error.details(place),
            ChangeError::Weightless => json!({"field": "weight"}),
            ChangeError::Column {
                column,
                length,
                ids,
            } => {
                json!({"field": column, "values": length, "ids": ids})
            }
            ChangeError::NoneLeft(n) => json!({"field": "select", "selected": n, "n": n}),
            ChangeError::Injection(InjectionError::Pose { index, error }) => {
                let pose = format!("at[{index}]");
                let mut details = error.details(&place.within(&pose));
                if let Some(Value::String(field)) = details.get_mut("field") {
                    *field = format!("{pose}.{field}");
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

    fn details(&self, place: &Place) -> Map<String, Value> {
        match *self {
            ParametersError::OutOfRange {
                field,
                value,
                range,
            } => named(field, number(value), place.range(field).or(Some(range))),
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

impl WireCode for MeasuresError {
    fn code(&self) -> ErrorCode {
        match self {
            MeasuresError::TooCostly(_) | MeasuresError::TooLarge { .. } => {
                ErrorCode::ResourceExhausted
            }
            MeasuresError::NoArea => ErrorCode::IncorrectState,
            _ => ErrorCode::InvalidArgument,
        }
    }

    fn details(&self, place: &Place) -> Map<String, Value> {
        match self {
            MeasuresError::TooCostly(error) => error.details(place),
            MeasuresError::TooLarge { n, .. } => {
                object(json!({"n": n, "limit": histograms::MAX_INDIVIDUALS}))
            }
            MeasuresError::NoArea => Map::new(),
            MeasuresError::Histogram(_) => object(json!({"field": "histogram"})),
            _ => object(json!({"field": "names"})),
        }
    }
}

impl WireCode for TooCostly {
    fn code(&self) -> ErrorCode {
        ErrorCode::ResourceExhausted
    }

    fn details(&self, _place: &Place) -> Map<String, Value> {
        object(json!({"n": self.n, "limit": MAX_COSTLY_INDIVIDUALS}))
    }
}
