//! Replies to requests: each request gets one, from the thread `replies`.
//!
//! A request that no handler answers gets a reply all the same: at its deadline, or `internal` when
//! its last responder is dropped.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::thread;
use std::time::{Duration, Instant};

use tracing::error;

use crate::api::deadlines::{DeadlineId, Deadlines, Expire};
use crate::api::incoming::Incoming;
use crate::convert::Payload;
use crate::convert::error::CommandError;
use crate::metrics::Activity;
use crate::persistence::reply_cache::ReplySlot;
use crate::swarm::error::SwarmError;
use crate::swarm::frame::Stamp;
use crate::swarm::handle::LastStep;
use crate::swarm::outcome::{Outcome, Rejection, SwarmReply};

/// The resolution of the queue of deadlines. A shorter timeout passes at once.
const TIMER_RESOLUTION: Duration = Duration::from_millis(1);

/// Makes the error of a deadline that passed after so many seconds.
pub type TimeoutError = fn(f64) -> CommandError;

/// Encodes a reply on the thread that sends it, so that encoding does not delay a swarm.
type Encode = Box<dyn FnOnce() -> Result<Payload, Payload> + Send>;

/// Replies to a request under one key, once. Clones reply to the same request.
#[derive(Clone)]
pub struct Responder(Arc<Pending>);

/// A responder that does not keep its request pending.
pub struct WeakResponder(Weak<Pending>);

/// A request without a reply.
struct Pending {
    incoming: Mutex<Option<Incoming>>,
    /// Where the reply is remembered, if the request has an id.
    slot: Mutex<Option<Box<dyn ReplySlot>>>,
    deadlines: Mutex<Vec<DeadlineId>>,
    key: String,
    replies: Replies,
}

/// The deadline of a request.
struct Deadline {
    responder: WeakResponder,
    timeout: Duration,
    error: TimeoutError,
    step: Option<LastStep>,
}

/// The thread that sends replies, and the deadlines. Clones share them.
#[derive(Clone)]
pub struct Replies {
    /// `None` ends the thread.
    outgoing: Sender<Option<Outgoing>>,
    deadlines: Deadlines<Deadline>,
    /// Whether the thread is working.
    pub pulse: Arc<Activity>,
    /// Whether the daemon is stopping: swarms that end then exist again after the restart.
    is_closing: Arc<AtomicBool>,
    /// Requests whose responder was dropped without a reply.
    dropped: Arc<AtomicU64>,
}

/// A reply on its way to the client and to the idempotency cache.
struct Outgoing {
    incoming: Option<(Incoming, String)>,
    slot: Option<Box<dyn ReplySlot>>,
    encode: Encode,
}

impl Replies {
    /// Starts the thread.
    ///
    /// # Errors
    ///
    /// When the system starts no thread.
    pub fn start() -> std::io::Result<Self> {
        let (outgoing, receiver) = channel();
        let pulse = Arc::new(Activity::default());
        let sending = pulse.clone();
        thread::Builder::new()
            .name("replies".into())
            .spawn(move || send_all(&receiver, &sending))?;
        Ok(Replies {
            outgoing,
            deadlines: Deadlines::start(),
            pulse,
            is_closing: Arc::default(),
            dropped: Arc::default(),
        })
    }

    /// A responder to a request, which replies under `key`.
    pub fn responder(&self, incoming: &Incoming, key: String) -> Responder {
        Responder(Arc::new(Pending {
            incoming: Mutex::new(Some(incoming.clone())),
            slot: Mutex::default(),
            deadlines: Mutex::default(),
            key,
            replies: self.clone(),
        }))
    }

    /// Requests whose responder was dropped without a reply.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// From now on no reply says that a swarm does not exist: the client gets no reply, as from a
    /// daemon that does not run, and retries.
    pub fn close(&self) {
        self.is_closing.store(true, Ordering::Release);
    }

    /// Ends the thread once it has sent all replies.
    pub fn stop(&self) {
        let _ = self.outgoing.send(None);
    }

    fn send(&self, outgoing: Outgoing) {
        // An error means that the daemon is stopping: the client gets no reply.
        let _ = self.outgoing.send(Some(outgoing));
    }
}

impl Responder {
    /// Has the reply of `complete` remembered in a slot of the idempotency cache.
    pub fn remember_in(&self, slot: Box<dyn ReplySlot>) {
        *lock(&self.0.slot) = Some(slot);
    }

    /// Replies, unless there is a reply already. The slot of the request stays open.
    pub fn send(&self, encode: impl FnOnce() -> Result<Payload, Payload> + Send + 'static) {
        self.0.send(None, Box::new(encode));
    }

    /// Replies with the result of the request. It is remembered even if the deadline has passed.
    pub fn complete(&self, encode: impl FnOnce() -> Result<Payload, Payload> + Send + 'static) {
        let slot = lock(&self.0.slot).take();
        self.0.send(slot, Box::new(encode));
    }

