//! Replies to requests: each request gets one, from the thread `replies`.
//!
//! A request that no handler answers gets a reply all the same: at its deadline, or `internal` when
//! its last responder is dropped.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::Duration;

use fail::fail_point;
use jostle_convert::Place;
use parking_lot::Mutex;
use serde::Deserialize;
use tokio::runtime::Handle as Runtime;
use tokio::task::AbortHandle;
use tokio::time::{Instant, sleep_until};
use tracing::error;

use crate::api::incoming::Incoming;
use crate::audit::{self, AuditTicket};
use crate::convert::Payload;
use crate::convert::error::CommandError;
use crate::metrics::Activity;
use crate::persistence::reply_cache::ReplySlot;
use crate::swarm::error::SwarmError;
use crate::swarm::frame::Stamp;
use crate::swarm::handle::{Handle, LastStep, Message, Outcome, Rejection, ReplyTo, SwarmReply};

/// The resolution of timers. A shorter timeout passes at once.
const TIMER_RESOLUTION: Duration = Duration::from_millis(1);

/// Makes the error of a deadline that passed after so many seconds.
pub type TimeoutError = fn(f64) -> CommandError;

/// Encodes a reply on the thread that sends it, so that encoding does not delay a swarm.
type Encode = Box<dyn FnOnce() -> Result<Payload, Payload> + Send>;

/// Replies to a request under one key, once. Clones reply to the same request.
#[derive(Clone)]
pub struct Responder(Arc<Pending>);

/// A request without a reply.
struct Pending {
    incoming: Mutex<Option<Incoming>>,
    /// Where the reply is cached, if the request has an id.
    slot: Mutex<Option<Box<dyn ReplySlot>>>,
    /// Its place in the audit log, if it is a command.
    audit: OnceLock<Arc<Mutex<AuditTicket>>>,
    deadlines: Mutex<Vec<AbortHandle>>,
    /// Whether the reply no longer depends on the deadline; only changed while `incoming` is locked.
    is_committed: AtomicBool,
    key: String,
    replies: Replies,
}

/// The thread that sends replies. Clones share it.
#[derive(Clone)]
pub struct Replies {
    /// `None` ends the thread.
    outgoing: Sender<Option<Outgoing>>,
    /// Executes the deadlines.
    runtime: Runtime,
    /// Whether the thread is working.
    pub activity: Arc<Activity>,
    /// Whether the daemon is stopping: swarms that end then exist again after the restart.
    is_closing: Arc<AtomicBool>,
    /// Requests whose responder was dropped without a reply.
    dropped: Arc<AtomicU64>,
}

/// A reply on its way to the client and to the idempotency cache.
struct Outgoing {
    incoming: Option<(Incoming, String)>,
    slot: Option<Box<dyn ReplySlot>>,
    audit: Option<Arc<Mutex<AuditTicket>>>,
    encode: Encode,
}

impl Replies {
    /// Starts the thread. Deadlines are tasks of the present runtime.
    pub(crate) fn start() -> std::io::Result<Self> {
        let (outgoing, receiver) = channel::<Option<Outgoing>>();
        let activity = Arc::new(Activity::default());
        let sending = activity.clone();
        thread::Builder::new()
            .name("replies".into())
            .spawn(move || {
                while let Ok(Some(reply)) = receiver.recv() {
                    sending.begin();
                    fail_point!("reply");
                    reply.send();
                    sending.end();
                }
            })?;
        Ok(Replies {
            outgoing,
            runtime: Runtime::current(),
            activity,
            is_closing: Arc::default(),
            dropped: Arc::default(),
        })
    }

    /// Calls the handler of a request. If it panics, the request gets one reply, `internal`: from its
    /// responder when that is dropped, or from here if the handler made none.
    pub fn catch_panic(&self, incoming: &Incoming, handler: impl FnOnce()) {
        if catch_unwind(AssertUnwindSafe(handler)).is_ok() {
            return;
        }
        let key = &incoming.key;
        error!(key, "a defect: the handler panicked");
        if !incoming.has_responder.load(Ordering::Relaxed) {
            let responder = self.responder(incoming, key.clone());
            responder.reject(&CommandError::Internal, None);
        }
    }

