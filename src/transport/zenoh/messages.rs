//! The messages to the dispatcher.

use std::sync::Arc;
use std::sync::mpsc::SyncSender;

use crate::api::incoming::Incoming;
use crate::swarm::handle::DeferredReply;

/// Requests that may be queued for the dispatcher; further ones are rejected with `busy`.
pub const MAX_QUEUED: usize = 1024;

/// A message to the dispatcher.
pub enum DispatchMessage {
    /// A request.
    Request(Incoming),
    /// The first use of a verb on a swarm.
    FirstUse(Arc<str>, &'static str),
    /// The claims of other daemons, or the connected routers, changed.
    Claimed,
    /// These swarms are to be recovered: claim their names and the daemon's own, and open their keys, on
    /// which requests get `busy`. The result is sent once the keys are open that the claims permit so far.
    Recovering(Vec<String>, SyncSender<()>),
    /// Every swarm is recovered: announce the daemon as soon as its claim permits it.
    Recovered(SyncSender<zenoh::Result<()>>),
    /// A swarm is built.
    Begun(String, DeferredReply),
    /// A swarm has ended.
    Ended(String, DeferredReply),
    /// Everything of a swarm that has ended is published.
    Closed(String, DeferredReply),
    /// The daemon stops.
    Stop,
}
