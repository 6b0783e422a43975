//! Tests that only read the sources: layers, import cycles, versions, patched libraries. They are the
//! integration tests of the package `jostled` itself, so that `cargo test` compiles the program, which
//! `tests/daemon` and `tests/measured` start.

#![expect(clippy::unwrap_used, reason = "tests")]

mod circles;
mod functions;
mod layers;
mod patched;
mod version;
