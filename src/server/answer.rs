//! Answers to queries: each is given once, in time, from a thread of its own.
//!
//! Whoever has the answer only hands it over. A query that nobody answers, because its swarm
//! ended or its time was up, is answered all the same: no asker is left in silence.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use tracing::debug;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::query::Query;

use crate::command::CommandError;
use crate::meter::Pulse;
use crate::server::ledger::Page;
use crate::swarm::order::OrderError;
use crate::wire::Payload;

/// Queries by one door that may be unanswered; beyond that new ones are turned away. So many are
/// answered within a few milliseconds, and no door takes all the room there is for others, who wait
/// behind these: with 256 twice as long, with 64 or 16 no shorter. A hundred at once are served.
const MOST_TURNS: usize = 128;

/// Bytes of requests that may be held unanswered; beyond that new queries are turned away.
const MOST_HELD_BYTES: usize = 64 * 1024 * 1024;

/// Deadlines kept without looking for those that no longer matter.
const DEADLINES_BEFORE_SWEEP: usize = 4096;

/// Words that an answer did not come within so many seconds.
pub type Excuse = fn(f64) -> CommandError;

/// Makes a payload when it is about to be sent, so that encoding costs its sender nothing.
type Body = Box<dyn FnOnce() -> Result<Payload, Payload> + Send>;

/// An answer that is owed. Clones owe the same one.
#[derive(Clone)]
pub struct Promise(Arc<Owed>);

struct Owed {
    asked: Mutex<Option<Asked>>,
    page: Mutex<Option<Page>>,
    key: String,
    desk: Desk,
}

/// Where answers are handed in.
#[derive(Clone)]
pub struct Desk {
    /// Nothing ends it.
    outgoing: Sender<Option<Outgoing>>,
    deadlines: Arc<Deadlines>,
    /// Whether the sending thread is at work.
    pub pulse: Arc<Pulse>,
    held_bytes: Arc<AtomicUsize>,
    /// Whether the daemon is going: swarms that end then are there again when it is back.
    is_closing: Arc<AtomicBool>,
}

/// A query that was taken in. Clones are the same one.
#[derive(Clone)]
pub struct Asked {
    /// What came in.
    pub query: Query,
    turn: Option<Arc<Turn>>,
}

impl Asked {
    /// The same query, when it is to wait for something: it then keeps nobody else out.
    #[must_use]
    pub fn aside(&self) -> Asked {
        Asked {
            query: self.query.clone(),
            turn: None,
        }
    }
}

/// What a query takes up from when it comes in until its answer is sent.
struct Turn {
    bytes: usize,
    all_bytes: Arc<AtomicUsize>,
    turns: Arc<AtomicUsize>,
}

impl Drop for Turn {
    fn drop(&mut self) {
        self.all_bytes.fetch_sub(self.bytes, Ordering::Relaxed);
        self.turns.fetch_sub(1, Ordering::Relaxed);
    }
}

/// An answer to whoever still waits under a key, and to the ledger.
struct Outgoing {
    asker: Option<(Asked, String)>,
    page: Option<Page>,
    body: Body,
}

/// When promises are to be kept at the latest. Whoever watches them is woken by a time that comes
/// before all others, and not by every promise: in a flood those are ten thousands a second.
#[derive(Default)]
struct Deadlines {
    dues: Mutex<Dues>,
    changed: Condvar,
}

