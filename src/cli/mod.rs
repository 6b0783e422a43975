//! The subcommands of `jostled` and the settings of its process.

pub mod auth;
pub mod demo;
pub mod process;
pub mod run;
pub mod systemd;
