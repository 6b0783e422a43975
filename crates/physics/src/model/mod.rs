//! What a swarm is: parameters, individuals, how they start and change, and the hash of it all.
//!
//! Everything here is a function of its arguments: no clock, thread, file or serialiser. A pool
//! of threads may be handed over, and changes no bit.
//! Lengths are in body sizes, speeds in the free speed, so both of those are 1.

pub mod attraction;
pub mod body;
pub mod configuration;
pub mod heading;
pub mod injection;
pub mod pairs;
pub mod parameters;
pub mod random;
pub mod resize;
pub mod selection;
pub mod simd;
pub mod start;
pub mod state;
pub mod threads;

pub use configuration::{CELL, Configuration, Drive};
pub use parameters::{Attraction, ContactRule, Parameters, ParametersError, Stepping};
pub use state::{MODEL_VERSION, State, WarmContact, WarmStart};
