//! `top`: what a daemon and its swarms cost, and how fast they are.

use std::cmp::Ordering;
use std::time::Duration;

use jostle_proto::{Metrics, NodeReply, SwarmMetrics};

use crate::arguments::{Sort, TopArguments};
use crate::bus::Bus;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::table;
use crate::verbs::look::Sight;

/// How far apart the two samples of the first screen are.
const FIRST_INTERVAL: Duration = Duration::from_millis(500);

/// A daemon's numbers as they came, or a header and a line for each swarm: rates since the previous
/// sample. The first screen takes two samples: an average since the start of the daemon says nothing
/// about the present.
///
/// # Errors
///
/// Why there is nothing to see.
pub async fn sight(
    bus: &Bus,
    output: Output,
    arguments: &TopArguments,
    before: &mut Option<Metrics>,
) -> Result<Sight, Failure> {
    let answer = bus.get_node("metrics").await?;
    if output.json {
        return Ok(Sight::of(answer.json()?.to_owned()));
    }
    let NodeReply { node, mut result } = answer.read::<NodeReply<Metrics>>()?;
    // The counters of a daemon that was restarted begin at 0.
    let earlier = before
        .take()
        .filter(|it| it.uptime_secs < result.uptime_secs);
    let earlier = match earlier {
        Some(earlier) => earlier,
        None => {
            tokio::time::sleep(FIRST_INTERVAL).await;
            let answer = bus.get_node("metrics").await?;
            let second = answer.read::<NodeReply<Metrics>>()?.result;
            std::mem::replace(&mut result, second)
        }
    };
    let header = header(&node, &result, &earlier);
    let swarms = table(&result, &earlier, arguments.sort);
    *before = Some(result);
    Ok(Sight::of(format!("{header}\n\n{swarms}")))
}

/// How much of something came about, and in how many seconds.
fn since(now: &Metrics, earlier: &Metrics, what: impl Fn(&Metrics) -> f64) -> (f64, f64) {
    (
        what(now) - what(earlier),
        now.uptime_secs - earlier.uptime_secs,
    )
}

/// Two lines about the daemon.
fn header(node: &str, now: &Metrics, earlier: &Metrics) -> String {
    let per_sec = |what: fn(&Metrics) -> f64| {
        let (more, secs) = since(now, earlier, what);
        more / secs
    };
    let commits = since(now, earlier, |it| it.store.commits as f64).0;
    let commit_secs = since(now, earlier, |it| it.store.commit_secs).0;
    let commit = match commits > 0.0 {
        true => commit_secs / commits,
        false => now.store.last_commit_secs,
    };
    let mut lines = format!(
        "{node}  up {}  cores {:.2} of {}  memory {}  sessions {}\n\
         steps {:.0}/s  commits {:.1}/s of {}  frames {:.0}/s, {} dropped  faults {}",
        format::duration(now.uptime_secs),
        per_sec(|it| it.cpu_secs),
        now.cores,
        format::bytes(now.memory_bytes),
        now.sessions,
        per_sec(|it| it.steps as f64),
        per_sec(|it| it.store.commits as f64),
        format::millis(commit),
        per_sec(|it| it.frames as f64),
        now.frames_dropped,
        now.faults,
    );
    for reason in &now.unwell {
        lines.push_str(&format!("\nunwell: {reason}"));
    }
    lines
}

/// A swarm with what it lately cost.
struct Row<'a> {
    swarm: &'a SwarmMetrics,
    /// Seconds of computing a second.
    cost: f64,
    /// Seconds a step took, and began after it was due.
    step_secs: Option<f64>,
    late_secs: Option<f64>,
}

fn rows<'a>(now: &'a Metrics, earlier: &Metrics) -> Vec<Row<'a>> {
    let row = |swarm: &'a SwarmMetrics| {
        let find = |it: &Metrics| it.swarms.iter().find(|it| it.swarm == swarm.swarm).cloned();
        // One of the same name that counts from 0 again is another swarm.
        let was = find(earlier).filter(|was| was.steps <= swarm.steps);
        let more = |what: fn(&SwarmMetrics) -> f64| {
            let was = was.as_ref().map_or(0.0, what);
            what(swarm) - was
        };
        let secs = now.uptime_secs - earlier.uptime_secs;
        let mean = |sum: f64, count: f64| (count > 0.0).then(|| sum / count);
        let computed = more(|it| it.step_secs);
        Row {
            swarm,
            cost: computed / secs,
            step_secs: mean(computed, more(|it| it.steps as f64)),
            late_secs: mean(more(|it| it.late_secs), more(|it| it.due_steps as f64)),
        }
    };
    now.swarms.iter().map(row).collect()
}

