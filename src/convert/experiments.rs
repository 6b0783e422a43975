//! Progress and results of experiments.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_experiment::{LiveCommand, LiveRun, MAX_COMMANDS, Plan};
use jostle_proto as proto;
use jostle_results::table::{MeasureSeries, SeriesPart};
use serde::Serialize;
use serde_json::json;

use crate::experiments::{Report, TrajectoryRows};
use crate::swarm::schedule::MAX_SCHEDULED;

// A run that can be played can be scheduled.
const _: () = assert!(MAX_COMMANDS.0 == MAX_SCHEDULED.0 && MAX_COMMANDS.1 == MAX_SCHEDULED.1);

pub fn progress(report: Report) -> proto::Progress {
    let progress = report.progress;
    proto::Progress {
        name: report.name,
        phase: report.phase,
        runs: progress.runs as u64,
        finished: progress.finished as u64,
        faulted: progress.faulted as u64,
        share: progress.share,
        elapsed_secs: progress.elapsed_secs,
        left_secs: progress.left_secs,
        running: progress
            .running
            .into_iter()
            .map(|(run, share)| proto::RunUnderWay { run, share })
            .collect(),
        message: report.message,
        model_version: report.other_model,
        start_model_version: report.start_model_version,
    }
}

/// The progress of an experiment that has not been submitted.
pub fn planned(plan: &Plan) -> proto::Progress {
    proto::Progress {
        name: plan.name.clone(),
        phase: proto::ExperimentPhase::Queued,
        runs: plan.runs().len() as u64,
        finished: 0,
        faulted: 0,
        share: 0.0,
        elapsed_secs: 0.0,
        left_secs: None,
        running: Vec::new(),
        message: None,
        model_version: None,
        start_model_version: plan.start_model_version(),
    }
}

/// A run as the swarm and the commands that have its states.
pub fn expanded(run: &str, live: LiveRun) -> proto::ExpandedRun {
    let commands = live.commands.into_iter();
    proto::ExpandedRun {
        run: run.to_owned(),
        spec: live.spec,
        snapshot: live.snapshot.map(|bytes| STANDARD.encode(bytes)),
        steps: live.steps,
        commands: commands
            .map(|command| match command {
                LiveCommand::Batch { step, args } => run_command(Some(step), "batch", &args),
                LiveCommand::When(args) => run_command(None, "when", &args),
            })
            .collect(),
        stop: live.stop,
    }
}

fn run_command(at_step: Option<u64>, verb: &str, args: &impl Serialize) -> proto::RunCommand {
    proto::RunCommand {
        at_step,
        verb: verb.to_owned(),
        args: json!(args),
    }
}

/// Returns the first of the numbered `rows`: at most `limit`, and about `max_bytes` of JSON.
pub fn results_page(
    name: String,
    columns: &proto::OccasionalColumns,
    rows: &[(u64, proto::ResultRow)],
    limit: usize,
    max_bytes: usize,
    finished: u64,
) -> proto::ResultsPage {
    let mut bytes = 0;
    let fitting = rows.iter().take(limit).take_while(|(_, run)| {
        // Each number takes 25 characters at most, and its name as many.
        bytes += 24 * 50 + run.run.len() + run.state_hash.len();
        bytes += run.extra.iter().map(|it| it.name.len() + 50).sum::<usize>();
        bytes <= max_bytes
    });
    let count = fitting.count().max(1).min(rows.len());
    let (page, rest) = rows.split_at(count);
    proto::ResultsPage {
        name,
        rows: page.iter().map(|(_, row)| row.clone()).collect(),
        next: match (page.last(), rest.is_empty()) {
            (Some((number, _)), false) => Some(*number),
            _ => None,
        },
        finished,
        columns: Some(columns.clone()),
    }
}

