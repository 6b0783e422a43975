//! The cache of replies, as recovery uses it.

use crate::convert::Payload;
use crate::convert::digest::Digest;
use crate::store;

/// The replies to requests that have an id. Recovery reads the stored ones and adds replayed ones.
pub trait ReplyCache: Clone + Send + 'static {
    /// Adds the persisted replies, oldest first.
    fn fill(&self, replies: Vec<store::StoredReply>);

    /// Whether a request with this id is known.
    fn contains(&self, client: &Option<String>, id: &str) -> bool;

    /// Adds a request that was received before the restart and is replayed. Retries wait for its
    /// reply. `None` if it is known.
    fn begin_replayed(
        &self,
        name: (Option<String>, String),
        digest: Digest,
    ) -> Option<Box<dyn ReplySlot>>;
}

/// Where the reply to a request is written.
pub trait ReplySlot: Send {
    fn write(self: Box<Self>, reply: &Result<Payload, Payload>);

    /// Removes the request, which changed nothing; waiting retries get the error.
    fn reject(self: Box<Self>, error: &Payload);
}
