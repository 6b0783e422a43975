//! The daemon's numbers as OpenMetrics text, made anew for each who asks.
//!
//! Nothing is kept between two answers, so the series of a swarm end with it. Only a few families
//! have a series for each swarm, and for no more than [`MOST_LABELLED`] of them; the others add up
//! all swarms there ever were.

use std::fmt::{self, Error};

use prometheus_client::collector::Collector;
use prometheus_client::encoding::text::encode;
use prometheus_client::encoding::{DescriptorEncoder, EncodeGaugeValue, MetricEncoder, NoLabelSet};
use prometheus_client::metrics::MetricType;
use prometheus_client::registry::{Registry, Unit};

use crate::health::figures::{Figures, SwarmFigures};
use crate::metrics::Durations;
use crate::swarm::phase::Phase;
use crate::transport::http::connections::HttpFigures;

/// What the text is.
pub const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Swarms with series of their own, the first by name: seven each.
pub const MOST_LABELLED: usize = 1000;

/// Makes the text.
///
/// # Errors
///
/// Never: it is written to memory.
pub fn of(figures: Figures, http: HttpFigures) -> Result<String, Error> {
    let mut registry = Registry::with_prefix("jostle");
    registry.register_collector(Box::new(Told(figures, http)));
    let mut text = String::new();
    encode(&mut text, &registry)?;
    Ok(text)
}

#[derive(Debug)]
struct Told(Figures, HttpFigures);

impl Collector for Told {
    fn encode(&self, mut encoder: DescriptorEncoder) -> Result<(), Error> {
        let figures = &self.0;
        let mut told = Telling(&mut encoder);
        told.daemon(figures)?;
        told.http(&self.1)?;
        told.swarms(figures)?;
        told.store(figures)?;
        told.recordings(figures)?;
        told.each_swarm(&figures.swarms)
    }
}

/// Where the families are written.
struct Telling<'a, 'e>(&'a mut DescriptorEncoder<'e>);

impl Telling<'_, '_> {
    fn daemon(&mut self, figures: &Figures) -> fmt::Result {
        let Figures {
            uptime_secs,
            reasons,
            cpu_secs,
            cores,
            resident_bytes,
            reserved_bytes,
            threads,
            sessions,
            probe_secs,
            bus,
            contested,
            ..
        } = figures;
        self.gauge(
            "healthy",
            "1 while all is well; /healthz says why it is not",
            None,
            &u64::from(reasons.is_empty()),
        )?;
        let secs = Some(Unit::Seconds);
        self.gauge(
            "uptime",
            "Time since the daemon started",
            secs.as_ref(),
            uptime_secs,
        )?;
        self.counter(
            "cpu",
            "Time its threads have computed",
            secs.as_ref(),
            cpu_secs,
        )?;
        self.gauge("cores", "Cores it may use", None, &(*cores as u64))?;
        let help = "Names of the daemon and its swarms that another daemon holds, too";
        self.gauge("contested", help, None, &(*contested as u64))?;
        let bytes = Some(Unit::Bytes);
        self.gauge(
            "resident_memory",
            "Memory in use",
            bytes.as_ref(),
            resident_bytes,
        )?;
        let help = "Memory set aside for the swarms";
        self.gauge("reserved_memory", help, bytes.as_ref(), reserved_bytes)?;
        self.gauge("threads", "Threads of the daemon", None, threads)?;
        self.gauge("sessions", "Clients connected", None, &(*sessions as u64))?;
        let blocked_secs = bus.blocked.map_or(0.0, |age| age.as_secs_f64());
        let help = "Time for which commands and queries have been blocked, 0 while they are not";
        self.gauge("bus_blocked", help, secs.as_ref(), &blocked_secs)?;
        let help = "How often commands and queries were blocked for 2 s or more";
        self.counter("bus_blocks", help, None, &bus.blocks)?;
        match probe_secs {
            Some(took) => {
                let help = "Time its own listener took to answer when it was tried last";
                self.gauge("probe", help, secs.as_ref(), took)
            }
            None => Ok(()),
        }
    }

