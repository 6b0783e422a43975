//! Publishes the states, the order samples and the events of every swarm; `src/swarm/output.rs` has
//! the queue and rate of each topic.
//!
//! In addition, zenoh drops a sample of any topic for a subscriber whose connection is congested, so
//! that a stopped subscriber delays no other. A subscriber detects missing events by their numbers, and
//! fetches them from the cache of this publisher or with `get/events`.
//!
//! The thread `publish` takes the contents of one queue after the other. A swarm notifies it through
//! an unbounded channel, but only when its queue was empty before: the channel stays short.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel};
use std::thread;
use std::time::{Duration, Instant, SystemTime};

use jostle_proto::{CBOR, JSON, keys};
use parking_lot::Mutex;
use tracing::warn;
use zenoh::pubsub::Publisher as ZenohPublisher;
use zenoh::qos::CongestionControl;
use zenoh::{Session, Wait};
use zenoh_ext::{AdvancedPublisher, AdvancedPublisherBuilderExt, CacheConfig, MissDetectionConfig};

use crate::convert::{self, Payload};
use crate::metrics::Activity;
use crate::swarm::frame::Frame;
use crate::swarm::handle::DeferredReply;
use crate::swarm::output::{Output, Publish};
use crate::transport::zenoh::messages::DispatchMessage;
use crate::transport::zenoh::publish_schedule::{MAX_BATCH_WINDOW, PublishScheduler};
use crate::transport::zenoh::session_pool::Lease;

/// The newest events that zenoh caches for late subscribers.
const MAX_CACHED_EVENTS: usize = 64;

/// How often the number of the last event is published, so that a subscriber notices that it missed it.
const HEARTBEAT_INTERVAL: Duration = Duration::from_secs(2);

/// How long the queued frames of one swarm are published while other swarms wait: twice the longest
/// batching window. After that only the newest frame is.
const MAX_BURST: Duration = MAX_BATCH_WINDOW.saturating_mul(2);

/// The publishers of one swarm.
pub struct Publication {
    output: Arc<Output>,
    messages: Sender<PublishMessage>,
    /// Whether frames and events are discarded instead of published.
    is_muted: AtomicBool,
    state: MatchedPublisher,
    order: MatchedPublisher,
    event: AdvancedPublisher<'static>,
    _lease: Lease,
}

/// A publisher with its last known matching status: a query of the status takes longer than a step.
struct MatchedPublisher {
    publisher: ZenohPublisher<'static>,
    is_matched: Arc<AtomicBool>,
}

/// Publishes every swarm, on a thread of its own.
pub struct Publisher {
    prefix: String,
    publications: Mutex<BTreeMap<String, Arc<Publication>>>,
    messages: Sender<PublishMessage>,
    dispatcher: SyncSender<DispatchMessage>,
    /// Whether the thread is working.
    pub activity: Arc<Activity>,
}

enum PublishMessage {
    /// The output of this swarm is no longer empty.
    Notify(String),
    /// Publish the rest of this swarm, then remove it and notify the dispatcher.
    Close(String, DeferredReply),
    Stop,
}

impl Publisher {
    /// Starts the thread.
    pub fn start(
        prefix: &str,
        dispatcher: SyncSender<DispatchMessage>,
    ) -> std::io::Result<Arc<Self>> {
        let (messages, received) = channel();
        let publisher = Arc::new(Publisher {
            prefix: prefix.to_owned(),
            publications: Mutex::default(),
            messages,
            dispatcher,
            activity: Arc::default(),
        });
        thread::Builder::new().name("publish".into()).spawn({
            let publisher = publisher.clone();
            move || publisher.run(&received)
        })?;
        Ok(publisher)
    }

    /// Publishes every delayed swarm, then ends the thread.
    pub fn stop(&self) {
        let _ = self.messages.send(PublishMessage::Stop);
    }

    /// Begins to publish a swarm in a leased session.
    pub fn open(&self, lease: Lease, output: &Arc<Output>) -> zenoh::Result<()> {
        let (prefix, swarm) = (&self.prefix, &output.name);
        let event = lease
            .declare_publisher(keys::event(prefix, swarm))
            .congestion_control(CongestionControl::Drop)
            .encoding(JSON)
            .advanced()
            .cache(CacheConfig::default().max_samples(MAX_CACHED_EVENTS))
            .sample_miss_detection(MissDetectionConfig::default().heartbeat(HEARTBEAT_INTERVAL));
        let publication = Arc::new(Publication {
            messages: self.messages.clone(),
            is_muted: AtomicBool::new(false),
            state: MatchedPublisher::declare(&lease, keys::state(prefix, swarm), CBOR)?,
            order: MatchedPublisher::declare(&lease, keys::order(prefix, swarm), JSON)?,
            event: event.wait()?,
            output: output.clone(),
            _lease: lease,
        });
        self.publications
            .lock()
            .insert(swarm.clone(), publication.clone());
        output.set_publisher(&publication);
        Ok(())
    }

    /// Stops or resumes publishing a swarm whose name another daemon also holds. Returns false if the
    /// swarm is not open.
    pub fn mute(&self, swarm: &str, is_muted: bool) -> bool {
        let mute = |it: &Arc<Publication>| it.is_muted.store(is_muted, Ordering::Relaxed);
        self.find(swarm).inspect(mute).is_some()
    }

    /// Publishes the rest of a swarm and removes it. The dispatcher then receives
    /// [`DispatchMessage::Closed`].
    pub fn close(&self, swarm: &str, reply: DeferredReply) {
        let close = PublishMessage::Close(swarm.to_owned(), reply);
        if let Err(error) = self.messages.send(close)
            && let PublishMessage::Close(_, reply) = error.0
        {
            // The daemon is stopping.
            reply.send();
        }
    }