/// How much of its rate a swarm reaches; more than any other where it runs without one.
fn reached(swarm: &SwarmMetrics) -> f64 {
    match (swarm.real_time_factor, swarm.rate) {
        (Some(factor), Some(rate)) => factor / rate,
        (Some(factor), None) => 1e9 + factor,
        (None, _) => f64::INFINITY,
    }
}

fn order(sort: Sort, a: &Row<'_>, b: &Row<'_>) -> Ordering {
    let by = match sort {
        Sort::Cost => b.cost.total_cmp(&a.cost),
        Sort::Factor => reached(a.swarm).total_cmp(&reached(b.swarm)),
        Sort::Name => Ordering::Equal,
    };
    by.then_with(|| a.swarm.swarm.cmp(&b.swarm.swarm))
}

fn table(now: &Metrics, earlier: &Metrics, sort: Sort) -> String {
    let mut rows = rows(now, earlier);
    rows.sort_by(|a, b| order(sort, a, b));
    let number = |number: Option<f64>, scale: f64| {
        number.map_or_else(|| format::NONE.into(), |it| format!("{:.1}", it * scale))
    };
    let cells = rows.iter().map(|row| {
        let swarm = row.swarm;
        [
            swarm.swarm.clone(),
            format::phase(swarm.phase).into(),
            swarm.step.to_string(),
            swarm.n.to_string(),
            format::rate(swarm.rate),
            format::factor(swarm.real_time_factor),
            format!("{:.1}", row.cost * 100.0),
            number(row.step_secs, 1e6),
            number(row.late_secs, 1e3),
            swarm.contacts.to_string(),
            format::magnitude(Some(swarm.residual)),
        ]
    });
    let header = [
        "swarm", "phase", "step", "n", "rate", "actual", "cpu_%", "step_us", "late_ms", "contacts",
        "residual",
    ];
    table::table(header, cells.collect())
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use clap::ValueEnum as _;
    use jostle_proto::Phase;

    use super::*;

    /// The fixture, in which a school and a shoal stand; but here the school runs.
    fn metrics() -> Metrics {
        let text = include_str!("../../../../../proto/fixtures/node.metrics.reply.json");
        let mut metrics = serde_json::from_str::<NodeReply<Metrics>>(text)
            .unwrap()
            .result;
        let school = &mut metrics.swarms[0];
        assert_eq!(school.swarm, "school");
        (school.phase, school.real_time_factor) = (Phase::Running, Some(0.998));
        (school.rate, school.residual) = (Some(1.0), 3.5e-13);
        metrics
    }

    /// The same two seconds later, in which the school took 100 steps of 200 µs.
    fn later() -> Metrics {
        let mut later = metrics();
        later.uptime_secs += 2.0;
        later.cpu_secs += 1.0;
        later.steps += 100;
        later.store.commits += 4;
        later.store.commit_secs += 0.002;
        let school = &mut later.swarms[0];
        school.steps += 100;
        school.step_secs += 0.02;
        school.due_steps += 100;
        school.late_secs += 0.05;
        later
    }

    #[test]
    fn what_came_about_between_two_looks_is_shown() {
        let header = header("lab", &later(), &metrics());
        assert!(header.contains("cores 0.50 of 2"), "{header}");
        assert!(
            header.contains("steps 50/s  commits 2.0/s of 0.50 ms"),
            "{header}"
        );
        assert!(header.contains("unwell: the disk is full"), "{header}");
        let table = table(&later(), &metrics(), Sort::Cost);
        let lines: Vec<String> = table
            .lines()
            .map(|line| line.split_whitespace().collect::<Vec<_>>().join(" "))
            .collect();
        assert_eq!(
            lines[1..],
            [
                "school running 110 50 1 1.00 1.0 200.0 0.5 39 3.5e-13",
                "shoal paused 0 20 max - 0.0 - - 0 0.0e0"
            ]
        );
    }

    #[test]
    fn without_a_commit_between_two_samples_the_last_commit_time_is_shown() {
        let (mut earlier, mut now) = (metrics(), later());
        for metrics in [&mut earlier, &mut now] {
            (metrics.store.commits, metrics.store.commit_secs) = (7, 0.1);
            metrics.store.last_commit_secs = 0.003;
        }
        let header = header("lab", &now, &earlier);
        assert!(header.contains("commits 0.0/s of 3.00 ms"), "{header}");
    }

    /// Names of swarms, the first column of a table.
    fn names(table: &str) -> Vec<&str> {
        let lines = table.lines().skip(1);
        lines
            .map(|line| line.split_whitespace().next().unwrap())
            .collect()
    }

    /// Five swarms of which each key gives another order, none the order they come in or its
    /// reverse: name, seconds of computing in the two seconds, rate, real-time factor.
    const SWARMS: [(&str, f64, Option<f64>, Option<f64>); 5] = [
        ("birch", 0.1, Some(4.0), Some(4.0)),
        ("elm", 0.4, Some(1.0), Some(0.2)),
        ("ash", 0.5, None, Some(3.0)),
        ("dogwood", 0.7, Some(2.0), None),
        ("cedar", 0.3, Some(10.0), Some(5.0)),
    ];

    #[test]
    fn swarms_come_in_the_order_of_each_key() {
        let expected = [
            (Sort::Cost, ["dogwood", "ash", "elm", "cedar", "birch"]),
            (Sort::Factor, ["elm", "cedar", "birch", "ash", "dogwood"]),
            (Sort::Name, ["ash", "birch", "cedar", "dogwood", "elm"]),
        ];
        let keys = expected.map(|(sort, _)| sort);
        assert_eq!(Sort::value_variants(), keys, "each key has an order");
        let (mut earlier, mut now) = (metrics(), later());
        let school = &earlier.swarms[0];
        let swarm = |(name, _, rate, factor): (&str, f64, _, _)| SwarmMetrics {
            swarm: name.into(),
            rate,
            real_time_factor: factor,
            ..school.clone()
        };
        let swarms = SWARMS.map(swarm).to_vec();
        now.swarms.clone_from(&swarms);
        for (swarm, (_, secs, ..)) in now.swarms.iter_mut().zip(SWARMS) {
            swarm.step_secs += secs;
            swarm.steps += 100;
        }
        // The cost before does not count, and would give the order of the names.
        earlier.swarms = swarms;
        let mut offset = 0.0;
        earlier.swarms.sort_by(|a, b| b.swarm.cmp(&a.swarm));
        for before in &mut earlier.swarms {
            offset += 1.0;
            let after = now.swarms.iter_mut().find(|it| it.swarm == before.swarm);
            before.step_secs += offset;
            after.unwrap().step_secs += offset;
        }
        for (sort, order) in expected {
            let table = table(&now, &earlier, sort);
            assert_eq!(names(&table), order, "{sort:?}:\n{table}");
        }
    }

    #[test]
    fn equal_swarms_come_by_name() {
        let mut now = later();
        let swarm = |name: &str| SwarmMetrics {
            swarm: name.into(),
            ..now.swarms[0].clone()
        };
        now.swarms = ["b", "c", "a"].map(swarm).to_vec();
        let earlier = Metrics {
            swarms: now.swarms.clone(),
            ..metrics()
        };
        for sort in Sort::value_variants() {
            let table = table(&now, &earlier, *sort);
            assert_eq!(names(&table), ["a", "b", "c"], "{sort:?}");
        }
    }

    #[test]
    fn what_a_new_swarm_ever_cost_is_new() {
        let mut now = later();
        let mut new = now.swarms[0].clone();
        new.swarm = "zebra".into();
        now.swarms.push(new);
        let table = table(&now, &metrics(), Sort::Cost);
        assert_eq!(names(&table), ["zebra", "school", "shoal"], "{table}");
    }

    #[test]
    fn a_swarm_that_counts_anew_is_another_one() {
        let mut now = later();
        now.swarms[0].steps = 10;
        now.swarms[0].step_secs = 0.001;
        let earlier = metrics();
        let rows = rows(&now, &earlier);
        assert_eq!(rows[0].step_secs, Some(0.0001));
    }
}
