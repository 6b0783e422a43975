//! Connections to clients: zenoh and HTTP. Only these modules name `zenoh` and `axum`.

pub mod http;
pub mod open_requests;
pub mod zenoh;
