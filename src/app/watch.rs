//! What the health checks read.

use std::sync::Arc;

use zenoh::{Session, Wait};

use crate::api::commands;
use crate::api::responder::Replies;
use crate::auth::live::LiveRights;
use crate::health::Watched;
use crate::metrics::Activity;
use crate::recording::Recordings;
use crate::store::Store;
use crate::swarm::registry::SwarmRegistry;
use crate::transport::zenoh::bus_watch::BusWatch;
use crate::transport::zenoh::claims::{Claims, Contest};

/// The parts of the daemon that the health checks read.
pub struct Sources {
    /// The zenoh endpoints and the HTTP address, which are probed.
    pub endpoints: Vec<String>,
    /// The threads that must not be blocked.
    pub threads: Vec<(&'static str, Arc<Activity>)>,
    pub host: Arc<SwarmRegistry>,
    pub store: Store,
    pub session: Session,
    pub bus: Arc<BusWatch>,
    pub claims: Arc<Claims>,
    pub rights: Arc<LiveRights>,
    pub recordings: Recordings,
    pub replies: Replies,
}

impl Sources {
    /// Converts them to what the health checks call.
    pub fn watched(self) -> Watched {
        let Sources {
            endpoints,
            threads,
            host,
            store,
            session,
            bus,
            claims,
            rights,
            recordings,
            replies,
        } = self;
        let usage_of = recordings.clone();
        let live = rights.clone();
        Watched {
            host,
            store,
            threads,
            endpoints,
            sessions: Box::new(move || session.info().transports().wait().count()),
            bus: Box::new(move || bus.report()),
            contested: Box::new(move || {
                let contests = claims.contests();
                contests.iter().map(Contest::for_health).collect()
            }),
            certificate_ended: Box::new(move || live.current().ended()),
            are_people_unreadable: Box::new(move || rights.problem().is_some()),
            recordings: Box::new(move || commands::count(&recordings)),
            recordings_bytes: Box::new(move || {
                let usage = usage_of.usage();
                (usage.bytes, usage.quota_bytes)
            }),
            dropped_requests: Box::new(move || replies.dropped()),
        }
    }
}
