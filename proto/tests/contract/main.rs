//! What stands in `schema/`, `fixtures/`, `asyncapi.json` and `README.md` is true of the types.

#![expect(clippy::unwrap_used, reason = "tests")]

mod coverage;
mod documents;
mod fixtures;
#[path = "../../examples/contract/generate.rs"]
mod generate;
mod readme;
mod types;
