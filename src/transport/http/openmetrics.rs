//! The metrics of the daemon as OpenMetrics text, computed at each request.
//!
//! No state is kept between requests, so the series of a swarm end when it is deleted.

use std::fmt::Write as _;

use crate::health::metrics::{DaemonMetrics, PerSwarmMetrics};
use crate::lanes::Status;
use crate::metrics::Durations;
use crate::swarm::phase::Phase;
use crate::transport::http::connections::HttpMetrics;

/// The media type.
pub const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Only the first swarms by name have series of their own, nine each, and one for each measure; all are in the sums.
pub const MAX_LABELLED: usize = 1000;

/// What the metrics are computed from.
struct Input {
    daemon: DaemonMetrics,
    http: HttpMetrics,
}

enum Value {
    Gauge(fn(&Input) -> f64),
    /// A gauge without a sample if there is no value.
    OptionalGauge(fn(&Input) -> Option<f64>),
    Counter(fn(&Input) -> f64),
    Histogram(fn(&Input) -> &Durations),
    /// A gauge for each value of a label.
    Gauges(&'static str, fn(&Input) -> Vec<(&'static str, f64)>),
    Counters(&'static str, fn(&Input) -> Vec<(&'static str, f64)>),
    SwarmGauge(fn(&PerSwarmMetrics) -> Option<f64>),
    SwarmCounter(fn(&PerSwarmMetrics) -> Option<f64>),
    /// A gauge for each measure that a swarm publishes.
    SwarmMeasures,
}

use Value::{
    Counter, Counters, Gauge, Gauges, Histogram, OptionalGauge, SwarmCounter, SwarmGauge,
    SwarmMeasures,
};

