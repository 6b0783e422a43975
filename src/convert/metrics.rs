//! Metrics of the daemon.

use jostle_proto as proto;

use crate::convert::states::phase;
use crate::health::metrics::{DaemonMetrics, PerSwarmMetrics};

pub fn metrics(current: &DaemonMetrics) -> proto::Metrics {
    let DaemonMetrics { totals, store, .. } = current;
    proto::Metrics {
        uptime_secs: current.uptime_secs,
        unwell: current.reasons.iter().map(ToString::to_string).collect(),
        warnings: current.warnings.iter().map(ToString::to_string).collect(),
        cpu_secs: current.cpu_secs,
        cores: current.cores as u64,
        memory_bytes: current.resident_bytes,
        sessions: current.sessions as u64,
        steps: totals.step_time.count(),
        step_secs: totals.step_time.secs(),
        faults: totals.faults,
        degraded: totals.degraded,
        residual_max: totals.residual_max,
        frames: totals.frames,
        frames_dropped: totals.frames_dropped,
        contested: current.contested as u64,
        store: proto::StoreMetrics {
            commits: store.commits,
            commit_secs: store.total_commit_secs,
            last_commit_secs: store.last_commit_secs,
            waiting: store.waiting as u64,
            disk_bytes: store.bytes_on_disk,
            full: store.is_full,
            failing: store.is_failing,
            overrun: store.is_overrun,
        },
        recordings: proto::RecordingMetrics {
            recording: current.recordings.recording,
            ended: current.recordings.ended,
            failed: current.recordings.failed.len() as u64,
        },
        recordings_bytes: current.recordings_bytes.0,
        recordings_quota_bytes: current.recordings_bytes.1,
        experiments_bytes: Some(current.experiments.used),
        experiments_quota_bytes: current.experiments.quota,
        swarms: current.swarms.iter().map(swarm).collect(),
    }
}

fn swarm(current: &PerSwarmMetrics) -> proto::SwarmMetrics {
    let (summary, totals) = (&current.summary, &current.totals);
    proto::SwarmMetrics {
        swarm: current.name.clone(),
        phase: phase(&summary.stamp.phase),
        step: summary.stamp.step,
        n: summary.n as u64,
        rate: summary.rate,
        real_time_factor: summary.real_time_factor,
        steps: totals.step_time.count(),
        step_secs: totals.step_time.secs(),
        due_steps: totals.lateness.count(),
        late_secs: totals.lateness.secs(),
        contacts: current.last.contacts,
        residual: current.last.residual,
        degraded: totals.degraded,
        faults: totals.faults,
    }
}
