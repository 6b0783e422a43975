//! The state of a swarm: parameters, individuals, their start and changes, and the state's hash.
//!
//! Everything here is a function of its arguments: no clock, thread or file. This module uses no
//! serialiser itself. The caller may pass a thread pool, which changes no bit of a result.
//! Lengths are in body sizes and speeds in the free speed, so both of these units are 1.

pub mod attraction;
pub mod body;
pub mod configuration;
pub mod heading;
pub mod injection;
pub mod pairs;
pub mod parameters;
pub mod random;
pub mod reshape;
pub mod selection;
pub mod simd;
pub mod start;
pub mod state;
pub mod threads;

pub use configuration::{CELL, Configuration, Drive};
pub use parameters::{Attraction, ContactRule, Parameters, ParametersError, Stepping};
pub use state::{MODEL_VERSION, OLDEST_MODEL_VERSION, State, WarmContact, WarmStart};
