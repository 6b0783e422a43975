//! Between the messages of jostle, the crate `jostle_proto`, and its physics, `jostle_physics`.
//!
//! [`spec`] and [`change`] read what clients send and check it as far as it can be checked without a
//! swarm; [`snapshot`] writes and reads the state of a simulation; [`error`] gives the code and the
//! details of what the physics rejects. No bus, no runtime and no database is needed.

pub mod change;
pub mod error;
pub mod snapshot;
pub mod spec;
pub mod value;

pub use change::ArgsError;
pub use snapshot::{SnapshotError, hexadecimal};
pub use value::WireError;
