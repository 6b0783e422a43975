//! Codes and details of rejected commands to experiments, recordings and playbacks.

use jostle_convert::error::object;
use jostle_convert::{Place, WireCode};
use jostle_proto::ErrorCode;
use serde_json::{Map, Value, json};

use crate::experiments::ExperimentError;
use crate::playback::{MAX_UPLOAD_BYTES, ReplayError};
use crate::recording::RecordError;

impl WireCode for ExperimentError {
    fn code(&self) -> ErrorCode {
        match self {
            ExperimentError::Plan { .. }
            | ExperimentError::Name(_)
            | ExperimentError::NoOrder(_)
            | ExperimentError::NoSeries(_)
            | ExperimentError::NoTrajectory(_) => ErrorCode::InvalidArgument,
            ExperimentError::Unknown(_) | ExperimentError::UnknownRun { .. } => ErrorCode::NotFound,
            ExperimentError::Exists(_) => ErrorCode::AlreadyExists,
            ExperimentError::OtherModel { .. } => ErrorCode::Conflict,
            ExperimentError::Phase { .. }
            | ExperimentError::Unfinished { .. }
            | ExperimentError::MissingFile { .. }
            | ExperimentError::DamagedFile { .. } => ErrorCode::IncorrectState,
            ExperimentError::TooMany(_)
            | ExperimentError::TooLong(_)
            | ExperimentError::NoMemory { .. }
            | ExperimentError::OverQuota { .. } => ErrorCode::ResourceExhausted,
            ExperimentError::NoRoom { .. } | ExperimentError::NotStored(_) => {
                ErrorCode::StorageFull
            }
            ExperimentError::Unreadable(_) => ErrorCode::Internal,
            ExperimentError::Stopping => ErrorCode::Busy,
        }
    }

    fn details(&self, _place: &Place) -> Map<String, Value> {
        object(match self {
            ExperimentError::Plan { line, field, .. } => json!({"field": field, "line": line}),
            ExperimentError::Name(name) => json!({"field": "submit.toml", "value": name}),
            ExperimentError::UnknownRun { run, .. }
            | ExperimentError::Unfinished { run, .. }
            | ExperimentError::MissingFile { run, .. }
            | ExperimentError::DamagedFile { run, .. } => json!({"field": "run", "value": run}),
            ExperimentError::OtherModel { theirs, again, .. } => {
                json!({"model_version": theirs, "again": again})
            }
            ExperimentError::TooMany(limit) => json!({"limit": limit}),
            ExperimentError::TooLong(_) => json!({"field": "expand.toml"}),
            ExperimentError::NoRoom { needed, free, .. } => json!({"bytes": needed, "free": free}),
            ExperimentError::NoMemory { needed, limit, .. } => {
                json!({"bytes": needed, "limit": limit})
            }
            ExperimentError::OverQuota { needed, quota, .. } => {
                json!({"bytes": needed, "limit": quota})
            }
            _ => Value::Null,
        })
    }
}

impl WireCode for RecordError {
    fn code(&self) -> ErrorCode {
        match self {
            RecordError::Unknown(_) | RecordError::NoPart { .. } => ErrorCode::NotFound,
            RecordError::NoOffset { .. } => ErrorCode::InvalidArgument,
            RecordError::Exists(_) => ErrorCode::AlreadyExists,
            RecordError::Failed(_) => ErrorCode::IncorrectState,
            RecordError::TooMany(_)
            | RecordError::TooManyKept(_)
            | RecordError::OverQuota { .. }
            | RecordError::NoThread(_) => ErrorCode::ResourceExhausted,
            RecordError::NotStored(_) => ErrorCode::StorageFull,
            RecordError::Ending(_) | RecordError::Stopping => ErrorCode::Busy,
        }
    }

    fn details(&self, _place: &Place) -> Map<String, Value> {
        object(match self {
            RecordError::TooMany(limit) | RecordError::TooManyKept(limit) => {
                json!({"limit": limit})
            }
            RecordError::OverQuota { used, quota } => json!({"bytes": used, "limit": quota}),
            RecordError::NoPart { part, .. } => json!({"field": "part", "value": part}),
            RecordError::NoOffset { offset, .. } => json!({"field": "offset", "value": offset}),
            _ => Value::Null,
        })
    }
}

impl WireCode for ReplayError {
    fn code(&self) -> ErrorCode {
        match self {
            ReplayError::Unreadable(_) => ErrorCode::InvalidArgument,
            ReplayError::Piece(_) => ErrorCode::Conflict,
            ReplayError::NotUploaded(_) | ReplayError::Unknown(_) => ErrorCode::NotFound,
            ReplayError::TooLong(_) => ErrorCode::ResourceExhausted,
            ReplayError::TooMany(_) => ErrorCode::Busy,
            ReplayError::NotStored(_) => ErrorCode::StorageFull,
        }
    }

    fn details(&self, _place: &Place) -> Map<String, Value> {
        object(match self {
            ReplayError::Piece(received) => {
                json!({"field": "upload.offset", "uploaded": received})
            }
            ReplayError::TooLong(length) => json!({"bytes": length, "limit": MAX_UPLOAD_BYTES}),
            _ => Value::Null,
        })
    }
}