    fn http(&mut self, http: &HttpFigures) -> fmt::Result {
        let help = "Open HTTP connections, WebSockets included";
        self.gauge("http_connections", help, None, &http.open)?;
        let help = "Attempts to accept an HTTP connection that failed";
        self.counter("http_accept_failures", help, None, &http.accept_failures)?;
        let help = "HTTP connections that the daemon closed, by reason";
        let kind = MetricType::Counter;
        let mut family = self.0.encode_descriptor("http_closed", help, None, kind)?;
        for (reason, count) in http.closed {
            let labels = [("reason", reason)];
            let mut series = family.encode_family(&labels)?;
            series.encode_counter::<NoLabelSet, _, f64>(&count, None)?;
        }
        Ok(())
    }

    fn swarms(&mut self, figures: &Figures) -> fmt::Result {
        let totals = &figures.totals;
        self.counter("steps", "Steps taken", None, &totals.step_time.count())?;
        self.histogram("step", "Time a step took", &totals.step_time)?;
        let help = "How long after it was due a step began, of swarms that have a rate";
        self.histogram("step_lateness", help, &totals.lateness)?;
        self.counter(
            "faults",
            "Steps that failed; each stops its swarm",
            None,
            &totals.faults,
        )?;
        let help = "Steps that missed the target residual, yet were good enough to go on";
        self.counter("degraded_steps", help, None, &totals.degraded)?;
        let help = "Largest residual of a step since the daemon started, in body sizes";
        self.gauge("residual_max", help, None, &totals.residual_max)?;
        self.counter(
            "frames",
            "States made to be published",
            None,
            &totals.frames,
        )?;
        let help = "States that gave way to a newer one before they were published";
        self.counter("frames_dropped", help, None, &totals.frames_dropped)?;
        let count = |is: fn(&Phase) -> bool| {
            let swarms = figures.swarms.iter();
            swarms
                .filter(|swarm| is(&swarm.summary.place.phase))
                .count() as u64
        };
        let help = "Swarms, by what they are doing";
        let mut family = self
            .0
            .encode_descriptor("swarms", help, None, MetricType::Gauge)?;
        for (phase, count) in [
            ("paused", count(|it| matches!(it, Phase::Paused(_)))),
            ("running", count(Phase::is_moving)),
            ("faulted", count(|it| matches!(it, Phase::Faulted(_)))),
        ] {
            let labels = [("phase", phase)];
            family.encode_family(&labels)?.encode_gauge(&count)?;
        }
        let n = figures
            .swarms
            .iter()
            .map(|it| it.summary.n as u64)
            .sum::<u64>();
        self.gauge("individuals", "Individuals in all swarms", None, &n)
    }

    fn store(&mut self, figures: &Figures) -> fmt::Result {
        let store = &figures.store;
        let help = "Time a commit of the journal took, its sync included";
        self.histogram("journal_commit", help, &store.commit_time)?;
        self.counter("journal_writes", "Writes committed", None, &store.writes)?;
        self.gauge(
            "journal_waiting",
            "Writes that wait",
            None,
            &(store.waiting as u64),
        )?;
        let help = "Damaged or missing records that were met";
        self.counter("journal_damaged", help, None, &store.damaged)?;
        let help = "What the store takes on disk";
        self.gauge("store", help, Some(&Unit::Bytes), &store.bytes_on_disk)?;
        let (bytes, quota) = &figures.recordings_bytes;
        let help = "What all recordings take on disk";
        self.gauge("recordings", help, Some(&Unit::Bytes), bytes)?;
        let help = "What they may take";
        self.gauge("recordings_quota", help, Some(&Unit::Bytes), quota)?;
        for (name, help, is) in [
            ("store_full", "1 while the disk is full", store.is_full),
            (
                "store_failing",
                "1 while writing fails otherwise",
                store.is_failing,
            ),
            (
                "store_overrun",
                "1 while more waits than should",
                store.is_overrun,
            ),
        ] {
            self.gauge(name, help, None, &u64::from(is))?;
        }
        Ok(())
    }

