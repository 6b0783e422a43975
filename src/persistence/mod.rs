//! Between the swarms and the store: journal entries on their way to disk, and back after a restart.

pub mod journal_reader;
pub mod recovery;
pub mod writer;
