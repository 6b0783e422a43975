//! Answers to queries: each is given once, in time, from a thread of its own.
//!
//! Whoever has the answer only hands it over. A query that nobody answers, because its swarm
//! ended or its time was up, is answered all the same: no asker is left in silence.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use tracing::debug;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::query::Query;

use crate::command::CommandError;
use crate::server::ledger::Page;
use crate::swarm::order::OrderError;
use crate::wire::Payload;

/// Answers that may wait to be sent; beyond that new queries are turned away.
const MOST_UNSENT: usize = 8192;

/// Bytes of requests that may be held unanswered; beyond that new queries are turned away.
const MOST_HELD_BYTES: usize = 64 * 1024 * 1024;

/// Deadlines kept without looking for those that no longer matter.
const DEADLINES_BEFORE_SWEEP: usize = 4096;

/// Makes a payload when it is about to be sent, so that encoding costs its sender nothing.
type Body = Box<dyn FnOnce() -> Result<Payload, Payload> + Send>;

/// An answer that is owed. Clones owe the same one.
#[derive(Clone)]
pub struct Promise(Arc<Owed>);

struct Owed {
    query: Mutex<Option<Query>>,
    _held: Held,
    page: Mutex<Option<Page>>,
    key: String,
    desk: Desk,
}

/// Where answers are handed in.
#[derive(Clone)]
pub struct Desk {
    outgoing: Sender<Outgoing>,
    deadlines: Sender<Due>,
    unsent: Arc<AtomicUsize>,
    held_bytes: Arc<AtomicUsize>,
}

/// The bytes of a request, counted as long as this lives.
pub struct Held {
    bytes: usize,
    all: Arc<AtomicUsize>,
}