    /// A responder to a request, which replies under `key`.
    pub fn responder(&self, incoming: &Incoming, key: String) -> Responder {
        incoming.has_responder.store(true, Ordering::Relaxed);
        Responder(Arc::new(Pending {
            incoming: Mutex::new(Some(incoming.clone())),
            slot: Mutex::default(),
            audit: OnceLock::new(),
            deadlines: Mutex::default(),
            is_committed: AtomicBool::new(false),
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
}

impl Responder {
    /// Sets the slot of the idempotency cache into which `complete` writes the reply.
    pub fn set_slot(&self, slot: Box<dyn ReplySlot>) {
        *self.0.slot.lock() = Some(slot);
    }

    /// Sets its place in the audit log, which gets the outcome.
    pub fn set_audit(&self, ticket: AuditTicket) {
        let _ = self.0.audit.set(Arc::new(Mutex::new(ticket)));
    }

    /// Replies, unless there is a reply already. The slot of the request stays open.
    pub fn send(&self, encode: impl FnOnce() -> Result<Payload, Payload> + Send + 'static) {
        self.0.send(None, Box::new(encode));
    }

    /// Replies with the result of the request. It is cached even if the deadline has passed.
    pub fn complete(&self, encode: impl FnOnce() -> Result<Payload, Payload> + Send + 'static) {
        let slot = self.0.slot.lock().take();
        self.0.send(slot, Box::new(encode));
    }

    /// Replies with the result of a job, which `payload` encodes, or with its error.
    pub fn finish<T: Send + 'static>(
        &self,
        done: Result<T, impl Into<CommandError>>,
        payload: impl FnOnce(T) -> Payload + Send + 'static,
    ) {
        match done {
            Ok(result) => self.complete(move || Ok(payload(result))),
            Err(error) => self.reject(&error.into(), None),
        }
    }

    /// Sends a message to a swarm, whose reply `payload` encodes, and sets the deadline.
    pub fn send_to_swarm(
        &self,
        swarm: &Handle,
        (timeout, error): (Duration, TimeoutError),
        message: impl FnOnce(ReplyTo) -> Message,
        payload: impl FnOnce(Stamp, Outcome) -> Payload + Send + 'static,
    ) {
        self.set_deadline(timeout, error, Some(swarm.last_step()));
        self.pass_to_swarm(swarm, message, payload);
    }

    /// As [`send_to_swarm`](Self::send_to_swarm), of a request that has its deadline.
    pub fn pass_to_swarm(
        &self,
        swarm: &Handle,
        message: impl FnOnce(ReplyTo) -> Message,
        payload: impl FnOnce(Stamp, Outcome) -> Payload + Send + 'static,
    ) {
        let responder = self.clone();
        let reply_to = ReplyTo::new(move |reply| responder.respond(reply, payload));
        swarm.send(message(reply_to));
    }

    /// From now on the request does not count against the limit of its queryable.
    pub fn release_places(&self) {
        let mut incoming = self.0.incoming.lock();
        if let Some(incoming) = &mut *incoming {
            *incoming = incoming.without_places();
        }
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
                let error = CommandError::from(error).to_wire(step, &self.place());
                self.complete(move || Err(Payload::json(&error)));
            }
            Err(Rejection { step, error }) => self.reject(&error.into(), step),
        }
    }

    /// The place of what the request has.
    fn place(&self) -> Place {
        Place::of_key(&self.0.key)
    }

    /// Replies with an error; the request has changed nothing and its id may be used again. A
    /// wildcard request gets no reply about a swarm that does not exist.
    pub fn reject(&self, error: &CommandError, step: Option<u64>) {
        let is_gone = matches!(error, CommandError::Swarm(SwarmError::Gone));
        let is_unknown = matches!(error, CommandError::UnknownSwarm(_));
        let is_closing = self.0.replies.is_closing.load(Ordering::Acquire);
        let is_wild = || self.0.incoming.lock().as_ref().is_some_and(|it| it.is_wild);
        if (is_gone && is_closing) || ((is_gone || is_unknown) && is_wild()) {
            drop(self.0.incoming.lock().take());
            drop(self.0.slot.lock().take());
            return;
        }
        let payload = Payload::json(&error.to_wire(step, &self.place()));
        if let Some(slot) = self.0.slot.lock().take() {
            slot.reject(&payload);
        }
        self.send(move || Err(payload));
    }

    /// Replies with an error if there is no reply after `timeout`; `step` is the step to state.
    pub fn set_deadline(&self, timeout: Duration, error: TimeoutError, step: Option<LastStep>) {
        let pending = Arc::downgrade(&self.0);
        let expire = move || {
            if let Some(pending) = pending.upgrade() {
                pending.expire(move || {
                    let error = error(timeout.as_secs_f64());
                    let step = step.and_then(|step| step.get());
                    Err(Payload::json(&error.to_wire(step, &Place::default())))
                });
            }
        };
        if timeout < TIMER_RESOLUTION {
            return expire();
        }
        // Locked until the task is registered: a reply sent before that would not abort it.
        let incoming = self.0.incoming.lock();
        if incoming.is_none() {
            return;
        }
        let deadline = Instant::now() + timeout;
        // A runtime that is shutting down drops the task.
        let task = self.0.replies.runtime.spawn(async move {
            sleep_until(deadline).await;
            expire();
        });
        self.0.deadlines.lock().push(task.abort_handle());
        drop(incoming);
    }

    /// Whether there is no reply yet and the client may still wait: then none follows at the deadline, so
    /// that the client learns what is done now.
    pub fn commits(&self) -> bool {
        let incoming = self.0.incoming.lock();
        self.0.is_committed.store(true, Ordering::Relaxed);
        incoming.as_ref().is_some_and(|it| !it.peer.is_gone())
    }

    /// Returns a check of whether the request has no reply yet and its client still waits.
    pub fn is_wanted(&self) -> impl Fn() -> bool + Send + use<> {
        let responder = self.clone();
        move || responder.0.is_wanted()
    }

    /// Returns a weak check of whether the request has a reply or was dropped.
    pub fn is_abandoned(&self) -> impl Fn() -> bool + Send + use<> {
        let pending = Arc::downgrade(&self.0);
        move || {
            let pending = pending.upgrade();
            pending.is_none_or(|it| !it.is_wanted())
        }
    }

    /// Whether there is a reply.
    pub fn is_done(&self) -> bool {
        self.0.incoming.lock().is_none()
    }
}

impl Pending {
    /// Whether there is no reply yet and the client may still wait.
    fn is_wanted(&self) -> bool {
        let incoming = self.incoming.lock();
        incoming.as_ref().is_some_and(|it| !it.peer.is_gone())
    }