/// Each metric: its name without `jostle_`, its description and its value. A suffix `_seconds` or
/// `_bytes` is the unit.
#[rustfmt::skip]
const METRICS: &[(&str, &str, Value)] = &[
    ("healthy", "1 if healthy; otherwise /healthz gives the reasons", Gauge(|it| number(it.daemon.reasons.is_empty()))),
    ("uptime_seconds", "Time since the daemon started", Gauge(|it| it.daemon.uptime_secs)),
    ("cpu_seconds", "CPU time of the daemon", Counter(|it| it.daemon.cpu_secs)),
    ("cores", "Cores available to the daemon", Gauge(|it| it.daemon.cores as f64)),
    ("recovering_swarms", "Swarms that are not recovered yet after a start", Gauge(|it| it.daemon.recovering as f64)),
    ("contested", "Names of the daemon and its swarms that another daemon also holds", Gauge(|it| it.daemon.contested as f64)),
    ("certificate_end_timestamp_seconds", "Begin of the last day of the daemon's certificate, in seconds since 1970, if it has one", OptionalGauge(|it| it.daemon.certificate_end.map(|it| it as f64))),
    ("resident_memory_bytes", "Resident memory", Gauge(|it| it.daemon.resident_bytes as f64)),
    ("reserved_memory_bytes", "Memory reserved for swarms and the running experiment", Gauge(|it| it.daemon.reserved_bytes as f64)),
    ("experiments_reserved_memory_bytes", "Memory reserved for the running experiment", Gauge(|it| it.daemon.experiments_reserved_bytes as f64)),
    ("threads", "Threads of the daemon", Gauge(|it| it.daemon.threads as f64)),
    ("sessions", "Connected clients", Gauge(|it| it.daemon.sessions as f64)),
    ("bus_blocked_seconds", "Time for which commands and queries have been blocked; 0 if they are not", Gauge(|it| it.daemon.bus.blocked.map_or(0.0, |age| age.as_secs_f64()))),
    ("bus_blocks", "Times that commands and queries were blocked for at least 2 s", Counter(|it| it.daemon.bus.blocks as f64)),
    ("dropped_requests", "Requests that a defect dropped without a reply", Counter(|it| it.daemon.dropped_requests as f64)),
    ("lane_executed", "Requests that a lane executed", Counters("lane", |it| lanes(it, |lane| lane.counts.executed as f64))),
    ("lane_dropped", "Requests that a lane dropped, because their clients no longer waited", Counters("lane", |it| lanes(it, |lane| lane.counts.dropped as f64))),
    ("lane_rejected", "Requests that a lane rejected, because its queue was full", Counters("lane", |it| lanes(it, |lane| lane.counts.rejected as f64))),
    ("lane_queued", "Requests in the queue of a lane", Gauges("lane", |it| lanes(it, |lane| lane.queued as f64))),
    ("lane_running", "Requests that a lane executes", Gauges("lane", |it| lanes(it, |lane| lane.running as f64))),
    ("lane_waiting_seconds", "Time for which the oldest request in the queue of a lane has waited", Gauges("lane", |it| lanes(it, |lane| lane.waiting.as_secs_f64()))),
    ("lane_queued_seconds", "Total time for which executed requests were queued", Counters("lane", |it| lanes(it, |lane| lane.counts.queued_secs))),
    ("lane_executed_seconds", "Total duration of the execution of requests", Counters("lane", |it| lanes(it, |lane| lane.counts.executed_secs))),
    ("probe_seconds", "Response time of the slowest of the daemon's own listeners at the last probe", OptionalGauge(|it| it.daemon.probe_secs)),
    ("http_connections", "Open HTTP connections, including WebSockets", Gauge(|it| it.http.open as f64)),
    ("http_accept_failures", "HTTP connections that could not be accepted", Counter(|it| it.http.accept_failures as f64)),
    ("http_closed", "HTTP connections closed by the daemon, by reason", Counters("reason", |it| it.http.closed.map(|(reason, count)| (reason, count as f64)).to_vec())),
    ("steps", "Executed steps", Counter(|it| it.daemon.totals.step_time.count() as f64)),
    ("step_seconds", "Duration of a step", Histogram(|it| &it.daemon.totals.step_time)),
    ("step_lateness_seconds", "Delay of a step behind its due time, for swarms with a rate", Histogram(|it| &it.daemon.totals.lateness)),
    ("faults", "Failed steps; each stops its swarm", Counter(|it| it.daemon.totals.faults as f64)),
    ("degraded_steps", "Steps with a residual above the target and within tolerance", Counter(|it| it.daemon.totals.degraded as f64)),
    ("residual_max", "Largest residual of a step since the daemon started, in body sizes", Gauge(|it| it.daemon.totals.residual_max)),
    ("frames", "States enqueued for publication", Counter(|it| it.daemon.totals.frames as f64)),
    ("frames_dropped", "States replaced by a newer one before publication", Counter(|it| it.daemon.totals.frames_dropped as f64)),
    ("swarms", "Swarms, by phase", Gauges("phase", |it| vec![
        ("paused", swarms(it, |phase| matches!(phase, Phase::Paused(_)))),
        ("running", swarms(it, Phase::is_moving)),
        ("faulted", swarms(it, |phase| matches!(phase, Phase::Faulted(_)))),
    ])),
    ("individuals", "Individuals in all swarms", Gauge(|it| it.daemon.swarms.iter().map(|swarm| swarm.summary.n).sum::<usize>() as f64)),
    ("journal_commit_seconds", "Duration of a journal commit, including its sync", Histogram(|it| &it.daemon.store.commit_time)),
    ("journal_writes", "Committed writes", Counter(|it| it.daemon.store.writes as f64)),
    ("journal_waiting", "Queued writes", Gauge(|it| it.daemon.store.waiting as f64)),
    ("journal_damaged", "Damaged or missing records that were read", Counter(|it| it.daemon.store.damaged as f64)),
    ("store_bytes", "Size of the store on disk", Gauge(|it| it.daemon.store.bytes_on_disk as f64)),
    ("audit_lines", "Lines of the audit log", Gauge(|it| it.daemon.audit.lines as f64)),
    ("audit_bytes", "Size of the audit log", Gauge(|it| it.daemon.audit.bytes as f64)),
    ("recordings_bytes", "Size of all recordings on disk", Gauge(|it| it.daemon.recordings_bytes.0 as f64)),
    ("recordings_quota_bytes", "Maximum size of all recordings", Gauge(|it| it.daemon.recordings_bytes.1 as f64)),
    ("experiments_bytes", "Size of all experiments on disk", Gauge(|it| it.daemon.experiments.used as f64)),
    ("experiments_quota_bytes", "Maximum size of all experiments, if there is one", OptionalGauge(|it| it.daemon.experiments.quota.map(|it| it as f64))),
    ("store_full", "1 if the disk is full", Gauge(|it| number(it.daemon.store.is_full))),
    ("store_failing", "1 if writing fails for another reason", Gauge(|it| number(it.daemon.store.is_failing))),
    ("store_overrun", "1 if the queue of writes exceeds its limit", Gauge(|it| number(it.daemon.store.is_overrun))),
    ("recordings", "Recordings of the daemon, by phase", Gauges("phase", |it| vec![
        ("recording", it.daemon.recordings.recording as f64),
        ("ended", it.daemon.recordings.ended as f64),
        ("failed", it.daemon.recordings.failed.len() as f64),
    ])),
    ("swarms_unlabelled", "Swarms without series of their own, because there are too many", Gauge(|it| it.daemon.swarms.len().saturating_sub(MAX_LABELLED) as f64)),
    ("swarm_steps", "Executed steps of the swarm", SwarmCounter(|swarm| Some(swarm.totals.step_time.count() as f64))),
    ("swarm_step_seconds", "Total duration of its steps", SwarmCounter(|swarm| Some(swarm.totals.step_time.secs()))),
    ("swarm_step_lateness_seconds", "Total delay of its steps behind their due times", SwarmCounter(|swarm| Some(swarm.totals.lateness.secs()))),
    ("swarm_real_time_factor", "Recent time units per second of wall clock, while it runs", SwarmGauge(|swarm| swarm.summary.real_time_factor)),
    ("swarm_rate", "Time units per second of wall clock that it should reach, if it has a rate", SwarmGauge(|swarm| swarm.summary.rate)),
    ("swarm_behind_rate", "1 if the swarm lately omitted steps that were due", SwarmGauge(|swarm| Some(number(swarm.summary.is_behind)))),
    ("swarm_individuals", "Individuals of the swarm", SwarmGauge(|swarm| Some(swarm.summary.n as f64))),
    ("swarm_contacts", "Contacts of its last step", SwarmGauge(|swarm| Some(swarm.last.contacts as f64))),
    ("swarm_measure", "Value of a measure that the swarm publishes, in the unit of the measure, of a recent state", SwarmMeasures),
    ("swarm_residual", "Residual of its last step, in body sizes", SwarmGauge(|swarm| Some(swarm.last.residual))),
];

