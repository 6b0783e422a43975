//! Idempotency: a request with an id is executed once, and a retry gets the first reply.
//!
//! A client that received no reply does not know whether its command was executed. It sends the same
//! request again with the same `client` and `request_id`, and gets the reply that it missed. A
//! rejected request changed nothing; it is not cached, and its id may be used again.
//!
//! The replies are limited in total. Beyond the limit the holder of most (a client, or the user of
//! several clients) loses its own oldest reply, so that a client that sends many requests cannot
//! evict the replies of others.

use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::Arc;

use jostle_proto::{CBOR, JSON};
use parking_lot::Mutex;

use crate::api::responder::Responder;
use crate::convert::Payload;
use crate::convert::digest::{Digest, RequestIdentity};
use crate::convert::error::CommandError;
use crate::persistence::reply_cache::{ReplyCache, ReplySlot};
use crate::store::{self, Store, Write};

/// Replies in the cache at most.
const MAX_REPLIES: usize = 100_000;

/// Bytes that all cached replies may take.
const MAX_REPLY_BYTES: usize = 64 * 1024 * 1024;

/// The least that a reply counts: [`MAX_REPLIES`] of them reach [`MAX_REPLY_BYTES`].
const MIN_COST: usize = MAX_REPLY_BYTES.div_ceil(MAX_REPLIES);

/// Bytes of a reply beside its payload: its name, its digest, and its share of the tables.
const REPLY_BYTES: usize = 384;

/// The name of a request: its client and its id.
pub type Name = (Option<String>, String);

/// The requests that have an id, and their replies. Clones share them.
#[derive(Clone)]
pub struct IdempotencyCache {
    /// Nothing between two changes can panic.
    requests: Arc<Mutex<Requests>>,
    /// Held while a reply is inserted and submitted to the store, which may wait for room in its
    /// queue: the store deletes and writes in the order in which the requests changed.
    submitting: Arc<Mutex<()>>,
    store: Store,
}

/// The unit that eviction compares: a client, or the user that all its clients belong to. `None`
/// holds the replies to requests without a client.
type Holder = Option<Arc<str>>;

struct Requests {
    by_name: HashMap<Arc<Name>, Box<Entry>>,
    holders: HashMap<Holder, Held>,
    /// Holders by their cost; among equal ones the holder of the oldest reply comes last.
    ranking: BTreeMap<(usize, Reverse<u64>), Holder>,
    cost: usize,
    max_cost: usize,
    /// Whether the client of a request begins with the name of its user.
    has_people: bool,
    /// How many replies were ever inserted: the number of the newest.
    newest: u64,
}

/// The replies of one holder, oldest first, and their cost.
#[derive(Default)]
struct Held {
    replies: VecDeque<(u64, Arc<Name>)>,
    cost: usize,
}

struct Entry {
    digest: Digest,
    progress: Progress,
}

enum Progress {
    /// It is being executed; these wait for its reply, too.
    Pending(Vec<Responder>),
    /// It was executed: the number of the reply, and the reply.
    Done(u64, Result<Payload, Payload>),
}

/// Where the reply to a request is written. If it is dropped before, the request is removed.
struct Slot {
    cache: IdempotencyCache,
    name: Arc<Name>,
    is_written: bool,
}

impl IdempotencyCache {
    /// An empty cache whose replies are persisted in `store` too. With `has_people`, the clients of
    /// one person (`person:label`) are one holder.
    pub fn new(store: Store, has_people: bool) -> Self {
        IdempotencyCache {
            requests: Arc::new(Mutex::new(Requests::new(has_people, MAX_REPLY_BYTES))),
            submitting: Arc::default(),
            store,
        }
    }

    /// The cached reply to a request, if there is one.
    pub fn find(&self, identity: RequestIdentity) -> Option<Result<Payload, Payload>> {
        let requests = self.requests.lock();
        let name = (identity.client, identity.request_id);
        let entry = requests.by_name.get(&name)?;
        match &entry.progress {
            Progress::Done(_, reply) if entry.digest == identity.digest => Some(reply.clone()),
            _ => None,
        }
    }

