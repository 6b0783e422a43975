//! The thread `control`: passes set-points and the end of controllers' tokens to swarms. Neither gets
//! a reply.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread;
use std::time::Duration;

use jostle_proto::keys;
use tracing::debug;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Session, Wait};

use crate::auth::live::LiveRights;
use crate::convert::commands::set_points;
use crate::swarm::handle::Message;
use crate::swarm::registry::SwarmRegistry;
use crate::transport::zenoh::claims::Claims;

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
) -> zenoh::Result<[Subscriber<()>; 2]> {
    let (messages, received) = sync_channel(MAX_QUEUED);
    let reader = Reader {
        session: session.clone(),
        prefix: format!("{prefix}/"),
        registry,
        rights,
        claims,
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
                let _ = puts.try_send(sample);
            }
        })
        .wait()?;
    let tokens = session
        .liveliness()
        .declare_subscriber(keys::ctl_alive(prefix, "*", "*"))
        .callback(move |sample| {
            if sample.kind() == SampleKind::Delete {
                let _ = messages.send(sample);
            }
        })
        .wait()?;
    Ok([puts, tokens])
}

struct Reader {
    session: Session,
    prefix: String,
    registry: Arc<SwarmRegistry>,
    rights: Arc<LiveRights>,
    claims: Arc<Claims>,
}

impl Reader {
    fn run(&self, samples: &Receiver<Sample>) {
        while let Ok(sample) = samples.recv() {
            match sample.kind() {
                SampleKind::Put => self.put(&sample),
                // The token of a controller was undeclared.
                SampleKind::Delete => self.lost(&sample),
            }
        }
    }

    /// Passes set-points to their swarm.
    fn put(&self, sample: &Sample) {
        let Some((swarm, controller)) = parts(&self.prefix, sample) else {
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
    fn lost(&self, sample: &Sample) {
        let Some((swarm, controller)) = parts(&self.prefix, sample) else {
            return;
        };
        let tokens = self.session.liveliness().get(sample.key_expr());
        let is_held = tokens
            .timeout(TOKEN_QUERY_TIMEOUT)
            .wait()
            .is_ok_and(|tokens| tokens.into_iter().any(|token| token.result().is_ok()));
        if !is_held && let Some(handle) = self.registry.find(swarm) {
            handle.send(Message::Lost(controller.to_owned()));
        }
    }
}

/// The swarm and the controller in a sample's key; `None` if it contains a wildcard.
fn parts<'a>(prefix: &str, sample: &'a Sample) -> Option<(&'a str, &'a str)> {
    let key = sample.key_expr().as_str().strip_prefix(prefix)?;
    let (swarm, rest) = key.split_once("/ctl/")?;
    let controller = rest.split('/').next()?;
    (keys::is_name(swarm) && keys::is_name(controller)).then_some((swarm, controller))
}
