//! What clients are told of experiments.

use jostle_proto as proto;
use jostle_results::Run;
use jostle_results::table::OrderSeries;

use crate::experiment::Progress;
use crate::lab::{Phase, Report};

/// How far an experiment is.
pub fn progress(report: Report) -> proto::Progress {
    let Progress {
        runs,
        finished,
        faulted,
        share,
        elapsed_secs,
        left_secs,
        running,
    } = report.progress;
    proto::Progress {
        name: report.name,
        phase: match report.phase {
            Phase::Queued => proto::ExperimentPhase::Queued,
            Phase::Running => proto::ExperimentPhase::Running,
            Phase::Paused => proto::ExperimentPhase::Paused,
            Phase::Finished => proto::ExperimentPhase::Finished,
            Phase::Cancelled => proto::ExperimentPhase::Cancelled,
            Phase::Failed => proto::ExperimentPhase::Failed,
        },
        runs: runs as u64,
        finished: finished as u64,
        faulted: faulted as u64,
        share,
        elapsed_secs,
        left_secs,
        running: running
            .into_iter()
            .map(|(run, share)| proto::RunUnderWay { run, share })
            .collect(),
        message: report.message,
    }
}

/// The first of `rows`, which are numbered: at most `limit`, and about `most_bytes` as JSON.
pub fn results_page(
    name: String,
    rows: &[(u64, Run)],
    limit: usize,
    most_bytes: usize,
    finished: u64,
) -> proto::ResultsPage {
    let mut bytes = 0;
    let fitting = rows.iter().take(limit).take_while(|(_, run)| {
        // Each number takes 25 characters at most, and its name as many.
        bytes += 24 * 50 + run.run.len() + run.state_hash.len();
        bytes <= most_bytes
    });
    let count = fitting.count().max(1).min(rows.len());
    let (page, rest) = rows.split_at(count);
    proto::ResultsPage {
        name,
        rows: page.iter().map(|(_, run)| row(run)).collect(),
        next: match (page.last(), rest.is_empty()) {
            (Some((number, _)), false) => Some(*number),
            _ => None,
        },
        finished,
    }
}

fn row(run: &Run) -> proto::ResultRow {
    let Run {
        run,
        seed,
        n,
        pi1,
        pi2,
        pi3,
        pi4,
        informed,
        contacts,
        dt,
        time,
        v,
        v_pd,
        ordered_intervals,
        ordered_time,
        unordered_intervals,
        unordered_time,
        worst_overlap,
        crossed_share,
        worst_residual,
        degraded,
        fallbacks,
        steps,
        state_hash,
    } = run.clone();
    proto::ResultRow {
        run,
        seed,
        n,
        pi1,
        pi2,
        pi3,
        pi4,
        informed,
        contacts,
        dt,
        time,
        v,
        v_pd,
        ordered_intervals,
        ordered_time,
        unordered_intervals,
        unordered_time,
        worst_overlap,
        crossed_share,
        worst_residual,
        degraded,
        fallbacks,
        steps,
        state_hash,
    }
}

/// Entries of a run's order over time: those after `after`, at most `limit`.
pub fn order_page(
    name: String,
    series: &OrderSeries,
    after: u64,
    limit: usize,
) -> proto::OrderPage {
    let count = series.orders.len();
    let begin = usize::try_from(after).map_or(count, |after| after.min(count));
    let end = begin.saturating_add(limit).min(count);
    let part = |column: &[f64]| column.get(begin..end).unwrap_or_default().to_vec();
    proto::OrderPage {
        name,
        run: series.run.clone(),
        time: part(&series.times),
        order: part(&series.orders),
        drift: part(&series.drifts),
        next: (end < count).then_some(end as u64),
    }
}
