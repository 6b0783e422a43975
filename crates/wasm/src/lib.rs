//! Swarms and the runs of experiments behind requests and replies in JSON, as a WebAssembly module
//! without imports.
//!
//! An [`Engine`] holds one swarm or one plan with at most one run. It depends on no clock, no file,
//! no thread and no random source, and computes the same bytes natively and as a module: every
//! program that has one speaks to it by the same requests. The module exports
//!
//! - `input(length)`, which returns the address of a buffer for a request of `length` bytes;
//! - `request()`, which executes the request there;
//! - `output()` and `output_len()`, the address and the length of the reply. If the module traps,
//!   it is the text of the panic: the instance is then of no more use;
//! - `n()`, `ids()` and `column(index)`, the address of the n ids and of n numbers each of `x`, `y`,
//!   `alpha`, `weight` and `direction` of the present state, in the units of published states. They
//!   are valid until the next call.

mod engine;
#[cfg(target_family = "wasm")]
mod exports;
mod request;
mod runs;
mod swarm;

pub use engine::Engine;
