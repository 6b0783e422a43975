//! What it costs to record the metrics of a step: its duration, lateness, contacts and residual.

use std::time::{Duration, Instant};

use jostle_physics::stepper::StepReport;
use jostled::swarm::metrics::SwarmMetrics;

use crate::{Limit, Row};

/// Rounds, of which the fastest is reported.
const ROUNDS: usize = 20;
const STEPS: u32 = 100_000;

pub fn measure() -> Row {
    let (metrics, report) = (SwarmMetrics::default(), StepReport::default());
    let costs = (0..ROUNDS).map(|_| {
        let began = Instant::now();
        for i in 0..STEPS {
            let took = Duration::from_nanos(5000 + u64::from(i % 64) * 100);
            metrics.activity.begin();
            metrics.activity.begin();
            metrics.stepped(took, Some(took), std::hint::black_box(&report));
        }
        began.elapsed() / STEPS
    });
    let cost = costs.min().unwrap_or(Duration::MAX);
    Row {
        key: "counting_nanoseconds",
        what: "recording the metrics of a step (one of 20 individuals takes 5,000 ns)".into(),
        value: cost.as_secs_f64() * 1e9,
        limit: Limit::AtMost(100.0),
        unit: "ns",
    }
}
