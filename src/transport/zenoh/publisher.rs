//! Publishes the newest state of every swarm, its order and its events.
//!
//! One thread takes what each outlet holds in turn. Congestion drops samples and never blocks:
//! a stopped reader costs nobody else anything.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use jostle_proto::{CBOR, JSON, keys};
use tracing::warn;
use zenoh::pubsub::Publisher;
use zenoh::qos::CongestionControl;
use zenoh::{Session, Wait};
use zenoh_ext::{AdvancedPublisher, AdvancedPublisherBuilderExt, CacheConfig, MissDetectionConfig};

use crate::convert::error::refusal;
use crate::convert::{self, Payload};
use crate::metrics::Pulse;
use crate::swarm::frame::Frame;
use crate::swarm::outcome::DeferredReply;
use crate::swarm::outlet::Outlet;
use crate::transport::zenoh::messages::DispatchMessage;
use crate::transport::zenoh::session_pool::Lease;

use crate::transport::zenoh::publish_schedule::{MOST_GATHERED, Turns};

/// Events a late joiner still gets from the publisher's own cache.
const EVENTS_CACHED: usize = 64;

/// How often the number of the last event is told, so that a reader notices that it missed it.
const HEARTBEAT: Duration = Duration::from_secs(2);

/// How long the frames of one swarm are published one after the other while others wait: twice as
/// long as they are gathered at most. Of those left then, the newest.
const MOST_AT_ONCE: Duration = MOST_GATHERED.saturating_mul(2);

/// The publishers of one swarm.
pub struct Publication {
    outlet: Arc<Outlet>,
    /// Whether the outlet's frames and events are discarded instead of published.
    is_silent: AtomicBool,
    publishers: Publishers,
    _lease: Lease,
}

struct Publishers {
    state: Watched,
    order: Watched,
    event: AdvancedPublisher<'static>,
}

/// A publisher that knows whether anyone reads: asking zenoh takes longer than a step.
struct Watched {
    publisher: Publisher<'static>,
    is_read: Arc<AtomicBool>,
}

impl Publishers {
    fn declare(session: &Session, prefix: &str, swarm: &str) -> zenoh::Result<Self> {
        let publisher = |key: String, encoding: &'static str| {
            let publisher = session
                .declare_publisher(key)
                .congestion_control(CongestionControl::Drop)
                .encoding(encoding)
                .wait()?;
            Watched::new(publisher)
        };
        Ok(Publishers {
            state: publisher(keys::state(prefix, swarm), CBOR)?,
            order: publisher(keys::order(prefix, swarm), JSON)?,
            event: session
                .declare_publisher(keys::event(prefix, swarm))
                .congestion_control(CongestionControl::Drop)
                .encoding(JSON)
                .advanced()
                .cache(CacheConfig::default().max_samples(EVENTS_CACHED))
                .sample_miss_detection(MissDetectionConfig::default().heartbeat(HEARTBEAT))
                .wait()?,
        })
    }
}

/// Where swarms ring, and the publications there are.
pub struct Press {
    prefix: String,
    publications: Mutex<BTreeMap<String, Arc<Publication>>>,
    bells: Sender<Bell>,
    dispatcher: SyncSender<DispatchMessage>,
    /// Whether its thread is at work.
    pub pulse: Arc<Pulse>,
}

enum Bell {
    Ring(String),
    Close(String, DeferredReply),
    Stop,
}

impl Press {
    /// Starts the publishing thread.
    ///
    /// # Errors
    ///
    /// When no thread can be started.
    pub fn start(
        prefix: &str,
        dispatcher: SyncSender<DispatchMessage>,
    ) -> std::io::Result<(Arc<Self>, thread::JoinHandle<()>)> {
        let (bells, rung) = channel();
        let press = Arc::new(Press {
            prefix: prefix.to_owned(),
            publications: Mutex::default(),
            bells,
            dispatcher,
            pulse: Arc::default(),
        });
        let thread = thread::Builder::new().name("publish".into()).spawn({
            let press = press.clone();
            move || press.run(&rung)
        })?;
        Ok((press, thread))
    }

    /// Says that a swarm's outlet holds something.
    pub fn ring(&self, swarm: &str) {
        // After the thread has ended there is nothing left to publish to.
        let _ = self.bells.send(Bell::Ring(swarm.to_owned()));
    }

    /// Ends the publishing thread.
    pub fn stop(&self) {
        let _ = self.bells.send(Bell::Stop);
    }

    /// Begins to publish a swarm by a leased session.
    ///
    /// # Errors
    ///
    /// When zenoh refuses the publishers.
    pub fn open(&self, lease: Lease, swarm: &str, outlet: Arc<Outlet>) -> zenoh::Result<()> {
        let publishers = Publishers::declare(&lease, &self.prefix, swarm)?;
        let publication = Arc::new(Publication {
            outlet,
            is_silent: AtomicBool::new(false),
            publishers,
            _lease: lease,
        });
        self.lock().insert(swarm.to_owned(), publication);
        // What was put there before is still to be published.
        self.ring(swarm);
        Ok(())
    }

    /// Stops or resumes publishing a swarm whose name another daemon also holds.
    pub fn silence(&self, swarm: &str, is_silent: bool) {
        if let Some(publication) = self.find(swarm) {
            publication.is_silent.store(is_silent, Ordering::Relaxed);
        }
    }

