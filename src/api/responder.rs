//! Answers to queries: each is given once, in time, from a thread of its own.
//!
//! Whoever has the answer only hands it over. A query that nobody answers, because its swarm
//! ended or its time was up, is answered all the same: no asker is left in silence.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use tracing::debug;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::query::Query;

use crate::api::commands::CommandError;
use crate::api::deadlines::{Deadlines, Due};
use crate::api::idempotency::Page;
use crate::convert::Payload;
use crate::metrics::Pulse;
use crate::swarm::outcome::OrderError;
use crate::transport::zenoh::session_pool::LeaseGuard;

/// Queries by one door that may be unanswered; beyond that new ones are turned away. So many are
/// answered within a few milliseconds, and no door takes all the room there is for others, who wait
/// behind these: with 256 twice as long, with 64 or 16 no shorter. A hundred at once are served.
const MOST_TURNS: usize = 128;

/// Bytes of requests that may be held unanswered; beyond that new queries are turned away.
const MOST_HELD_BYTES: usize = 64 * 1024 * 1024;

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
    _turn: Option<Arc<Turn>>,
    /// Until the reply is sent, the session that received the query stays open.
    guard: Option<LeaseGuard>,
    door: Option<Arc<Door>>,
}

/// Where a query came in, while whoever reads it stays there: an answer that is given meanwhile is
/// sent from there, which is sooner than another thread would be woken.
#[derive(Default)]
pub struct Door(Mutex<AtTheDoor>);

#[derive(Default)]
enum AtTheDoor {
    #[default]
    Nothing,
    Answer(Box<Outgoing>),
    Shut,
}

impl Door {
    /// Leaves an answer here; gives it back if the door is shut.
    fn leave(&self, answer: Outgoing) -> Option<Outgoing> {
        let mut door = self.lock();
        match *door {
            AtTheDoor::Nothing => {
                *door = AtTheDoor::Answer(Box::new(answer));
                None
            }
            _ => Some(answer),
        }
    }

    /// Sends the answer that was left here. Those that come later go another way.
    pub fn shut(&self) {
        let before = std::mem::replace(&mut *self.lock(), AtTheDoor::Shut);
        if let AtTheDoor::Answer(answer) = before {
            answer.send();
        }
    }

    fn lock(&self) -> MutexGuard<'_, AtTheDoor> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Asked {
    /// The same query, when it is to wait for something: it then keeps nobody else out.
    #[must_use]
    pub fn aside(&self) -> Asked {
        Asked {
            query: self.query.clone(),
            _turn: None,
            guard: self.guard.clone(),
            door: None,
        }
    }

    /// The same query, while whoever reads it waits at the door.
    pub fn at(&self, door: &Arc<Door>) -> Asked {
        Asked {
            door: Some(door.clone()),
            ..self.clone()
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
    /// `turns` counts the unanswered queries of its queryable; `guard` keeps the session open that
    /// received it.
    pub fn take_in(
        &self,
        query: &Query,
        turns: &Arc<AtomicUsize>,
        guard: Option<&LeaseGuard>,
    ) -> Option<Asked> {
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
            _turn: Some(Arc::new(turn)),
            guard: guard.cloned(),
            door: None,
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

    /// Refuses what was asked for; nothing has changed then. Whoever asked whatever swarms there are
    /// does not hear of one that is gone.
    pub fn refuse(&self, error: &CommandError, step: Option<u64>) {
        let is_gone = matches!(error, CommandError::Order(OrderError::Gone));
        let is_unknown = matches!(error, CommandError::UnknownSwarm(_));
        let is_closing = self.0.desk.is_closing.load(Ordering::Acquire);
        if (is_gone && is_closing) || ((is_gone || is_unknown) && self.is_of_many()) {
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
        let mut asked = self.lock().take();
        let door = asked.as_mut().and_then(|asked| asked.door.take());
        let asker = asked.map(|asked| (asked, key.clone()));
        if asker.is_none() && page.is_none() {
            return;
        }
        let answer = Outgoing { asker, page, body };
        let to_send = match door {
            Some(door) => door.leave(answer),
            None => Some(answer),
        };
        if to_send.is_some() {
            // Once the desk is closed the daemon is going, and its silence says so.
            let _ = desk.outgoing.send(to_send);
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
        let excuse = move || Payload::json(&excuse(patience.as_secs_f64()).to_wire(step()));
        let due = Due::new(Instant::now() + patience, self.clone(), Box::new(excuse));
        self.0.desk.deadlines.add(due);
    }

    /// Whether whoever reads the query waits at the door.
    pub fn is_at_the_door(&self) -> bool {
        self.lock()
            .as_ref()
            .is_some_and(|asked| asked.door.is_some())
    }

    /// Whether the query is for whatever swarms there are.
    fn is_of_many(&self) -> bool {
        self.lock()
            .as_ref()
            .is_some_and(|asked| asked.query.key_expr().is_wild())
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
    while let Ok(Some(answer)) = to_send.recv() {
        pulse.beat();
        answer.send();
        pulse.rest();
    }
}

impl Outgoing {
    fn send(self) {
        let Outgoing { asker, page, body } = self;
        let answer = catch_unwind(AssertUnwindSafe(body))
            .unwrap_or_else(|_| Err(Payload::json(&CommandError::Internal.to_wire(None))));
        if let Some(page) = page {
            page.write(&answer);
        }
        let Some((Asked { query, .. }, key)) = &asker else {
            return;
        };
        let sent = match answer {
            Ok(Payload {
                bytes, encoding, ..
            }) => query.reply(key, bytes).encoding(encoding).wait(),
            Err(Payload {
                bytes, encoding, ..
            }) => query.reply_err(bytes).encoding(encoding).wait(),
        };
        if let Err(error) = sent {
            debug!(%error, "failed to send an answer");
        }
    }
}