    fn run(&self, messages: &Receiver<PublishMessage>) {
        let mut scheduler = PublishScheduler::default();
        loop {
            let message = match scheduler.until_next(Instant::now()) {
                None => messages.recv().map_err(RecvTimeoutError::from),
                // A swarm that is due does not wait until the channel is empty.
                Some(Duration::ZERO) => Err(RecvTimeoutError::Timeout),
                Some(wait) => messages.recv_timeout(wait),
            };
            self.activity.begin();
            let began = Instant::now();
            let swarm = match message {
                Ok(PublishMessage::Notify(swarm)) => scheduler.notify(swarm, began),
                Ok(PublishMessage::Close(swarm, reply)) => {
                    let publication = self.publications.lock().remove(&swarm);
                    if let Some(publication) = publication {
                        publication.publish();
                    }
                    scheduler.remove(&swarm);
                    let closed = DispatchMessage::Closed(swarm, reply);
                    // An error means that the daemon is stopping.
                    let _ = self.dispatcher.send(closed);
                    None
                }
                Err(RecvTimeoutError::Timeout) => scheduler.pop(),
                Ok(PublishMessage::Stop) | Err(RecvTimeoutError::Disconnected) => {
                    while let Some(swarm) = scheduler.pop() {
                        self.publish(&swarm);
                    }
                    return self.activity.end();
                }
            };
            if let Some(swarm) = swarm
                && self.publish(&swarm)
            {
                scheduler.published(swarm, began, Instant::now());
            }
            self.activity.end();
        }
    }

    /// Publishes what a swarm has queued. Returns false if the swarm is not published.
    fn publish(&self, swarm: &str) -> bool {
        self.find(swarm).inspect(|it| it.publish()).is_some()
    }

    fn find(&self, swarm: &str) -> Option<Arc<Publication>> {
        self.publications.lock().get(swarm).cloned()
    }
}

impl Publish for Publication {
    fn notify(&self) {
        let notify = PublishMessage::Notify(self.output.name.clone());
        // An error means that the daemon is stopping.
        let _ = self.messages.send(notify);
    }

    /// Called for each frame. A flag alone, set by zenoh's matching status, was tried: the status
    /// arrives a moment after the subscription, so that either the first frame of a paused swarm came
    /// late, or each exchange made a frame, with or without a subscriber.
    fn is_watched(&self, is_moving: bool) -> bool {
        let publishers = [&self.state, &self.order];
        let is_matched = |is_moving| publishers.iter().any(|it| it.is_matched(is_moving));
        // The last known status of both is checked before either is queried.
        is_matched(true) || (!is_moving && is_matched(false))
    }
}

impl Publication {
    fn publish(&self) {
        let (mut frames, events) = self.output.to_publish.take();
        if self.is_muted.load(Ordering::Relaxed) {
            return;
        }
        let swarm = &self.output.name;
        for event in events {
            let Payload { bytes, .. } = Payload::json(&convert::event(swarm, event));
            report(swarm, self.event.put(bytes).wait());
        }
        let began = Instant::now();
        while let Some(frame) = frames.pop_front() {
            self.publish_frame(&frame);
            if frames.len() > 1 && began.elapsed() > MAX_BURST {
                let newest = frames.len() - 1;
                frames.drain(..newest);
                self.output.to_publish.count_dropped(newest as u64);
            }
        }
    }

    /// Publishes a state and an order sample, each only if it has a subscriber.
    fn publish_frame(&self, frame: &Frame) {
        let (swarm, number) = (&self.output.name, self.output.count_published());
        let is_moving = frame.stamp.phase.is_moving();
        if self.state.is_matched(is_moving) {
            let bytes = convert::state(swarm, frame, number).to_cbor();
            // After the state is encoded, which takes longest.
            let attachment = convert::attachment(frame, Some(SystemTime::now())).to_cbor();
            let put = self.state.publisher.put(bytes).attachment(attachment);
            report(swarm, put.wait());
        }
        if self.order.is_matched(is_moving) {
            let Payload { bytes, .. } = Payload::json(&convert::order_sample(swarm, frame, number));
            report(swarm, self.order.publisher.put(bytes).wait());
        }
    }
}

impl MatchedPublisher {
    fn declare(session: &Session, key: String, encoding: &'static str) -> zenoh::Result<Self> {
        let publisher = session
            .declare_publisher(key)
            .congestion_control(CongestionControl::Drop)
            .encoding(encoding)
            .wait()?;
        let is_matched = Arc::new(AtomicBool::new(false));
        let status = is_matched.clone();
        let listener = publisher
            .matching_listener()
            .callback(move |matching| status.store(matching.matching(), Ordering::Relaxed));
        listener.background().wait()?;
        Ok(MatchedPublisher {
            publisher,
            is_matched,
        })
    }

    /// Whether zenoh has reported a subscriber, which it does a moment after the declaration. Unless
    /// the swarm moves, a subscriber that was declared just before the last request counts, too.
    fn is_matched(&self, is_moving: bool) -> bool {
        let is_known = self.is_matched.load(Ordering::Relaxed);
        let asks = || self.publisher.matching_status().wait();
        is_known || (!is_moving && asks().is_ok_and(|status| status.matching()))
    }
}

fn report(swarm: &str, put: zenoh::Result<()>) {
    if let Err(error) = put {
        warn!(swarm, %error, "failed to publish");
    }
}
