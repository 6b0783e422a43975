//! Metrics of the daemon.

use jostle_proto as proto;

use crate::convert::states::phase;
use crate::health::metrics::{Figures, SwarmFigures};

pub fn metrics(figures: &Figures) -> proto::Metrics {
    let Figures { totals, store, .. } = figures;
    proto::Metrics {
        uptime_secs: figures.uptime_secs,
        unwell: figures.reasons.iter().map(ToString::to_string).collect(),
        warnings: figures.warnings.iter().map(ToString::to_string).collect(),
        cpu_secs: figures.cpu_secs,
        cores: figures.cores as u64,
        memory_bytes: figures.resident_bytes,
        sessions: figures.sessions as u64,
        steps: totals.step_time.count(),
        step_secs: totals.step_time.secs(),
        faults: totals.faults,
        degraded: totals.degraded,
        residual_max: totals.residual_max,
        frames: totals.frames,
        frames_dropped: totals.frames_dropped,
        contested: figures.contested as u64,
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
            recording: figures.recordings.recording,
            ended: figures.recordings.ended,
            failed: figures.recordings.failed.len() as u64,
        },
        recordings_bytes: figures.recordings_bytes.0,
        recordings_quota_bytes: figures.recordings_bytes.1,
        swarms: figures.swarms.iter().map(swarm).collect(),
    }
}

fn swarm(figures: &SwarmFigures) -> proto::SwarmMetrics {
    let (summary, totals) = (&figures.summary, &figures.totals);
    proto::SwarmMetrics {
        swarm: figures.name.clone(),
        phase: phase(&summary.stamp.phase),
        step: summary.stamp.step,
        n: summary.n as u64,
        rate: summary.rate,
        real_time_factor: summary.real_time_factor,
        steps: totals.step_time.count(),
        step_secs: totals.step_time.secs(),
        due_steps: totals.lateness.count(),
        late_secs: totals.lateness.secs(),
        contacts: figures.last.contacts,
        residual: figures.last.residual,
        degraded: totals.degraded,
        faults: totals.faults,
    }
}