    /// Whether a request is new; its reply is then cached. A duplicate gets the first reply by
    /// `responder`, now or once there is one.
    ///
    /// # Errors
    ///
    /// [`CommandError::OtherRequest`].
    pub fn begin(
        &self,
        identity: RequestIdentity,
        responder: &Responder,
    ) -> Result<bool, CommandError> {
        let (name, digest) = ((identity.client, identity.request_id), identity.digest);
        let mut requests = self.requests.lock();
        let Some(entry) = requests.by_name.get_mut(&name) else {
            let slot = self.slot(&mut requests, name, digest);
            drop(requests);
            responder.set_slot(Box::new(slot));
            return Ok(true);
        };
        if entry.digest != digest {
            return Err(CommandError::OtherRequest(name.1));
        }
        match &mut entry.progress {
            Progress::Pending(responders) => responders.push(responder.clone()),
            Progress::Done(_, reply) => {
                let reply = reply.clone();
                responder.send(move || reply);
            }
        }
        Ok(false)
    }

    fn slot(&self, requests: &mut Requests, name: Name, digest: Digest) -> Slot {
        let name = Arc::new(name);
        let progress = Progress::Pending(Vec::new());
        let entry = Box::new(Entry { digest, progress });
        requests.by_name.insert(name.clone(), entry);
        Slot {
            cache: self.clone(),
            name,
            is_written: false,
        }
    }
}

impl ReplyCache for IdempotencyCache {
    fn fill(&self, replies: Vec<store::StoredReply>) {
        let mut requests = self.requests.lock();
        let mut evicted = Vec::new();
        for stored in replies {
            let payload = Payload {
                bytes: stored.body,
                encoding: match stored.encoding.as_str() {
                    CBOR => CBOR,
                    _ => JSON,
                },
                to_cache: None,
            };
            let name = Arc::new((stored.client, stored.request_id));
            let reply = match stored.is_ok {
                true => Ok(payload),
                false => Err(payload),
            };
            evicted.extend(requests.insert(name, stored.digest, reply).1);
        }
        drop(requests);
        let deletions = evicted.iter().map(delete_write);
        self.store.submit(deletions.collect(), None);
    }

    fn contains(&self, client: &Option<String>, id: &str) -> bool {
        let name = (client.clone(), id.to_owned());
        self.requests.lock().by_name.contains_key(&name)
    }

    fn begin_replayed(&self, name: Name, digest: Digest) -> Option<Box<dyn ReplySlot>> {
        let mut requests = self.requests.lock();
        if requests.by_name.contains_key(&name) {
            return None;
        }
        Some(Box::new(self.slot(&mut requests, name, digest)))
    }
}

impl ReplySlot for Slot {
    fn write(mut self: Box<Self>, reply: &Result<Payload, Payload>) {
        self.is_written = true;
        let cached = match reply {
            Ok(payload) => Ok(payload.cached()),
            Err(payload) => Err(payload.clone()),
        };
        let submitting = self.cache.submitting.lock();
        let mut requests = self.cache.requests.lock();
        let Some(digest) = requests.by_name.get(&self.name).map(|entry| entry.digest) else {
            return;
        };
        let insert = insert_write(&self.name, digest, &cached);
        let (before, evicted) = requests.insert(self.name.clone(), digest, cached);
        drop(requests);
        // It may become durable after it is sent: after a crash the journal of the swarm is replayed,
        // which produces the same reply.
        let writes = std::iter::once(insert).chain(evicted.iter().map(delete_write));
        self.cache.store.submit(writes.collect(), None);
        drop(submitting);
        if let Some(Progress::Pending(responders)) = before {
            for responder in responders {
                let reply = reply.clone();
                responder.send(move || reply);
            }
        }
    }

    fn reject(mut self: Box<Self>, error: &Payload) {
        for responder in self.remove() {
            let error = error.clone();
            responder.send(move || Err(error));
        }
    }
}

impl Slot {
    fn remove(&mut self) -> Vec<Responder> {
        self.is_written = true;
        let entry = self.cache.requests.lock().by_name.remove(&self.name);
        match entry.map(|it| it.progress) {
            Some(Progress::Pending(responders)) => responders,
            Some(Progress::Done(..)) | None => Vec::new(),
        }
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        if !self.is_written {
            self.remove();
        }
    }
}

