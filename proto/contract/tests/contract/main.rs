//! The types agree with `schema/`, `fixtures/`, `asyncapi.json` and `README.md`.

#![expect(clippy::unwrap_used, reason = "tests")]

mod coverage;
mod docs;
mod documents;
mod fixtures;
mod places;
mod readme;