impl Drop for Held {
    fn drop(&mut self) {
        self.all.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

enum Outgoing {
    /// To whoever still waits, and to the ledger.
    Answer(Option<(Query, String)>, Option<Page>, Body),
    Stop,
}

/// A promise, when it is to be kept, and what is said if it was not.
struct Due {
    at: Instant,
    number: u64,
    promise: Promise,
    excuse: Box<dyn FnOnce() -> Payload + Send>,
}

impl Desk {
    /// Starts the thread that sends answers and the one that watches their deadlines.
    ///
    /// # Errors
    ///
    /// When no thread can be started.
    pub fn start() -> std::io::Result<Self> {
        let (outgoing, to_send) = channel();
        let (deadlines, to_watch) = channel();
        let unsent = Arc::new(AtomicUsize::new(0));
        let sent = unsent.clone();
        thread::Builder::new()
            .name("replies".into())
            .spawn(move || send_all(&to_send, &sent))?;
        thread::Builder::new()
            .name("deadlines".into())
            .spawn(move || watch_all(&to_watch))?;
        Ok(Desk {
            outgoing,
            deadlines,
            unsent,
            held_bytes: Arc::default(),
        })
    }

    /// Promises to answer `query` under `key`.
    pub fn promise(&self, query: Query, key: String) -> Promise {
        Promise(Arc::new(Owed {
            _held: self.hold(&query),
            query: Mutex::new(Some(query)),
            page: Mutex::default(),
            key,
            desk: self.clone(),
        }))
    }

    /// Counts the bytes of a query's request.
    pub fn hold(&self, query: &Query) -> Held {
        let bytes = query.payload().map_or(0, ZBytes::len);
        self.held_bytes.fetch_add(bytes, Ordering::Relaxed);
        Held {
            bytes,
            all: self.held_bytes.clone(),
        }
    }

    /// Whether so much is unanswered or unsent that no more should be promised.
    pub fn is_full(&self) -> bool {
        self.unsent.load(Ordering::Relaxed) >= MOST_UNSENT
            || self.held_bytes.load(Ordering::Relaxed) >= MOST_HELD_BYTES
    }

    /// Ends the sending thread once it has sent what was handed in.
    pub fn stop(&self) {
        let _ = self.outgoing.send(Outgoing::Stop);
    }
}

impl Promise {
    /// Has what the request comes to written down.
    pub fn note_on(&self, page: Page) {
        *self.page() = Some(page);
    }

    /// Keeps the promise, if it has not been kept before.
    pub fn keep(&self, body: impl FnOnce() -> Result<Payload, Payload> + Send + 'static) {
        self.hand_in(None, Box::new(body));
    }

    /// Keeps the promise with what the request came to. That is written down even if its sender
    /// was told in the meantime that it takes long.
    pub fn fulfil(&self, body: impl FnOnce() -> Result<Payload, Payload> + Send + 'static) {
        let page = self.page().take();
        self.hand_in(page, Box::new(body));
    }

    /// Refuses what was asked for; nothing has changed then.
    pub fn refuse(&self, error: &CommandError, step: Option<u64>) {
        let payload = Payload::json(&error.to_wire(step));
        if let Some(page) = self.page().take() {
            page.tear_out(&payload);
        }
        self.keep(move || Err(payload));
    }

    fn hand_in(&self, page: Option<Page>, body: Body) {
        let Owed { key, desk, .. } = &*self.0;
        let asker = self.take().map(|query| (query, key.clone()));
        if asker.is_some() || page.is_some() {
            desk.unsent.fetch_add(1, Ordering::Relaxed);
            // Once the desk is closed the daemon is going, and its silence says so.
            let _ = desk.outgoing.send(Outgoing::Answer(asker, page, body));
        }
    }

    /// Refuses at the latest after `patience`, with the step that `step` then tells.
    pub fn keep_within(
        &self,
        patience: Duration,
        step: impl FnOnce() -> Option<u64> + Send + 'static,
    ) {
        static NUMBERS: AtomicU64 = AtomicU64::new(0);
        let excuse = move || {
            let after_secs = patience.as_secs_f64();
            Payload::json(&CommandError::Deadline { after_secs }.to_wire(step()))
        };
        let _ = self.0.desk.deadlines.send(Due {
            at: Instant::now() + patience,
            number: NUMBERS.fetch_add(1, Ordering::Relaxed),
            promise: self.clone(),
            excuse: Box::new(excuse),
        });
    }

    /// Whether it has been kept.
    pub fn is_kept(&self) -> bool {
        self.lock().is_none()
    }

    fn take(&self) -> Option<Query> {
        self.lock().take()
    }

    fn lock(&self) -> MutexGuard<'_, Option<Query>> {
        self.0.query.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn page(&self) -> MutexGuard<'_, Option<Page>> {
        self.0.page.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Refuses a promise when dropped unkept: a ticket that its swarm never came to.
pub struct Keeper(pub Promise);

impl Drop for Keeper {
    fn drop(&mut self) {
        if !self.0.is_kept() {
            self.0.refuse(&OrderError::Gone.into(), None);
        }
    }
}

fn send_all(to_send: &Receiver<Outgoing>, unsent: &AtomicUsize) {
    while let Ok(Outgoing::Answer(asker, page, body)) = to_send.recv() {
        let answer = catch_unwind(AssertUnwindSafe(body))
            .unwrap_or_else(|_| Err(Payload::json(&CommandError::Internal.to_wire(None))));
        if let Some(page) = page {
            page.write(&answer);
        }
        if let Some((query, key)) = asker {
            let sent = match answer {
                Ok(Payload { bytes, encoding }) => {
                    query.reply(key, bytes).encoding(encoding).wait()
                }
                Err(Payload { bytes, encoding }) => {
                    query.reply_err(bytes).encoding(encoding).wait()
                }
            };
            if let Err(error) = sent {
                debug!(%error, "failed to send an answer");
            }
        }
        unsent.fetch_sub(1, Ordering::Relaxed);
    }
}

fn watch_all(to_watch: &Receiver<Due>) {
    let mut dues: BinaryHeap<Reverse<Due>> = BinaryHeap::new();
    let mut sweep_at = DEADLINES_BEFORE_SWEEP;
    loop {
        let now = Instant::now();
        while dues.peek().is_some_and(|Reverse(due)| due.at <= now) {
            if let Some(Reverse(Due {
                promise, excuse, ..
            })) = dues.pop()
                && !promise.is_kept()
            {
                promise.keep(move || Err(excuse()));
            }
        }
        if dues.len() >= sweep_at {
            dues.retain(|Reverse(due)| !due.promise.is_kept());
            sweep_at = (2 * dues.len()).max(DEADLINES_BEFORE_SWEEP);
        }
        let next = match dues.peek() {
            Some(Reverse(due)) => {
                to_watch.recv_timeout(due.at.saturating_duration_since(Instant::now()))
            }
            None => to_watch.recv().map_err(|_| RecvTimeoutError::Disconnected),
        };
        match next {
            Ok(due) => dues.push(Reverse(due)),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

impl PartialEq for Due {
    fn eq(&self, other: &Self) -> bool {
        self.number == other.number
    }
}

impl Eq for Due {}

impl PartialOrd for Due {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Due {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (self.at, self.number).cmp(&(other.at, other.number))
    }
}
