//! The thread `control`: passes set-points, and the beginning and the end of controllers' tokens, to swarms.
//! None of them gets a reply.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread;
use std::time::Duration;

use fail::fail_point;
use jostle_proto::keys;
use tracing::debug;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Session, Wait};

use crate::auth::live::LiveRights;
use crate::convert::commands::set_points;
use crate::swarm::handle::{Handle, Message};
use crate::swarm::output::Output;
use crate::swarm::registry::SwarmRegistry;
use crate::transport::zenoh::claims::Claims;
use crate::transport::zenoh::tokens::{self, Tokens};

/// Messages that are queued for the thread. If the queue is full, new set-points are dropped.
const MAX_QUEUED: usize = 4096;

/// The timeout of a query for another token of the same controller.
const TOKEN_QUERY_TIMEOUT: Duration = Duration::from_secs(1);

/// Starts the thread and subscribes to set-points and tokens.
pub fn listen(
    session: &Session,
    prefix: &str,
    registry: Arc<SwarmRegistry>,
    rights: Arc<LiveRights>,
    claims: Arc<Claims>,
    tokens: Tokens,
) -> zenoh::Result<[Subscriber<()>; 2]> {
    let (messages, received) = sync_channel(MAX_QUEUED);
    let reader = Reader {
        session: session.clone(),
        prefix: prefix.to_owned(),
        registry,
        rights,
        claims,
        tokens: tokens.clone(),
    };
    thread::Builder::new()
        .name("control".into())
        .spawn(move || reader.run(&received))?;
    let puts = messages.clone();
    let puts = session
        .declare_subscriber(keys::ctl(prefix, "*", "*"))
        .callback(move |sample| {
            // zenoh's access rules let no deletion through.
            if sample.kind() == SampleKind::Put {
                // A dropped set-point is replaced by the next one.
                let _ = puts.try_send(Received::SetPoints(sample));
            }
        })
        .wait()?;
    let tokens = session
        .liveliness()
        .declare_subscriber(keys::ctl_alive(prefix, "*", "*"))
        .history(true)
        .callback(move |sample| {
            // Here and not on the thread: the client may send `join` next.
            let key = sample.key_expr().as_str();
            match sample.kind() {
                SampleKind::Put => tokens.declared(key),
                SampleKind::Delete => tokens.undeclared(key),
            }
            let _ = messages.send(Received::Token(sample));
        })
        .wait()?;
    Ok([puts, tokens])
}

/// What the thread receives.
enum Received {
    SetPoints(Sample),
    /// The token of a controller was declared or undeclared.
    Token(Sample),
}

/// The time between two attempts to pass a message to a swarm whose queue is full.
const RETRY_INTERVAL: Duration = Duration::from_millis(50);

struct Reader {
    session: Session,
    prefix: String,
    registry: Arc<SwarmRegistry>,
    rights: Arc<LiveRights>,
    claims: Arc<Claims>,
    tokens: Tokens,
}

impl Reader {
    fn run(&self, all: &Receiver<Received>) {
        // For swarms whose queue was full: a controller whose loss they miss would stay for ever.
        let mut unsent: Vec<(Handle, Message)> = Vec::new();
        loop {
            let received = match unsent.is_empty() {
                true => all.recv().map_err(|_| RecvTimeoutError::Disconnected),
                false => all.recv_timeout(RETRY_INTERVAL),
            };
            let message = match received {
                Ok(Received::SetPoints(sample)) => {
                    self.put(&sample);
                    None
                }
                Ok(Received::Token(sample)) => match sample.kind() {
                    SampleKind::Put => self.declared(&sample),
                    SampleKind::Delete => self.lost(&sample),
                },
                Err(RecvTimeoutError::Timeout) => None,
                Err(RecvTimeoutError::Disconnected) => return,
            };
            unsent.extend(message.filter(|_| unsent.len() < MAX_QUEUED));
            let mut full: Vec<Arc<Output>> = Vec::new();
            for (handle, message) in std::mem::take(&mut unsent) {
                // A swarm gets its messages in order, and waits for no other swarm.
                let is_full = full.iter().any(|it| Arc::ptr_eq(it, &handle.output));
                let offered = match is_full {
                    true => Err(message),
                    false => self.offer(&handle, message),
                };
                if let Err(message) = offered {
                    full.push(handle.output.clone());
                    unsent.push((handle, message));
                }
            }
        }
    }

    /// Notifies a swarm that a controller has a token, which it may have lost before.
    fn declared(&self, sample: &Sample) -> Option<(Handle, Message)> {
        let (swarm, controller) = self.parts(sample)?;
        let message = Message::TokenDeclared(controller.to_owned());
        Some((self.registry.find(swarm)?, message))
    }

    /// Passes set-points to their swarm.
    fn put(&self, sample: &Sample) {
        let Some((swarm, controller)) = self.parts(sample) else {
            return;
        };
        let Some(handle) = self.registry.find(swarm) else {
            return;
        };
        let token = sample.attachment().map(ZBytes::to_bytes);
        if !self.rights.permits_set_points(controller, token.as_deref()) {
            debug!(swarm, controller, "set-points not permitted");
            // Counted as rejected, so that `get/controllers` shows it.
            return handle.send(Message::Put(controller.to_owned(), None, None));
        }
        let is_cbor = *sample.encoding() == Encoding::APPLICATION_CBOR;
        let read = set_points::read(controller, &sample.payload().to_bytes(), is_cbor);
        let (epoch, put) = match read {
            Ok((epoch, put)) => (epoch, Some(put)),
            Err(problem) => {
                debug!(swarm, controller, problem, "invalid set-points");
                (None, None)
            }
        };
        // If another daemon serves the name, the set-point may be for that daemon's swarm.
        if self.claims.serves(swarm) {
            handle.send(Message::Put(controller.to_owned(), epoch, put));
        }
    }

    /// Notifies a swarm that a controller is gone, unless another session holds its token: the
    /// controller has reconnected before zenoh noticed that its first connection was closed.
    fn lost(&self, sample: &Sample) -> Option<(Handle, Message)> {
        let (swarm, controller) = self.parts(sample)?;
        let is_held = self.tokens.query(sample.key_expr().as_str(), || {
            let tokens = self.session.liveliness().get(sample.key_expr());
            let tokens = tokens.timeout(TOKEN_QUERY_TIMEOUT).wait();
            let is_held = tokens.is_ok_and(|all| all.into_iter().any(|it| it.result().is_ok()));
            fail_point!("token-queried");
            is_held
        });
        // If it was declared or undeclared meanwhile, the sample about that is next.
        if is_held != Some(false) {
            return None;
        }
        let message = Message::TokenLost(controller.to_owned());
        Some((self.registry.find(swarm)?, message))
    }

    /// Queues a message, and returns it if the queue of its swarm is full.
    #[expect(clippy::result_large_err, reason = "the caller offers it again")]
    fn offer(&self, handle: &Handle, message: Message) -> Result<(), Message> {
        let Message::TokenLost(controller) = &message else {
            return handle.offer(message);
        };
        // If the controller has declared its token since, it may have joined again, and is not lost.
        let key = keys::ctl_alive(&self.prefix, &handle.output.name, controller);
        let offered = self.tokens.unless_held(&key, || handle.offer(message));
        offered.unwrap_or(Ok(()))
    }

    /// The swarm and the controller in a sample's key; `None` if it contains a wildcard.
    fn parts<'a>(&self, sample: &'a Sample) -> Option<(&'a str, &'a str)> {
        let key = sample.key_expr().as_str().strip_prefix(&self.prefix)?;
        tokens::parts(key.strip_prefix('/')?)
    }
}
