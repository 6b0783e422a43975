//! `top`: what a daemon and its swarms cost, and how fast they are.

use std::cmp::Ordering;
use std::collections::HashSet;
use std::time::Duration;

use jostle_client::Error;
use jostle_proto::{Metrics, NodeReply, SwarmMetrics, Swarms};
use tokio::time::Instant;

use crate::arguments::{Sort, TopArguments};
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::narrow::{self, Column, Room};
use crate::output::Output;
use crate::screen::{Key, Keys, Screen};
use crate::stdout;
use crate::verbs::outage::DAEMON_AWAY;

/// How far apart the two samples of the first screen are.
const FIRST_INTERVAL: Duration = Duration::from_millis(500);

/// How the last of the lines begins that stay while the swarms are scrolled: the names of the columns.
const HEADER: &str = "swarm ";

/// Shows the metrics of a daemon until interrupted or for `--count` screens. While the daemon does
/// not reply, the last screen stays.
pub async fn top(context: &Context, arguments: &TopArguments) -> Result<(), Failure> {
    let output = context.output;
    if output.json && arguments.sort.is_some() {
        let problem =
            "orders lines, and --json prints the reply of the daemon: leave out one of them";
        return Err(Failure::argument("--sort", problem));
    }
    let mut shown = LastScreen {
        output,
        screen: (!output.json && stdout::is_terminal()).then(Screen::default),
        text: None,
        is_silent: false,
    };
    let mut before = None;
    // A program that reads to the end needs one.
    let mut left = arguments.count.or(output.json.then_some(1));
    let mut keys = match (&shown.screen, left) {
        (Some(_), None) => Keys::read(),
        _ => None,
    };
    loop {
        match sample(context, arguments, &mut before).await {
            Ok(text) => {
                shown.show(text)?;
                left = left.map(|left| left - 1);
            }
            Err(error) if shown.text.is_some() && may_recover(&error) => {
                shown.note_failure(error)?;
            }
            Err(error) => return Err(error.into()),
        }
        if left == Some(0) {
            return Ok(());
        }
        let next = Instant::now() + Duration::from_secs_f64(arguments.interval);
        loop {
            match pressed(&mut keys, next).await {
                None => break,
                Some(Key::Quit) => return Ok(()),
                Some(Key::Interrupt) => return Err(Failure::interrupted()),
                Some(Key::Scroll(by)) => shown.scroll(by)?,
            }
        }
    }
}

/// Whether the daemon may reply to a later query.
fn may_recover(error: &Error) -> bool {
    error.is_transient() || matches!(error, Error::UnknownNode { .. })
}

/// The next key before `next`.
async fn pressed(keys: &mut Option<Keys>, next: Instant) -> Option<Key> {
    let key = async {
        match keys {
            Some(keys) => keys.next().await,
            None => std::future::pending().await,
        }
    };
    tokio::time::timeout_at(next, key).await.ok()
}

/// The last screen.
struct LastScreen {
    output: Output,
    /// Redrawn in place; none where screens are printed one after the other.
    screen: Option<Screen>,
    text: Option<String>,
    is_silent: bool,
}

impl LastScreen {
    fn show(&mut self, text: String) -> Result<(), Failure> {
        self.is_silent = false;
        let is_first = self.text.is_none();
        match &mut self.screen {
            Some(screen) => screen.draw_scrolled(&text, None, HEADER)?,
            None if self.output.json || is_first => self.output.data(&text)?,
            None => self.output.data(&format!("\n{text}"))?,
        }
        self.text = Some(text);
        Ok(())
    }

    /// Shows other swarms of the same sample.
    fn scroll(&mut self, by: isize) -> Result<(), Failure> {
        match (&mut self.screen, &self.text) {
            (Some(screen), Some(text)) => {
                screen.scroll(by);
                screen.draw_scrolled(text, None, HEADER)
            }
            _ => Ok(()),
        }
    }

    /// Prints once why there is no reply.
    fn note_failure(&mut self, error: Error) -> Result<(), Failure> {
        if std::mem::replace(&mut self.is_silent, true) {
            return Ok(());
        }
        let note = match error {
            Error::NoDaemon { .. } | Error::NoNode { .. } => DAEMON_AWAY.to_owned(),
            error => format!("{}; retrying, Ctrl-C ends", Failure::from(error)),
        };
        match (&mut self.screen, &self.text) {
            (Some(screen), Some(text)) => screen.draw_scrolled(text, Some(&note), HEADER),
            _ => {
                self.output.note(&note);
                Ok(())
            }
        }
    }
}

