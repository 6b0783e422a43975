//! The thread `progress`: publishes the progress of experiments.

use std::collections::BTreeMap;
use std::thread;
use std::time::Duration;

use jostle_proto::{JSON, keys};
use tracing::warn;
use zenoh::qos::CongestionControl;
use zenoh::{Session, Wait};

use crate::convert::{self, Payload};
use crate::experiments::{ExperimentManager, Report};

/// The least time between two publications of the progress of one experiment.
const MIN_INTERVAL: Duration = Duration::from_millis(500);

/// Starts the thread. It publishes the progress of an experiment when it changes, until `lab` is
/// closed.
pub fn publish(
    lab: ExperimentManager,
    session: Session,
    prefix: String,
    node: String,
) -> std::io::Result<()> {
    let work = move || {
        let (mut seen, mut published) = (0, BTreeMap::new());
        while let Some(newest) = lab.wait_for_change(seen) {
            seen = newest;
            let now: BTreeMap<String, Report> = lab
                .reports()
                .into_iter()
                .map(|report| (report.name.clone(), report))
                .collect();
            for (name, report) in &now {
                if published.get(name) == Some(report) {
                    continue;
                }
                let key = keys::experiment(&prefix, &node, name, "progress");
                let Payload { bytes, .. } = Payload::json(&convert::progress(report.clone()));
                let put = session.put(key, bytes).encoding(JSON);
                let put = put.congestion_control(CongestionControl::Drop);
                if let Err(error) = put.wait() {
                    warn!(experiment = name, %error, "failed to publish");
                }
            }
            published = now;
            thread::sleep(MIN_INTERVAL);
        }
    };
    let thread = thread::Builder::new().name("progress".into());
    thread.spawn(work).map(drop)
}
