//! Requests that are rejected.

mod memory;
