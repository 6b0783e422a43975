//! The messages of jostle and their keys: no I/O, no physics.
//!
//! A request is a zenoh query on a concrete key; its payload is a [`Request`] around one of the
//! arguments in [`verbs`]. The reply is a [`Reply`] or an [`Error`]. A swarm publishes
//! [`State`], [`OrderSample`] and [`Event`].
//!
//! [`Request::args`] rejects unknown fields. Readers of replies and samples accept them, so that an
//! older client works with a newer daemon.

pub mod keys;

pub mod asyncapi;
mod attachment;
mod axes;
mod cell;
pub mod claim;
mod column;
pub mod contract;
mod envelope;
mod error;
mod event;
mod experiment;
mod message;
mod metrics;
mod parameters;
mod queries;
mod recording;
mod replay;
mod result_row;
pub mod role;
mod schema;
pub mod snapshot;
mod spec;
mod state;
mod units;
mod usual;
pub mod verbs;
mod visitor;
mod walk;

pub use attachment::{Attachment, unix_nanos};
pub use axes::{AXES, Axis};
pub use cell::{Cell, CellKind, WrongKind};
pub use claim::{Claim, Claimant, Standing};
pub use envelope::{MAX_LABEL_LENGTH, NodeReply, Reply, Request, is_plain};
pub use error::{Error, ErrorCode, RequestError};
pub use event::{Event, EventKind};
pub use experiment::{
    ExpandArgs, ExpandedRun, ExperimentArgs, ExperimentName, ExperimentPhase, ExperimentResult,
    Experiments, MeasureSeries, Metadata, OccasionalColumns, OrderPage, Progress, ResultsPage,
    RunCommand, RunUnderWay, SeriesPage, SubmitArgs,
};
pub use metrics::{Metrics, RecordingMetrics, StoreMetrics, SwarmMetrics};
pub use parameters::{MAX_PUBLISHED_MEASURES, ParameterValues, Spec};
pub use queries::{
    Audit, AuditLine, AuditOutcome, Awaited, Controller, ControllerList, EarlierModel, Events,
    ExperimentFile, Fault, Hello, Histogram, HistoryFrom, Journal, JournalEntry, Limits,
    MeasureValue, Measures, NodeStatus, Origin, OriginKind, Parameter, ParameterKind, Parameters,
    Puts, Schemas, Status, SwarmSummary, Swarms, Verified, WaitingAction, WaitingClient,
    WaitingCondition,
};
pub use recording::{
    BeginRecordingArgs, DEFAULT_MAX_RECORDING_BYTES, RecordArgs, RecordedAt, Recording,
    RecordingFormat, RecordingGap, RecordingName, RecordingPhase, RecordingPiece, Recordings,
};
pub use replay::{OpenArgs, Replay, ReplayArgs, ReplayResult, SeekArgs, UploadArgs};
pub use result_row::{
    COLUMNS, Column, ExtraValue, FAULT, Measure, OCCASIONAL_COLUMNS, ResultRow, STOPPED_AT,
    rename_fault, unit_of_column,
};
pub use role::{Credentials, Role, WhoAmI};
pub use snapshot::Snapshot;
pub use spec::{Attraction, ContactRule, Start, Stepping};
pub use state::{Certificate, Order, OrderSample, Phase, State, to_cbor};
pub use units::{LENGTH_UNIT, NO_UNIT, SPEED_UNIT, TIME_UNIT};
pub use usual::{Scale, Usual};
pub use walk::{Arguments, Lenient};

/// The version of this contract; it grows when a message changes its meaning.
pub const WIRE_VERSION: u32 = 1;

/// The largest whole number in a message: doubles are exact up to here.
pub const LARGEST_WHOLE: u64 = (1 << 53) - 1;

/// The zenoh encoding of requests, replies, errors, orders and events.
pub const JSON: &str = "application/json";

/// The zenoh encoding of states.
pub const CBOR: &str = "application/cbor";

/// Whether a field whose default is `false` is left out.
#[expect(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde passes a reference"
)]
pub(crate) fn is_false(value: &bool) -> bool {
    !value
}

/// The examples of the page for people.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
