//! What controllers send that nobody answers: set-points, and the end of their tokens.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

use jostle_proto::keys;
use tracing::debug;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Session, Wait};

use crate::auth::live::LiveRights;
use crate::convert::commands::control;
use crate::swarm::handle::Message;
use crate::swarm::registry::SwarmRegistry;
use crate::transport::zenoh::claims::Claims;

/// What may wait to be read; beyond that the newest are dropped, as on any link that is full.
const MOST: usize = 4096;

/// How long a look takes at most for another token of the same controller.
const PATIENCE_WITH_TOKENS: Duration = Duration::from_secs(1);

/// Something that a controller sent.
enum Sent {
    /// Set-points.
    Put(Sample),
    /// The end of a token.
    Gone(Sample),
}

/// Listens to controllers.
///
/// # Errors
///
/// When zenoh refuses the keys.
pub fn listen(
    session: &Session,
    prefix: &str,
    host: Arc<SwarmRegistry>,
    rights: Arc<LiveRights>,
    claims: Arc<Claims>,
) -> zenoh::Result<[Subscriber<()>; 2]> {
    let (sent, to_read) = sync_channel(MOST);
    let reader = Reader {
        session: session.clone(),
        prefix: format!("{prefix}/"),
        host,
        rights,
        claims,
    };
    thread::Builder::new()
        .name("control".into())
        .spawn(move || reader.run(&to_read))?;
    let puts: SyncSender<Sent> = sent.clone();
    let puts = session
        .declare_subscriber(keys::ctl(prefix, "*", "*"))
        .callback(move |sample| {
            // What finds no room is dropped; the next one says the same anew.
            let _ = puts.try_send(Sent::Put(sample));
        })
        .wait()?;
    let tokens = session
        .liveliness()
        .declare_subscriber(keys::ctl_alive(prefix, "*", "*"))
        .callback(move |sample| {
            if sample.kind() == SampleKind::Delete {
                let _ = sent.send(Sent::Gone(sample));
            }
        })
        .wait()?;
    Ok([puts, tokens])
}

struct Reader {
    session: Session,
    prefix: String,
    host: Arc<SwarmRegistry>,
    rights: Arc<LiveRights>,
    claims: Arc<Claims>,
}

impl Reader {
    fn run(&self, sent: &Receiver<Sent>) {
        while let Ok(sent) = sent.recv() {
            match sent {
                Sent::Put(sample) => self.put(&sample),
                Sent::Gone(sample) => self.gone(&sample),
            }
        }
    }

    /// Hands set-points to their swarm.
    fn put(&self, sample: &Sample) {
        let Some((swarm, controller)) = self.whose(sample) else {
            return;
        };
        let Some(handle) = self.host.find(swarm) else {
            return;
        };
        let token = sample.attachment().map(ZBytes::to_bytes);
        if !self.rights.permits_set_points(controller, token.as_deref()) {
            debug!(swarm, controller, "set-points not permitted");
            // Counted as rejected, so that `get/controllers` shows it.
            return handle.send(Message::Put(controller.to_owned(), None, None));
        }
        let is_cbor = *sample.encoding() == Encoding::APPLICATION_CBOR;
        let read = match sample.kind() {
            SampleKind::Put => control::read(controller, &sample.payload().to_bytes(), is_cbor),
            SampleKind::Delete => return,
        };
        let (epoch, put) = match read {
            Ok((epoch, put)) => (epoch, Some(put)),
            Err(problem) => {
                debug!(swarm, controller, problem, "refused set-points");
                (None, None)
            }
        };
        // If another daemon serves the name, the set-point may be for that daemon's swarm.
        if self.claims.serves(swarm) {
            handle.send(Message::Put(controller.to_owned(), epoch, put));
        }
    }

    /// Tells a swarm that a controller is gone, unless another session holds its token: one that
    /// came back, whose link was noticed to be cut only now.
    fn gone(&self, sample: &Sample) {
        let Some((swarm, controller)) = self.whose(sample) else {
            return;
        };
        let tokens = self.session.liveliness().get(sample.key_expr());
        let is_held = tokens
            .timeout(PATIENCE_WITH_TOKENS)
            .wait()
            .is_ok_and(|tokens| tokens.into_iter().any(|token| token.result().is_ok()));
        if !is_held && let Some(handle) = self.host.find(swarm) {
            handle.send(Message::Lost(controller.to_owned()));
        }
    }

    /// The swarm and the controller that a key names; none if it is a wildcard.
    fn whose<'a>(&self, sample: &'a Sample) -> Option<(&'a str, &'a str)> {
        let key = sample.key_expr().as_str().strip_prefix(&self.prefix)?;
        let (swarm, rest) = key.split_once("/ctl/")?;
        let controller = rest.split('/').next()?;
        (keys::is_name(swarm) && keys::is_name(controller)).then_some((swarm, controller))
    }
}
