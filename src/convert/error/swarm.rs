//! Codes and details of commands that a swarm rejects, and of swarms that the daemon rejects.

use jostle_convert::error::object;
use jostle_convert::{Place, WireCode};
use jostle_proto::ErrorCode;
use serde_json::{Map, Value, json};

use crate::swarm::error::SwarmError;
use crate::swarm::registry::RegistryError;

impl WireCode for RegistryError {
    fn code(&self) -> ErrorCode {
        match self {
            RegistryError::OtherSpec | RegistryError::SameSpec => ErrorCode::AlreadyExists,
            RegistryError::TooManySwarms(_)
            | RegistryError::TooMuchMemory { .. }
            | RegistryError::NoThread(_) => ErrorCode::ResourceExhausted,
            RegistryError::Stopping => ErrorCode::Busy,
        }
    }

    fn details(&self, _place: &Place) -> Map<String, Value> {
        object(match self {
            RegistryError::TooManySwarms(limit) => json!({"limit": limit}),
            RegistryError::TooMuchMemory {
                needed,
                free,
                limit,
            } => json!({"needed": needed, "free": free, "limit": limit}),
            _ => Value::Null,
        })
    }
}

impl WireCode for SwarmError {
    fn code(&self) -> ErrorCode {
        match self {
            SwarmError::Change(error) => error.code(),
            SwarmError::InBatch { error, .. } => error.code(),
            SwarmError::TooCostly(error) => error.code(),
            SwarmError::NotClaimed { .. }
            | SwarmError::NotDriving(_)
            | SwarmError::TooMuchPast(_)
            | SwarmError::Playback(_)
            | SwarmError::OutsideRecording { .. } => ErrorCode::InvalidArgument,
            SwarmError::Phase(_)
            | SwarmError::Lockstep { .. }
            | SwarmError::Recorded
            | SwarmError::NoConditions
            | SwarmError::NotRecorded
            | SwarmError::NotHeld(_)
            | SwarmError::Protected(_)
            | SwarmError::RunsFreely(_) => ErrorCode::IncorrectState,
            SwarmError::Conflict { .. }
            | SwarmError::Past { .. }
            | SwarmError::Late { .. }
            | SwarmError::Overtaken(_)
            | SwarmError::Ended(_)
            | SwarmError::HoldsAlready
            | SwarmError::Claimed { .. }
            | SwarmError::Advancing { .. }
            | SwarmError::Superseded
            | SwarmError::RejectedBefore => ErrorCode::Conflict,
            SwarmError::NotJoined { .. }
            | SwarmError::NoEvent(_)
            | SwarmError::NoCondition(_)
            | SwarmError::Gone => ErrorCode::NotFound,
            SwarmError::HasJoined(_) => ErrorCode::AlreadyExists,
            SwarmError::TooManyControllers(_)
            | SwarmError::TooManyOfUser { .. }
            | SwarmError::TooManyScheduled { .. }
            | SwarmError::TooManyWatches(_)
            | SwarmError::TooManyWaits { .. }
            | SwarmError::TooManyMeasuresOfUser { .. }
            | SwarmError::TooCostlyTogether(_)
            | SwarmError::NoMemoryOfPast { .. } => ErrorCode::ResourceExhausted,
            SwarmError::NotDurable(_) => ErrorCode::StorageFull,
            SwarmError::Displaced { .. } => ErrorCode::DeadlineExceeded,
            SwarmError::Busy => ErrorCode::Busy,
            SwarmError::Faulted(_) => ErrorCode::Faulted,
            SwarmError::Panicked => ErrorCode::Internal,
        }
    }

    fn details(&self, place: &Place) -> Map<String, Value> {
        object(match self {
            SwarmError::Change(error) => return error.details(place),
            SwarmError::Conflict {
                what,
                expected,
                actual,
            } => {
                json!({"field": format!("expect_{what}"), "expected": expected, "actual": actual})
            }
            SwarmError::Lockstep { controllers, .. } => json!({"controllers": controllers}),
            SwarmError::Past { until, step } => {
                json!({"field": "until_step", "until": until, "step": step})
            }
            SwarmError::OutsideRecording {
                field,
                value,
                first,
                last,
            } => json!({"field": field, "value": value, "range": format!("[{first}, {last}]")}),
            SwarmError::Late { at_step, step } => {
                json!({"field": "at_step", "at_step": at_step, "step": step})
            }
            SwarmError::HoldsAlready => json!({"field": "condition"}),
            SwarmError::NoEvent(event) => json!({"field": "event", "value": **event}),
            SwarmError::Overtaken(at_step) | SwarmError::Ended(at_step) => {
                json!({"field": "at_step", "at_step": at_step})
            }
            SwarmError::Displaced { after_secs, limit } => {
                json!({"after_secs": after_secs, "limit": limit})
            }
            SwarmError::TooMuchPast(_) => json!({"field": "condition"}),
            SwarmError::TooManyWatches(limit) => json!({"field": "condition", "limit": limit}),
            SwarmError::TooManyWaits { count, user: None } => {
                json!({"field": "condition", "limit": count})
            }
            SwarmError::TooManyWaits { count, user } => {
                json!({"field": "condition", "limit": count, "person": user})
            }
            SwarmError::TooManyMeasuresOfUser { limit, user, .. } => {
                json!({"field": "condition", "limit": limit, "person": user})
            }
            SwarmError::TooCostlyTogether(_) => json!({"field": "condition"}),
            SwarmError::NoMemoryOfPast { needed, free } => {
                json!({"field": "condition", "needed": needed, "free": free})
            }
            SwarmError::NotHeld(key) => json!({"token": key}),
            SwarmError::NoCondition(id) => json!({"field": "id", "value": id}),
            SwarmError::TooManyScheduled {
                count, user: None, ..
            } => {
                json!({"field": "at_step", "limit": count})
            }
            SwarmError::TooManyScheduled { count, user, .. } => {
                json!({"field": "at_step", "limit": count, "person": user})
            }
            SwarmError::TooManyOfUser { count, user } => {
                json!({"field": "controller", "limit": count, "person": user})
            }
            SwarmError::NotJoined { controller, .. }
            | SwarmError::HasJoined(controller)
            | SwarmError::RunsFreely(controller)
            | SwarmError::NotDriving(controller) => {
                json!({"field": "controller", "value": controller})
            }
            SwarmError::Claimed { id, controller } => {
                json!({"field": "select", "id": id, "controller": controller})
            }
            SwarmError::NotClaimed { id, owner } => {
                json!({"field": "set.ids", "id": id, "controller": owner})
            }
            SwarmError::Advancing { target, .. } => {
                json!({"field": "controller", "target": target})
            }
            _ => Value::Null,
        })
    }
}
