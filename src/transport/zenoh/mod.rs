//! The zenoh side of the daemon: sessions, access control, queryables, the dispatcher thread and the
//! publisher.

mod acl;
pub mod bus_watch;
pub mod claims;
pub mod clients;
pub mod dispatcher;
pub mod gateway;
pub mod messages;
pub mod progress;
mod publish_schedule;
pub mod publisher;
pub mod queryables;
pub mod session;
pub mod session_pool;
pub mod set_points;
pub mod tokens;
pub mod wait_tokens;