/// Returns entries of a run's order over time, from number `after` + 1.
pub fn order_page(name: String, after: u64, part: SeriesPart) -> proto::OrderPage {
    let next = next(&part, after);
    let SeriesPart {
        rows,
        is_defined,
        total,
    } = part;
    // A drift that is undefined everywhere is left out.
    let mut measures = rows.measures.iter().zip(is_defined);
    let mut column = || {
        let defined = measures.next().filter(|(_, is_defined)| *is_defined);
        defined.map_or_else(Vec::new, |(measure, _)| numbers(measure))
    };
    proto::OrderPage {
        name,
        run: rows.run,
        time: rows.times,
        order: column(),
        drift: column(),
        next,
        total: Some(total),
    }
}

/// Returns entries of a run's measures over time, from number `after` + 1.
pub fn series_page(name: String, after: u64, part: SeriesPart) -> proto::SeriesPage {
    let next = next(&part, after);
    let rows = part.rows;
    let measures = rows.measures.iter().map(|measure| proto::MeasureSeries {
        name: measure.name.clone(),
        value: numbers(measure),
    });
    proto::SeriesPage {
        name,
        measures: measures.collect(),
        run: rows.run,
        step: rows.steps.iter().map(|&step| step as f64).collect(),
        time: rows.times,
        about: None,
        next,
        total: Some(part.total),
    }
}

/// Returns the number of the last entry of a page; none if no entry follows.
fn next(part: &SeriesPart, after: u64) -> Option<u64> {
    let next = after.saturating_add(part.rows.steps.len() as u64);
    (next < part.total).then_some(next)
}

/// Returns the values of a measure, NaN where it is undefined.
fn numbers(measure: &MeasureSeries) -> Vec<f64> {
    let values = measure.values.iter();
    values.map(|value| value.unwrap_or(f64::NAN)).collect()
}

/// Returns rows of a run's trajectory, from number `after` + 1.
pub fn trajectory_page(
    name: String,
    run: String,
    after: u64,
    trajectory: TrajectoryRows,
) -> proto::SeriesPage {
    let TrajectoryRows { rows, total, about } = trajectory;
    let next = after.saturating_add(rows.len() as u64);
    let informed = rows.informed.iter();
    let columns = [
        ("id", rows.id.iter().copied().map(f64::from).collect()),
        ("x", rows.x),
        ("y", rows.y),
        ("alpha", rows.alpha),
        ("informed", informed.map(|it| f64::from(*it)).collect()),
    ];
    let measures = columns.into_iter().map(|(name, value)| {
        let name = name.to_owned();
        proto::MeasureSeries { name, value }
    });
    proto::SeriesPage {
        name,
        run,
        step: rows.step.iter().map(|&step| step as f64).collect(),
        time: rows.time,
        measures: measures.collect(),
        about: about.map(|about| {
            let pairs = about.into_iter();
            pairs
                .map(|(key, value)| proto::Metadata { key, value })
                .collect()
        }),
        next: (next < total).then_some(next),
        total: Some(total),
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    /// A row that version bf41dde wrote, with another number.
    fn row(number: u64) -> (u64, proto::ResultRow) {
        let stored = include_str!("../../tests/stored/bf41dde/results/runs.jsonl");
        let line: serde_json::Value = serde_json::from_str(stored.lines().nth(1).unwrap()).unwrap();
        let row: proto::ResultRow = serde_json::from_value(line["row"].clone()).unwrap();
        let run = format!("n=10 #{number}");
        let seed = number;
        (number, proto::ResultRow { run, seed, ..row })
    }

    #[test]
    fn pages_limited_by_rows_or_by_bytes_cover_every_row() {
        let rows: Vec<_> = (0..20).map(row).collect();
        for (limit, max_bytes) in [(3, usize::MAX), (20, 5000), (1000, 5000), (3, 5000), (7, 0)] {
            let (mut seen, mut left) = (Vec::new(), &rows[..]);
            loop {
                let columns = proto::OccasionalColumns::default();
                let page = results_page("order".to_owned(), &columns, left, limit, max_bytes, 20);
                assert!(!page.rows.is_empty() && page.rows.len() <= limit);
                seen.extend(page.rows.iter().map(|row| row.seed));
                let Some(next) = page.next else { break };
                left = &rows[rows.partition_point(|(number, _)| *number <= next)..];
            }
            assert!(seen.into_iter().eq(0..20), "{limit} {max_bytes}");
        }
    }
}
