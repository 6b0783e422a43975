//! Between the swarms and the store: writes journals and checkpoints, and recovers swarms from them.

pub mod checkpoints;
pub mod journal_reader;
pub mod recovery;
pub mod replay;
pub mod reply_cache;
pub mod writer;