    fn recordings(&mut self, figures: &Figures) -> fmt::Result {
        let recordings = &figures.recordings;
        let help = "Recordings of the daemon, by what they are doing";
        let kind = MetricType::Gauge;
        let mut family = self.0.encode_descriptor("recordings", help, None, kind)?;
        for (phase, count) in [
            ("recording", recordings.recording),
            ("ended", recordings.ended),
            ("failed", recordings.failed.len() as u64),
        ] {
            let labels = [("phase", phase)];
            family.encode_family(&labels)?.encode_gauge(&count)?;
        }
        Ok(())
    }

    fn each_swarm(&mut self, swarms: &[SwarmFigures]) -> fmt::Result {
        let labelled = &swarms[..swarms.len().min(MOST_LABELLED)];
        let unlabelled = (swarms.len() - labelled.len()) as u64;
        let help = "Swarms that have no series of their own, since there are so many";
        self.gauge("swarms_unlabelled", help, None, &unlabelled)?;

        let mut counter = |name, help, unit: Option<Unit>, value: fn(&SwarmFigures) -> f64| {
            let kind = MetricType::Counter;
            let mut family = self.0.encode_descriptor(name, help, unit.as_ref(), kind)?;
            for swarm in labelled {
                let labels = [("swarm", swarm.name.as_str())];
                let mut series = family.encode_family(&labels)?;
                series.encode_counter::<NoLabelSet, _, f64>(&value(swarm), None)?;
            }
            Ok(())
        };
        counter("swarm_steps", "Steps taken by the swarm", None, |swarm| {
            swarm.totals.step_time.count() as f64
        })?;
        let secs = Some(Unit::Seconds);
        counter("swarm_step", "Time its steps took", secs.clone(), |swarm| {
            swarm.totals.step_time.secs()
        })?;
        let help = "Time its steps began after they were due";
        counter("swarm_step_lateness", help, secs, |swarm| {
            swarm.totals.lateness.secs()
        })?;

        let mut gauge = |name, help, value: fn(&SwarmFigures) -> Option<f64>| {
            let kind = MetricType::Gauge;
            let mut family = self.0.encode_descriptor(name, help, None, kind)?;
            for swarm in labelled {
                if let Some(value) = value(swarm) {
                    let labels = [("swarm", swarm.name.as_str())];
                    family.encode_family(&labels)?.encode_gauge(&value)?;
                }
            }
            Ok(())
        };
        let help = "Time units per second of wall clock it lately ran at, while it runs";
        gauge("swarm_real_time_factor", help, |swarm| {
            swarm.summary.real_time_factor
        })?;
        gauge("swarm_individuals", "The size of the group", |swarm| {
            Some(swarm.summary.n as f64)
        })?;
        gauge("swarm_contacts", "Contacts of its last step", |swarm| {
            Some(swarm.last.contacts as f64)
        })?;
        gauge(
            "swarm_residual",
            "Residual of its last step, in body sizes",
            |swarm| Some(swarm.last.residual),
        )
    }

    fn gauge(
        &mut self,
        name: &str,
        help: &str,
        unit: Option<&Unit>,
        value: &impl EncodeGaugeValue,
    ) -> fmt::Result {
        let kind = MetricType::Gauge;
        let mut metric = self.0.encode_descriptor(name, help, unit, kind)?;
        metric.encode_gauge(value)
    }

    fn counter(
        &mut self,
        name: &str,
        help: &str,
        unit: Option<&Unit>,
        value: &impl prometheus_client::encoding::EncodeCounterValue,
    ) -> fmt::Result {
        let kind = MetricType::Counter;
        let mut metric = self.0.encode_descriptor(name, help, unit, kind)?;
        metric.encode_counter::<NoLabelSet, _, f64>(value, None)
    }

    fn histogram(&mut self, name: &str, help: &str, durations: &Durations) -> fmt::Result {
        let (kind, unit) = (MetricType::Histogram, Unit::Seconds);
        let mut metric: MetricEncoder = self.0.encode_descriptor(name, help, Some(&unit), kind)?;
        let buckets: Vec<(f64, u64)> = durations
            .buckets()
            .map(|(bound, count)| match bound {
                f64::INFINITY => (f64::MAX, count),
                bound => (bound, count),
            })
            .collect();
        metric.encode_histogram::<NoLabelSet>(durations.secs(), durations.count(), &buckets, None)
    }
}