    /// Publishes what is left of a swarm, and nothing after it. The dispatcher then receives
    /// [`DispatchMessage::Closed`].
    pub fn close(&self, swarm: &str, reply: DeferredReply) {
        let close = Bell::Close(swarm.to_owned(), reply);
        if let Err(error) = self.bells.send(close)
            && let Bell::Close(_, reply) = error.0
        {
            // The daemon is stopping.
            reply.send();
        }
    }

    /// A swarm's publication.
    pub fn find(&self, swarm: &str) -> Option<Arc<Publication>> {
        self.lock().get(swarm).cloned()
    }

    /// Whether anyone reads a swarm's states or order; of a swarm that does not move, who came this
    /// moment too.
    pub fn is_watched(&self, swarm: &str, is_moving: bool) -> bool {
        self.find(swarm)
            .is_some_and(|publication| publication.is_watched(is_moving))
    }

    fn run(&self, rung: &Receiver<Bell>) {
        let mut turns = Turns::default();
        loop {
            let bell = match turns.until_next(Instant::now()) {
                None => rung.recv().map_err(RecvTimeoutError::from),
                // Whose turn it is does not wait until nobody rings.
                Some(Duration::ZERO) => Err(RecvTimeoutError::Timeout),
                Some(wait) => rung.recv_timeout(wait),
            };
            self.pulse.beat();
            let began = Instant::now();
            let swarm = match bell {
                Ok(Bell::Ring(swarm)) => turns.ring(swarm, began),
                Ok(Bell::Close(swarm, reply)) => {
                    let publication = self.lock().remove(&swarm);
                    if let Some(publication) = publication {
                        publication.publish(&swarm);
                    }
                    turns.forget(&swarm);
                    let closed = DispatchMessage::Closed(swarm, reply);
                    // An error means that the daemon is stopping.
                    let _ = self.dispatcher.send(closed);
                    None
                }
                Err(RecvTimeoutError::Timeout) => turns.next(),
                Ok(Bell::Stop) | Err(RecvTimeoutError::Disconnected) => {
                    while let Some(swarm) = turns.next() {
                        self.publish(&swarm);
                    }
                    return self.pulse.rest();
                }
            };
            if let Some(swarm) = swarm
                && self.publish(&swarm)
            {
                turns.published(swarm, began, Instant::now());
            }
            self.pulse.rest();
        }
    }

    /// Publishes what a swarm's outlet holds, and says whether there is such a swarm.
    fn publish(&self, swarm: &str) -> bool {
        let publication = self.find(swarm);
        publication.inspect(|it| it.publish(swarm)).is_some()
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, BTreeMap<String, Arc<Publication>>> {
        self.publications
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }
}

impl Publication {
    fn is_watched(&self, is_moving: bool) -> bool {
        let Publishers { state, order, .. } = &self.publishers;
        state.is_known_to_be_read()
            || order.is_known_to_be_read()
            || (!is_moving && (state.is_read() || order.is_read()))
    }

    fn publish(&self, swarm: &str) {
        let publishers = &self.publishers;
        let (mut frames, events) = self.outlet.take();
        if self.is_silent.load(Ordering::Relaxed) {
            return;
        }
        for event in events {
            let Payload { bytes, .. } = Payload::json(&convert::event(swarm, event, refusal));
            report(swarm, publishers.event.put(bytes).wait());
        }
        let began = Instant::now();
        while let Some(frame) = frames.pop_front() {
            self.publish_frame(swarm, publishers, &frame);
            if frames.len() > 1 && began.elapsed() > MOST_AT_ONCE {
                let newest = frames.split_off(frames.len() - 1);
                self.outlet.passed_over(frames.len() as u64);
                frames = newest;
            }
        }
    }

    /// Publishes a state and its order, each only if someone listens.
    fn publish_frame(&self, swarm: &str, publishers: &Publishers, frame: &Frame) {
        let number = self.outlet.count_published();
        let is_moving = frame.place.phase.is_moving();
        let is_read = |publisher: &Watched| match is_moving {
            true => publisher.is_known_to_be_read(),
            false => publisher.is_read(),
        };
        if is_read(&publishers.state) {
            let bytes = convert::state(swarm, frame, number).to_cbor();
            report(swarm, publishers.state.publisher.put(bytes).wait());
        }
        if is_read(&publishers.order) {
            let Payload { bytes, .. } = Payload::json(&convert::order_sample(swarm, frame, number));
            report(swarm, publishers.order.publisher.put(bytes).wait());
        }
    }
}

impl Watched {
    fn new(publisher: Publisher<'static>) -> zenoh::Result<Self> {
        let is_read = Arc::new(AtomicBool::new(false));
        let told = is_read.clone();
        let listener = publisher
            .matching_listener()
            .callback(move |status| told.store(status.matching(), Ordering::Relaxed));
        listener.background().wait()?;
        Ok(Watched { publisher, is_read })
    }

    /// Whether zenoh has told that anyone reads, which it does a moment after they came.
    fn is_known_to_be_read(&self) -> bool {
        self.is_read.load(Ordering::Relaxed)
    }

    /// Whether anyone reads who came before whatever was asked for last.
    fn is_read(&self) -> bool {
        self.is_known_to_be_read()
            || self
                .publisher
                .matching_status()
                .wait()
                .is_ok_and(|status| status.matching())
    }
}

fn report(swarm: &str, put: zenoh::Result<()>) {
    if let Err(error) = put {
        warn!(swarm, %error, "failed to publish");
    }
}
