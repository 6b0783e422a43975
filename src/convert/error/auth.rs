//! Code and details of rejected permissions.

use jostle_convert::WireCode;
use jostle_convert::error::object;
use jostle_proto::ErrorCode;
use jostle_proto::role::refused;
use serde_json::{Map, Value, json};

use crate::auth::NotPermitted;

impl WireCode for NotPermitted {
    fn code(&self) -> ErrorCode {
        ErrorCode::PermissionDenied
    }

    fn details(&self) -> Map<String, Value> {
        match self {
            NotPermitted::Verb { user: person, verb } => {
                let person = person.as_ref();
                let person = person.map(|person| (person.name.as_str(), person.role));
                refused(person, verb).details
            }
            NotPermitted::Controller {
                user: person,
                controller,
            } => object(json!({"person": person, "controller": controller})),
        }
    }
}