impl Requests {
    /// An empty table with its full capacity: rehashing would delay a request and need megabytes
    /// more for a moment.
    fn new(has_people: bool, max_cost: usize) -> Self {
        Requests {
            by_name: HashMap::with_capacity(MAX_REPLIES + 1),
            holders: HashMap::new(),
            ranking: BTreeMap::new(),
            cost: 0,
            max_cost,
            has_people,
            newest: 0,
        }
    }

    /// Inserts the reply to a request, and evicts others until the total holds. Returns what was
    /// known of the request before, and the requests whose replies were evicted.
    fn insert(
        &mut self,
        name: Arc<Name>,
        digest: Digest,
        reply: Result<Payload, Payload>,
    ) -> (Option<Progress>, Vec<Arc<Name>>) {
        self.newest += 1;
        let number = self.newest;
        let cost = cost(&reply);
        let progress = Progress::Done(number, reply);
        let entry = Box::new(Entry { digest, progress });
        let before = self.by_name.insert(name.clone(), entry);
        let before = before.map(|entry| entry.progress);
        let holder = self.holder(&name);
        self.change(&holder, |held| {
            if let Some(Progress::Done(number, reply)) = &before {
                held.remove(*number, self::cost(reply));
            }
            held.replies.push_back((number, name));
            held.cost += cost;
        });
        (before, self.evict())
    }

    /// Evicts replies until the total holds, but never the newest: its client may retry the request
    /// that it has just sent.
    fn evict(&mut self) -> Vec<Arc<Name>> {
        let mut evicted = Vec::new();
        while self.cost > self.max_cost {
            let mut most = self.ranking.iter().rev();
            let most = most.find(|((_, Reverse(oldest)), _)| *oldest != self.newest);
            let Some(((_, Reverse(oldest)), holder)) = most else {
                break;
            };
            let (oldest, holder) = (*oldest, holder.clone());
            let found = self.holders.get(&holder);
            let Some((_, name)) = found.and_then(|held| held.replies.front()).cloned() else {
                break;
            };
            let entry = self.by_name.remove(&name);
            if let Some(Progress::Done(_, reply)) = entry.map(|entry| entry.progress) {
                self.change(&holder, |held| held.remove(oldest, cost(&reply)));
                evicted.push(name);
            }
        }
        evicted
    }

    fn holder(&self, (client, _): &Name) -> Holder {
        let client = client.as_deref()?;
        Some(match client.split_once(':') {
            Some((person, _)) if self.has_people => person.into(),
            _ => client.into(),
        })
    }

    /// Changes what a holder has, and with it the total and the ranking.
    fn change(&mut self, holder: &Holder, change: impl FnOnce(&mut Held)) {
        let mut held = self.holders.remove(holder).unwrap_or_default();
        if let Some(oldest) = held.oldest() {
            self.ranking.remove(&(held.cost, oldest));
        }
        self.cost -= held.cost;
        change(&mut held);
        self.cost += held.cost;
        if let Some(oldest) = held.oldest() {
            self.ranking.insert((held.cost, oldest), holder.clone());
            self.holders.insert(holder.clone(), held);
        }
    }
}

impl Held {
    fn oldest(&self) -> Option<Reverse<u64>> {
        self.replies.front().map(|(number, _)| Reverse(*number))
    }

    fn remove(&mut self, number: u64, cost: usize) {
        if let Ok(place) = self.replies.binary_search_by_key(&number, |it| it.0) {
            self.replies.remove(place);
            self.cost -= cost;
        }
    }
}

/// The share of the total that a reply takes.
fn cost(reply: &Result<Payload, Payload>) -> usize {
    let (Ok(payload) | Err(payload)) = reply;
    MIN_COST.max(REPLY_BYTES + payload.bytes.len())
}

/// The write that persists the reply to a request.
fn insert_write(name: &Name, digest: Digest, reply: &Result<Payload, Payload>) -> Write {
    let (client, request_id) = name.clone();
    let (Ok(payload) | Err(payload)) = reply;
    Write::InsertReply(store::StoredReply {
        client,
        request_id,
        digest,
        swarm: String::new(),
        number: 0,
        is_ok: reply.is_ok(),
        encoding: payload.encoding.to_owned(),
        body: payload.bytes.clone(),
    })
}

/// The write that deletes the reply to a request.
fn delete_write(name: &Arc<Name>) -> Write {
    let (client, request_id) = (**name).clone();
    Write::DeleteReply { client, request_id }
}

#[cfg(test)]
mod tests;