    /// Replies to a command with what the swarm returned: `payload` encodes an outcome.
    pub fn respond(
        &self,
        answered: SwarmReply,
        payload: impl FnOnce(Stamp, Outcome) -> Payload + Send + 'static,
    ) {
        match answered {
            Ok((stamp, outcome)) => self.complete(move || Ok(payload(stamp, outcome))),
            // It was executed, but not to its end.
            Err(Rejection {
                step,
                error: error @ SwarmError::Faulted(_),
            }) => {
                self.complete(move || Err(Payload::json(&CommandError::from(error).to_wire(step))));
            }
            Err(Rejection { step, error }) => self.reject(&error.into(), step),
        }
    }

    /// Replies with an error; the request has changed nothing and its id may be used again. A
    /// wildcard request gets no reply about a swarm that does not exist.
    pub fn reject(&self, error: &CommandError, step: Option<u64>) {
        let is_gone = matches!(error, CommandError::Order(SwarmError::Gone));
        let is_unknown = matches!(error, CommandError::UnknownSwarm(_));
        let is_closing = self.0.replies.is_closing.load(Ordering::Acquire);
        let is_wild = || {
            lock(&self.0.incoming)
                .as_ref()
                .is_some_and(Incoming::is_wild)
        };
        if (is_gone && is_closing) || ((is_gone || is_unknown) && is_wild()) {
            drop(lock(&self.0.incoming).take());
            return;
        }
        let payload = Payload::json(&error.to_wire(step));
        if let Some(slot) = lock(&self.0.slot).take() {
            slot.forget(&payload);
        }
        self.send(move || Err(payload));
    }

    /// Replies with an error if there is no reply after `timeout`; `step` is the step to state.
    pub fn set_deadline(&self, timeout: Duration, error: TimeoutError, step: Option<LastStep>) {
        let deadline = Deadline {
            responder: self.downgrade(),
            timeout,
            error,
            step,
        };
        if timeout < TIMER_RESOLUTION {
            return deadline.expire();
        }
        let deadlines = &self.0.replies.deadlines;
        let id = deadlines.add(Instant::now() + timeout, deadline);
        lock(&self.0.deadlines).push(id);
    }

    /// A responder that does not keep the request pending.
    pub fn downgrade(&self) -> WeakResponder {
        WeakResponder(Arc::downgrade(&self.0))
    }

    /// Whether there is a reply.
    pub fn is_done(&self) -> bool {
        lock(&self.0.incoming).is_none()
    }
}

impl WeakResponder {
    /// The responder, unless all were dropped.
    pub fn upgrade(&self) -> Option<Responder> {
        self.0.upgrade().map(Responder)
    }
}

impl Expire for Deadline {
    fn expire(self) {
        if let Some(responder) = self.responder.upgrade() {
            responder.send(move || {
                let error = (self.error)(self.timeout.as_secs_f64());
                let step = self.step.and_then(|step| step.get());
                Err(Payload::json(&error.to_wire(step)))
            });
        }
    }
}

impl Pending {
    fn send(&self, slot: Option<Box<dyn ReplySlot>>, encode: Encode) {
        let incoming = lock(&self.incoming).take();
        let incoming = incoming.map(|incoming| (incoming, self.key.clone()));
        if incoming.is_some() {
            for id in std::mem::take(&mut *lock(&self.deadlines)) {
                self.replies.deadlines.remove(id);
            }
        }
        if incoming.is_some() || slot.is_some() {
            self.replies.send(Outgoing {
                incoming,
                slot,
                encode,
            });
        }
    }
}

