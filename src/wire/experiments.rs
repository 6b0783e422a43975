//! What clients are told of experiments.

use jostle_proto as proto;
use jostle_results::Run;
use jostle_results::table::OrderSeries;

use crate::lab::{Phase, Report};
use jostle_experiment::Progress;

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

#[cfg(test)]
mod tests {
    use super::*;

    fn run(number: u64) -> (u64, Run) {
        let run = Run {
            run: format!("n=10 #{number}"),
            seed: number,
            n: 10,
            pi1: 4.0,
            pi2: 0.0,
            pi3: 1.0,
            pi4: 10.0,
            informed: 0,
            contacts: "endpoints".to_owned(),
            dt: 0.02,
            time: 1.0,
            v: 0.9,
            v_pd: None,
            ordered_intervals: 1,
            ordered_time: 0.5,
            unordered_intervals: 1,
            unordered_time: 0.5,
            worst_overlap: 0.0,
            crossed_share: 0.0,
            worst_residual: 1e-9,
            degraded: 0,
            fallbacks: 0,
            steps: 50,
            state_hash: "00ff".to_owned(),
        };
        (number, run)
    }

    #[test]
    fn pages_limited_by_rows_or_by_bytes_cover_every_row() {
        let rows: Vec<_> = (0..20).map(run).collect();
        for (limit, most_bytes) in [(3, usize::MAX), (20, 5000), (1000, 5000), (3, 5000), (7, 0)] {
            let (mut seen, mut left) = (Vec::new(), &rows[..]);
            loop {
                let page = results_page("order".to_owned(), left, limit, most_bytes, 20);
                assert!(!page.rows.is_empty() && page.rows.len() <= limit);
                seen.extend(page.rows.iter().map(|row| row.seed));
                let Some(next) = page.next else { break };
                left = &rows[rows.partition_point(|(number, _)| *number <= next)..];
            }
            assert!(seen.into_iter().eq(0..20), "{limit} {most_bytes}");
        }
    }
}