#[derive(Default)]
struct Dues {
    heap: BinaryHeap<Reverse<Due>>,
    /// How many there are to be before those are dropped that no longer matter.
    sweep_at: usize,
    is_stopped: bool,
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
        let deadlines = Arc::new(Deadlines::default());
        let to_watch = deadlines.clone();
        let pulse = Arc::new(Pulse::default());
        let sending = pulse.clone();
        thread::Builder::new()
            .name("replies".into())
            .spawn(move || send_all(&to_send, &sending))?;
        thread::Builder::new()
            .name("deadlines".into())
            .spawn(move || to_watch.watch())?;
        Ok(Desk {
            outgoing,
            deadlines,
            pulse,
            held_bytes: Arc::default(),
            is_closing: Arc::default(),
        })
    }

    /// Promises to answer a query under `key`.
    pub fn promise(&self, asked: &Asked, key: String) -> Promise {
        Promise(Arc::new(Owed {
            asked: Mutex::new(Some(asked.clone())),
            page: Mutex::default(),
            key,
            desk: self.clone(),
        }))
    }

    /// Takes in a query, unless so much is unanswered already that it is to be turned away.
    /// `turns` counts those that came in by the same door.
    pub fn take_in(&self, query: &Query, turns: &Arc<AtomicUsize>) -> Option<Asked> {
        let bytes = query.payload().map_or(0, ZBytes::len);
        // What is taken first and found to be too much is given back by its end.
        let others = turns.fetch_add(1, Ordering::Relaxed);
        let other_bytes = self.held_bytes.fetch_add(bytes, Ordering::Relaxed);
        let turn = Turn {
            bytes,
            all_bytes: self.held_bytes.clone(),
            turns: turns.clone(),
        };
        if others >= MOST_TURNS || (bytes > 0 && other_bytes >= MOST_HELD_BYTES) {
            return None;
        }
        Some(Asked {
            query: query.clone(),
            turn: Some(Arc::new(turn)),
        })
    }

    /// From here on nobody is told that a swarm is gone: whoever asked hears nothing, as of a daemon
    /// that is not there, and asks again.
    pub fn close(&self) {
        self.is_closing.store(true, Ordering::Release);
    }

    /// Ends the sending thread once it has sent what was handed in, and the watching one.
    pub fn stop(&self) {
        let _ = self.outgoing.send(None);
        self.deadlines.stop();
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
        let is_gone = matches!(error, CommandError::Order(OrderError::Gone));
        if is_gone && self.0.desk.is_closing.load(Ordering::Acquire) {
            return drop(self.lock().take());
        }
        let payload = Payload::json(&error.to_wire(step));
        if let Some(page) = self.page().take() {
            page.tear_out(&payload);
        }
        self.keep(move || Err(payload));
    }

    fn hand_in(&self, page: Option<Page>, body: Body) {
        let Owed { key, desk, .. } = &*self.0;
        let asker = self.lock().take().map(|asked| (asked, key.clone()));
        if asker.is_some() || page.is_some() {
            // Once the desk is closed the daemon is going, and its silence says so.
            let _ = desk.outgoing.send(Some(Outgoing { asker, page, body }));
        }
    }

    /// Refuses at the latest after `patience`, as `excuse` words it and with the step that `step`
    /// then tells.
    pub fn keep_within(
        &self,
        patience: Duration,
        excuse: Excuse,
        step: impl FnOnce() -> Option<u64> + Send + 'static,
    ) {
        static NUMBERS: AtomicU64 = AtomicU64::new(0);
        let excuse = move || Payload::json(&excuse(patience.as_secs_f64()).to_wire(step()));
        self.0.desk.deadlines.add(Due {
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

    fn lock(&self) -> MutexGuard<'_, Option<Asked>> {
        self.0.asked.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn page(&self) -> MutexGuard<'_, Option<Page>> {
        self.0.page.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Refuses a promise when dropped unkept: a ticket that its swarm never came to.
pub struct Keeper(pub Promise, bool);

impl Keeper {
    /// Watches over a promise.
    pub fn new(promise: Promise) -> Self {
        Keeper(promise, true)
    }

    /// Leaves the promise to whoever keeps it from here on.
    pub fn leave(mut self) -> Promise {
        self.1 = false;
        self.0.clone()
    }
}

impl Drop for Keeper {
    fn drop(&mut self) {
        if self.1 && !self.0.is_kept() {
            self.0.refuse(&OrderError::Gone.into(), None);
        }
    }
}

fn send_all(to_send: &Receiver<Option<Outgoing>>, pulse: &Pulse) {
    while let Ok(Some(Outgoing { asker, page, body })) = to_send.recv() {
        pulse.beat();
        let answer = catch_unwind(AssertUnwindSafe(body))
            .unwrap_or_else(|_| Err(Payload::json(&CommandError::Internal.to_wire(None))));
        if let Some(page) = page {
            page.write(&answer);
        }
        if let Some((Asked { query, turn: _turn }, key)) = asker {
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
        pulse.rest();
    }
}

impl Deadlines {
    fn add(&self, due: Due) {
        let mut dues = self.lock();
        if dues.is_stopped {
            return;
        }
        if dues.heap.len() >= dues.sweep_at {
            dues.heap.retain(|Reverse(due)| !due.promise.is_kept());
            dues.sweep_at = (2 * dues.heap.len()).max(DEADLINES_BEFORE_SWEEP);
        }
        let is_first = dues
            .heap
            .peek()
            .is_none_or(|Reverse(first)| due.at < first.at);
        dues.heap.push(Reverse(due));
        drop(dues);
        if is_first {
            self.changed.notify_one();
        }
    }

    /// Refuses what is not kept in time, until stopped.
    fn watch(&self) {
        let mut dues = self.lock();
        while !dues.is_stopped {
            let Some(Reverse(first)) = dues.heap.peek() else {
                let woken = self.changed.wait(dues);
                dues = woken.unwrap_or_else(PoisonError::into_inner);
                continue;
            };
            let left = first.at.saturating_duration_since(Instant::now());
            if !left.is_zero() {
                let woken = self.changed.wait_timeout(dues, left);
                dues = woken.unwrap_or_else(PoisonError::into_inner).0;
                continue;
            }
            let due = dues.heap.pop();
            drop(dues);
            if let Some(Reverse(Due {
                promise, excuse, ..
            })) = due
                && !promise.is_kept()
            {
                promise.keep(move || Err(excuse()));
            }
            dues = self.lock();
        }
        // What is owed holds the desk, and letting go of a query may wait for a frozen client.
        let left = std::mem::take(&mut dues.heap);
        drop(dues);
        drop(left);
    }

    fn stop(&self) {
        self.lock().is_stopped = true;
        self.changed.notify_one();
    }

    fn lock(&self) -> MutexGuard<'_, Dues> {
        self.dues.lock().unwrap_or_else(PoisonError::into_inner)
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