impl Drop for Pending {
    /// Replies `internal` if there is no reply. Whether the request was executed is unknown, so its
    /// slot, which is dropped with it, does not keep the client from sending the request again.
    fn drop(&mut self) {
        let is_closing = self.replies.is_closing.load(Ordering::Acquire);
        if is_closing || lock(&self.incoming).is_none() {
            return;
        }
        self.replies.dropped.fetch_add(1, Ordering::Relaxed);
        error!(
            key = self.key,
            "a defect: a request was dropped without a reply"
        );
        let payload = Payload::json(&CommandError::Dropped.to_wire(None));
        self.send(None, Box::new(move || Err(payload)));
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn send_all(receiver: &Receiver<Option<Outgoing>>, pulse: &Activity) {
    while let Ok(Some(reply)) = receiver.recv() {
        pulse.begin();
        reply.send();
        pulse.end();
    }
}

impl Outgoing {
    fn send(self) {
        let Outgoing {
            incoming,
            slot,
            encode,
        } = self;
        let reply = catch_unwind(AssertUnwindSafe(encode))
            .unwrap_or_else(|_| Err(Payload::json(&CommandError::Internal.to_wire(None))));
        if let Some(slot) = slot {
            slot.write(&reply);
        }
        if let Some((incoming, key)) = incoming {
            incoming.reply(&key, reply);
        }
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::sync::mpsc::TryRecvError;

    use serde_json::Value;

    use super::*;
    use crate::api::admission::Admission;
    use crate::api::incoming::{Peer, Received, Target};

    const LONG: Duration = Duration::from_secs(20);

    struct Client(Sender<Result<Payload, Payload>>);

    impl Peer for Client {
        fn reply(&self, _: &str, reply: Result<Payload, Payload>) {
            self.0.send(reply).unwrap();
        }

        fn matches(&self, _: &str) -> bool {
            false
        }
    }

    /// A request, and the replies to it.
    fn request(is_wild: bool) -> (Incoming, Receiver<Result<Payload, Payload>>) {
        let (sender, replies) = channel();
        let received = Received {
            target: Target::NodeGet,
            key: "jostle/ants/cmd/step".to_owned(),
            is_wild,
            parameters: Vec::new(),
            payload: Vec::new(),
            encoding: None,
            token: Vec::new(),
            peer: Box::new(Client(sender)),
        };
        let permit = Admission::default().admit(0, &Arc::default()).unwrap();
        (Incoming::new(received, permit), replies)
    }

    fn code(reply: Result<Payload, Payload>) -> String {
        let error: Value = serde_json::from_slice(&reply.unwrap_err().bytes).unwrap();
        error["code"].as_str().unwrap().to_owned()
    }

    #[tokio::test]
    async fn a_request_whose_last_responder_is_dropped_gets_internal_and_is_counted() {
        let sender = Replies::start().unwrap();
        let (incoming, replies) = request(false);
        let responder = sender.responder(&incoming, "key".into());
        drop(responder.clone());
        assert_eq!(replies.try_recv().unwrap_err(), TryRecvError::Empty);
        drop(responder);
        assert_eq!(code(replies.recv_timeout(LONG).unwrap()), "internal");
        assert_eq!(sender.dropped(), 1);
        // A request with a reply is not counted, and gets no second one.
        let responder = sender.responder(&incoming, "key".into());
        responder.reject(&CommandError::Busy, None);
        responder.reject(&CommandError::Internal, None);
        drop(responder);
        assert_eq!(code(replies.recv_timeout(LONG).unwrap()), "busy");
        sender.stop();
        drop((incoming, sender));
        assert!(replies.recv_timeout(LONG).is_err());
    }

    #[tokio::test]
    async fn a_daemon_that_stops_drops_requests_without_a_reply() {
        let sender = Replies::start().unwrap();
        let (incoming, replies) = request(false);
        sender.close();
        drop(sender.responder(&incoming, "key".into()));
        let responder = sender.responder(&incoming, "key".into());
        responder.reject(&SwarmError::Gone.into(), None);
        sender.stop();
        drop((incoming, responder));
        assert!(replies.recv_timeout(LONG).is_err());
        assert_eq!(sender.dropped(), 0);
    }

    #[tokio::test]
    async fn a_wildcard_request_gets_no_reply_of_a_swarm_that_does_not_exist() {
        let sender = Replies::start().unwrap();
        let (incoming, replies) = request(true);
        for error in [
            SwarmError::Gone.into(),
            CommandError::UnknownSwarm("ants".into()),
        ] {
            sender
                .responder(&incoming, "key".into())
                .reject(&error, None);
        }
        let responder = sender.responder(&incoming, "key".into());
        responder.reject(&CommandError::Busy, None);
        assert_eq!(code(replies.recv_timeout(LONG).unwrap()), "busy");
        assert!(replies.try_recv().is_err());
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 1)]
    async fn a_deadline_gives_the_reply_and_a_result_comes_too_late() {
        let sender = Replies::start().unwrap();
        let (incoming, replies) = request(false);
        let responder = sender.responder(&incoming, "key".into());
        responder.set_deadline(Duration::from_millis(1), CommandError::deadline, None);
        assert_eq!(
            code(replies.recv_timeout(LONG).unwrap()),
            "deadline_exceeded"
        );
        responder.complete(|| Ok(Payload::json(&"late")));
        // One that is answered in time gets nothing at its deadline.
        let responder = sender.responder(&incoming, "key".into());
        responder.set_deadline(Duration::from_millis(1), CommandError::deadline, None);
        responder.complete(|| Ok(Payload::json(&"in time")));
        let reply = replies.recv_timeout(LONG).unwrap();
        assert!(reply.is_ok() || code(reply) == "deadline_exceeded");
        tokio::time::sleep(Duration::from_millis(50)).await;
        assert!(replies.try_recv().is_err());
    }

    #[tokio::test]
    async fn a_reply_that_cannot_be_encoded_is_internal_and_the_next_is_sent() {
        let sender = Replies::start().unwrap();
        let (incoming, replies) = request(false);
        let responder = sender.responder(&incoming, "key".into());
        responder.complete(|| panic!("a defect"));
        assert_eq!(code(replies.recv_timeout(LONG).unwrap()), "internal");
        let responder = sender.responder(&incoming, "key".into());
        responder.complete(|| Ok(Payload::json(&1)));
        assert!(replies.recv_timeout(LONG).unwrap().is_ok());
    }
}
