//! Conversions between messages (`jostle_proto`) and physics (`jostle_physics`).
//!
//! [`spec`] and [`change`] convert the arguments of requests, and check them as far as they can be
//! checked without a swarm, with [`parameters`]. [`snapshot`] writes and reads the state of a simulation, and [`past`]
//! the states of earlier steps. [`error`]
//! gives the code and the details of errors, [`place`] describes the valid values of fields. No
//! bus, no runtime and no database is needed.

pub mod change;
pub mod error;
pub mod measures;
pub mod parameters;
pub mod past;
pub mod place;
pub mod snapshot;
pub mod spec;
pub mod value;

pub use error::WireCode;
pub use measures::MeasuresError;
pub use place::Place;
pub use snapshot::{SnapshotError, hexadecimal};
pub use value::{ArgsError, WireError};
