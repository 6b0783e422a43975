//! The daemon of jostle: hosts swarms of bodies that only push each other.
//!
//! How a command travels: [`server`] takes a query off the bus, [`command`] reads it and checks
//! it, [`host`] finds the swarm it is for, the swarm's thread ([`swarm`]) carries it out between
//! two steps, and the answer goes back the same way.
//!
//! How a step is made: [`jostle_physics`] computes the free motion, finds the contacts, solves the
//! quadratic program of Principle 1, moves the bodies and measures the result; [`publish`] publishes
//! it.
//!
//! How an experiment is made: [`jostle_experiment`] reads a grid of runs from a file, steps each from its
//! start to its end, and writes a row for each; [`batch`] is its command line.
//!
//! How a recording is shown: [`replay`] opens it as a film, and its thread plays that as a swarm shows
//! itself.
//!
//! How a swarm is recorded: [`recording`] taps what it shows and writes it to files.
//!
//! How a data folder is backed up: [`backup`] copies what [`store`], [`lab`] and [`recording`] have
//! written, in a process of its own.
//!
//! Who may do what: [`rights`] knows the people, [`server`] asks it of every command, and zenoh's access
//! control, which [`server`] sets, stands before both.
//!
//! Each module may use those above it: `swarm`, `host`, `command`, `server`. Only `publish` and
//! `server` use zenoh.

pub mod api;
pub mod app;
pub mod auth;
pub mod backup;
pub mod cli;
pub mod config;
pub mod convert;
pub mod experiments;
pub mod health;
pub mod metrics;
pub mod persistence;
pub mod playback;
pub mod recording;
pub mod store;
pub mod swarm;
pub mod transport;
