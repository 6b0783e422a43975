//! Between the swarms and the store: writes journals and checkpoints, and recovers swarms from them.

pub(crate) mod applied;
pub mod checkpoints;
pub(crate) mod journal_page;
pub(crate) mod journal_reader;
pub mod limits;
pub(crate) mod prospect;
mod recoveries;
pub(crate) mod recovery;
pub(crate) mod replay;
pub(crate) mod reply_cache;
mod steering;
pub mod writer;