/// A daemon's metrics as JSON, or a header and a line for each swarm: rates since the previous
/// sample. The first screen takes two samples: an average since the start of the daemon says nothing
/// about the present.
async fn sample(
    context: &Context,
    arguments: &TopArguments,
    before: &mut Option<Metrics>,
) -> Result<String, Error> {
    let Context { client, output } = context;
    let TopArguments { filter, sort, .. } = arguments;
    let answer = client.get_node("metrics").await?;
    if output.json && filter.is_empty() {
        return Ok(answer.json()?.to_owned());
    }
    let NodeReply { node, mut result } = answer.read::<NodeReply<Metrics>>()?;
    // Metrics lack what conditions compare.
    let listed: Option<HashSet<String>> = match filter.is_empty() {
        true => None,
        false => {
            let answer = client.get_node("swarms").await?;
            let swarms = answer.read::<NodeReply<Swarms>>()?.result.swarms;
            let listed = swarms.into_iter().filter(|it| filter.lists(it));
            Some(listed.map(|it| it.swarm).collect())
        }
    };
    let is_listed = |it: &SwarmMetrics| listed.as_ref().is_none_or(|all| all.contains(&it.swarm));
    if output.json {
        result.swarms.retain(is_listed);
        let reply = NodeReply { node, result };
        return serde_json::to_string(&reply).map_err(|error| Error::Decode {
            problem: error.to_string(),
        });
    }
    // The counters of a daemon that was restarted begin at 0.
    let earlier = before
        .take()
        .filter(|it| it.uptime_secs < result.uptime_secs);
    let earlier = match earlier {
        Some(earlier) => earlier,
        None => {
            tokio::time::sleep(FIRST_INTERVAL).await;
            let answer = client.get_node("metrics").await?;
            let second = answer.read::<NodeReply<Metrics>>()?.result;
            std::mem::replace(&mut result, second)
        }
    };
    let header = header(&node, &result, &earlier);
    let mut shown = result.clone();
    shown.swarms.retain(is_listed);
    let sort = sort.unwrap_or_default();
    let swarms = table(&shown, &earlier, sort, narrow::terminal_width());
    *before = Some(result);
    Ok(format!("{header}\n\n{swarms}"))
}

/// The increase of a counter, and the seconds in which it increased.
fn increase(now: &Metrics, earlier: &Metrics, what: impl Fn(&Metrics) -> f64) -> (f64, f64) {
    (
        what(now) - what(earlier),
        now.uptime_secs - earlier.uptime_secs,
    )
}

/// Two lines about the daemon.
fn header(node: &str, now: &Metrics, earlier: &Metrics) -> String {
    let per_sec = |what: fn(&Metrics) -> f64| {
        let (more, secs) = increase(now, earlier, what);
        more / secs
    };
    let commits = increase(now, earlier, |it| it.store.commits as f64).0;
    let commit_secs = increase(now, earlier, |it| it.store.commit_secs).0;
    let commit = match commits > 0.0 {
        true => commit_secs / commits,
        false => now.store.last_commit_secs,
    };
    let mut lines = format!(
        "{node}  up {}  cores {:.2} of {}  resident memory {}  clients {}\n\
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

/// A swarm with its recent load.
struct Row<'a> {
    swarm: &'a SwarmMetrics,
    /// CPU seconds per second.
    cost: f64,
    /// The mean duration and the mean delay of a step, in seconds.
    step_secs: Option<f64>,
    late_secs: Option<f64>,
}

fn rows<'a>(now: &'a Metrics, earlier: &Metrics) -> Vec<Row<'a>> {
    let row = |swarm: &'a SwarmMetrics| {
        let find = |it: &Metrics| it.swarms.iter().find(|it| it.swarm == swarm.swarm).cloned();
        // A counter that decreased belongs to another swarm of the same name.
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

/// The reached share of the rate. A swarm without a rate sorts after those with one.
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

