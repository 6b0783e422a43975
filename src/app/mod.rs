//! The composition root: constructs the parts of the daemon in order, connects them, and stops them.
//!
//! [`start`] lists the steps. No other module knows all parts, and this one contains no logic of
//! theirs.

pub(crate) mod data_folder;
mod error;
mod server;
mod start;
mod stop;
mod users;

pub use error::{EXIT_STORE, ServerError};
pub use server::Server;
pub use start::{start, start_with};