fn lanes(input: &Input, value: fn(&Status) -> f64) -> Vec<(&'static str, f64)> {
    let lanes = input.daemon.lanes.iter();
    lanes.map(|it| (it.lane.name(), value(it))).collect()
}

fn number(flag: bool) -> f64 {
    f64::from(u8::from(flag))
}

fn swarms(input: &Input, is_in: fn(&Phase) -> bool) -> f64 {
    let phases = input.daemon.swarms.iter().map(|it| &it.summary.stamp.phase);
    phases.filter(|phase| is_in(phase)).count() as f64
}

/// All metrics; of the measures those that are evaluated. Names and label values contain no character that needs an escape.
pub fn encode(daemon: DaemonMetrics, http: HttpMetrics) -> String {
    let input = Input { daemon, http };
    let mut text = String::new();
    for (name, help, value) in METRICS {
        let kind = match value {
            Gauge(_) | OptionalGauge(_) | Gauges(..) | SwarmGauge(_) | SwarmMeasures => "gauge",
            Counter(_) | Counters(..) | SwarmCounter(_) => "counter",
            Histogram(_) => "histogram",
        };
        // Writing to a string does not fail, here and below.
        let _ = writeln!(
            text,
            "# HELP jostle_{name} {help}\n# TYPE jostle_{name} {kind}"
        );
        for unit in ["seconds", "bytes"] {
            if name.ends_with(&format!("_{unit}")) {
                let _ = writeln!(text, "# UNIT jostle_{name} {unit}");
            }
        }
        let suffix = if kind == "counter" { "_total" } else { "" };
        let mut sample = |labels: &str, value: f64| {
            let _ = writeln!(text, "jostle_{name}{suffix}{labels} {value}");
        };
        let labelled = input.daemon.swarms.iter().take(MAX_LABELLED);
        match value {
            Gauge(value) | Counter(value) => sample("", value(&input)),
            OptionalGauge(value) => value(&input).into_iter().for_each(|it| sample("", it)),
            Gauges(label, values) | Counters(label, values) => {
                for (name, value) in values(&input) {
                    sample(&format!("{{{label}=\"{name}\"}}"), value);
                }
            }
            SwarmGauge(value) | SwarmCounter(value) => {
                for swarm in labelled {
                    let labels = format!("{{swarm=\"{}\"}}", swarm.name);
                    value(swarm).into_iter().for_each(|it| sample(&labels, it));
                }
            }
            SwarmMeasures => {
                for swarm in labelled {
                    let values = swarm.measured.iter().filter_map(|frame| frame.values.get());
                    for (measure, value) in values.flatten() {
                        let labels = format!("{{swarm=\"{}\",measure=\"{measure}\"}}", swarm.name);
                        value.iter().for_each(|it| sample(&labels, *it));
                    }
                }
            }
            Histogram(durations) => histogram(&mut text, name, durations(&input)),
        }
    }
    text + "# EOF\n"
}

fn histogram(text: &mut String, name: &str, durations: &Durations) {
    let (secs, count) = (durations.secs(), durations.count());
    let _ = writeln!(
        text,
        "jostle_{name}_sum {secs}\njostle_{name}_count {count}"
    );
    let mut count = 0;
    for (bound, more) in durations.buckets() {
        count += more;
        let bound = match bound {
            f64::INFINITY => "+Inf".to_owned(),
            // A bound is part of the series' identity: earlier versions wrote `1.0`.
            bound if bound.fract() == 0.0 => format!("{bound:.1}"),
            bound => bound.to_string(),
        };
        let _ = writeln!(text, "jostle_{name}_bucket{{le=\"{bound}\"}} {count}");
    }
}