    /// Replies because the deadline has passed, unless the request is committed.
    fn expire(&self, encode: impl FnOnce() -> Result<Payload, Payload> + Send + 'static) {
        let mut incoming = self.incoming.lock();
        if self.is_committed.load(Ordering::Relaxed) {
            return;
        }
        let taken = incoming.take();
        drop(incoming);
        self.send_to(taken, None, Box::new(encode));
    }

    fn send(&self, slot: Option<Box<dyn ReplySlot>>, encode: Encode) {
        let incoming = self.incoming.lock().take();
        self.send_to(incoming, slot, encode);
    }

    fn send_to(
        &self,
        incoming: Option<Incoming>,
        slot: Option<Box<dyn ReplySlot>>,
        encode: Encode,
    ) {
        let incoming = incoming.map(|incoming| (incoming, self.key.clone()));
        if incoming.is_some() {
            for deadline in std::mem::take(&mut *self.deadlines.lock()) {
                deadline.abort();
            }
        }
        let audit = self.audit.get().cloned();
        if incoming.is_some() || slot.is_some() || audit.is_some() {
            let outgoing = Outgoing {
                incoming,
                slot,
                audit,
                encode,
            };
            // An error means that the daemon is stopping: the client gets no reply.
            let _ = self.replies.outgoing.send(Some(outgoing));
        }
    }
}

impl Drop for Pending {
    /// Replies `internal` if there is no reply. It is cached: the request may have been executed,
    /// and a retry must not execute it again.
    fn drop(&mut self) {
        let slot = self.slot.lock().take();
        let is_wanted = self.is_wanted();
        let has_reply = self.incoming.lock().is_none();
        // After the restart the journal is replayed, which produces the reply.
        if self.replies.is_closing.load(Ordering::Acquire) {
            return;
        }
        if !is_wanted && slot.is_none() {
            if let (false, Some(audit)) = (has_reply, self.audit.get()) {
                audit.lock().finish(audit::ABANDONED);
            }
            return;
        }
        if !has_reply {
            self.replies.dropped.fetch_add(1, Ordering::Relaxed);
        }
        let key = &self.key;
        error!(key, "a defect: a request was dropped without a result");
        let payload = Payload::json(&CommandError::Dropped.to_wire(None, &Place::default()));
        self.send(slot, Box::new(move || Err(payload)));
    }
}

impl Outgoing {
    fn send(self) {
        let Outgoing {
            incoming,
            slot,
            audit,
            encode,
        } = self;
        let reply = catch_unwind(AssertUnwindSafe(encode))
            // The command may have been executed.
            .unwrap_or_else(|_| {
                Err(Payload::json(
                    &CommandError::Dropped.to_wire(None, &Place::default()),
                ))
            });
        if let Some(slot) = slot {
            slot.write(&reply);
        }
        if let Some(ticket) = audit {
            ticket.lock().finish(&outcome(&reply));
        }
        if let Some((incoming, key)) = incoming {
            incoming.peer.reply(&key, reply);
        }
    }
}

/// The outcome of a command that got this reply.
fn outcome(reply: &Result<Payload, Payload>) -> String {
    #[derive(Deserialize)]
    struct Code {
        code: String,
    }
    match reply {
        Ok(_) => audit::OK.to_owned(),
        Err(payload) => serde_json::from_slice::<Code>(&payload.bytes)
            .map_or_else(|_| "internal".to_owned(), |error| error.code),
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::sync::mpsc::{RecvTimeoutError, TryRecvError};

    use tokio::time::{sleep, timeout};

    use super::*;
    use crate::api::incoming::fixture::{LONG, Sent, code, request};

    /// The replies to a request whose handler panics after `handler`.
    fn panic_after(sender: &Replies, handler: impl FnOnce(&Incoming)) -> Sent {
        let (incoming, replies) = request(false);
        sender.catch_panic(&incoming, || {
            handler(&incoming);
            panic!("a defect");
        });
        replies
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
    async fn a_request_whose_handler_panics_gets_one_reply() {
        let sender = Replies::start().unwrap();
        let none = panic_after(&sender, |_| {});
        let dropped = panic_after(&sender, |incoming| {
            drop(sender.responder(incoming, "key".into()));
        });
        let mut responder = None;
        let kept = panic_after(&sender, |incoming| {
            responder = Some(sender.responder(incoming, "key".into()));
        });
        responder.unwrap().complete(|| Ok(Payload::json(&1)));
        sender.stop();
        assert_eq!(code(none.recv_timeout(LONG).unwrap()), "internal");
        assert_eq!(code(dropped.recv_timeout(LONG).unwrap()), "internal");
        assert!(kept.recv_timeout(LONG).unwrap().is_ok());
        for replies in [none, dropped, kept] {
            let second = replies.recv_timeout(LONG);
            assert_eq!(second.unwrap_err(), RecvTimeoutError::Disconnected);
        }
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
        sleep(Duration::from_millis(50)).await;
        assert!(replies.try_recv().is_err());
    }

    #[tokio::test]
    async fn a_request_with_a_reply_keeps_no_deadline() {
        let sender = Replies::start().unwrap();
        let (incoming, _replies) = request(false);
        let responder = sender.responder(&incoming, "key".into());
        responder.set_deadline(LONG, CommandError::deadline, None);
        responder.complete(|| Ok(Payload::json(&1)));
        responder.set_deadline(LONG, CommandError::deadline, None);
        // The runtime drops the task of an aborted deadline when it next polls it.
        let kept = async {
            while Arc::weak_count(&responder.0) > 0 {
                sleep(Duration::from_millis(1)).await;
            }
        };
        assert!(timeout(LONG / 4, kept).await.is_ok());
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