fn table(now: &Metrics, earlier: &Metrics, sort: Sort, width: Option<usize>) -> String {
    let mut rows = rows(now, earlier);
    rows.sort_by(|a, b| order(sort, a, b));
    fn scaled(number: Option<f64>, scale: f64) -> String {
        format::or_none(number.map(|it| format!("{:.1}", it * scale)))
    }
    let columns: [Column<Row<'_>>; 11] = [
        ("swarm", |it| it.swarm.swarm.clone(), Room::Elide),
        ("phase", |it| it.swarm.phase.name().into(), Room::Keep),
        ("step", |it| it.swarm.step.to_string(), Room::Drop(4)),
        ("n", |it| it.swarm.n.to_string(), Room::Drop(7)),
        ("rate", |it| format::rate(it.swarm.rate), Room::Drop(6)),
        (
            "actual",
            |it| format::factor(it.swarm.real_time_factor),
            Room::Drop(8),
        ),
        ("cpu_%", |it| format!("{:.1}", it.cost * 100.0), Room::Keep),
        ("step_us", |it| scaled(it.step_secs, 1e6), Room::Drop(3)),
        ("late_ms", |it| scaled(it.late_secs, 1e3), Room::Drop(5)),
        (
            "contacts",
            |it| it.swarm.contacts.to_string(),
            Room::Drop(1),
        ),
        (
            "residual",
            |it| format::magnitude(Some(it.swarm.residual)),
            Room::Drop(2),
        ),
    ];
    narrow::of(&rows, columns, width)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use clap::ValueEnum as _;
    use jostle_proto::Phase;

    use super::*;

    /// The fixture, in which a school and a shoal are paused; here the school runs.
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

    /// The same after two seconds in which the school took 100 steps of 200 µs.
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
        // Half of them had a due time.
        school.due_steps += 50;
        school.late_secs += 0.05;
        later
    }

    #[test]
    fn rates_are_between_two_samples() {
        let header = header("lab", &later(), &metrics());
        assert!(header.contains("cores 0.50 of 2"), "{header}");
        assert!(
            header.contains("steps 50/s  commits 2.0/s of 0.50 ms"),
            "{header}"
        );
        assert!(header.contains("unwell: the disk is full"), "{header}");
        let table = table(&later(), &metrics(), Sort::Cost, None);
        let lines: Vec<String> = table
            .lines()
            .map(|line| line.split_whitespace().collect::<Vec<_>>().join(" "))
            .collect();
        assert_eq!(
            lines[1..],
            [
                "school running 110 50 1 1.00 1.0 200.0 1.0 39 3.5e-13",
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

    /// Five swarms that each key sorts differently, never as listed here or in reverse: name, CPU
    /// seconds within the two seconds, rate, real-time factor.
    const SWARMS: [(&str, f64, Option<f64>, Option<f64>); 5] = [
        ("birch", 0.1, Some(4.0), Some(4.0)),
        ("elm", 0.4, Some(1.0), Some(0.2)),
        ("ash", 0.5, None, Some(3.0)),
        ("dogwood", 0.7, Some(2.0), None),
        ("cedar", 0.3, Some(10.0), Some(5.0)),
    ];

    #[test]
    fn swarms_are_sorted_by_each_key() {
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
        // The cost before the first sample does not count; it would give the order of the names.
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
            let table = table(&now, &earlier, sort, None);
            assert_eq!(names(&table), order, "{sort:?}:\n{table}");
        }
    }

    #[test]
    fn equal_swarms_are_sorted_by_name() {
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
            let table = table(&now, &earlier, *sort, None);
            assert_eq!(names(&table), ["a", "b", "c"], "{sort:?}");
        }
    }

    #[test]
    fn a_new_swarm_counts_from_zero() {
        let mut now = later();
        let mut new = now.swarms[0].clone();
        new.swarm = "zebra".into();
        now.swarms.push(new);
        let table = table(&now, &metrics(), Sort::Cost, None);
        assert_eq!(names(&table), ["zebra", "school", "shoal"], "{table}");
    }

    #[test]
    fn a_decreased_counter_belongs_to_a_new_swarm() {
        let mut now = later();
        now.swarms[0].steps = 10;
        now.swarms[0].step_secs = 0.001;
        let earlier = metrics();
        let rows = rows(&now, &earlier);
        assert_eq!(rows[0].step_secs, Some(0.0001));
    }
}
