//! `diff`: where and how two swarms diverge.

mod bodies;
mod commands;

use jostle_client::Client;
use jostle_proto::{Order, Reply, Spec, State};
use serde::Serialize;
use serde_json::Value;

use self::bodies::Bodies;
use self::commands::{Command, Divergence, History};
use crate::arguments::DiffArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::table;
use crate::verbs::inspect;

/// The largest number of queries for a state and a status of the same step.
const MAX_QUERIES: usize = 5;

/// The result of `diff`, as it is printed with `--json`.
#[derive(Debug, Serialize)]
struct Difference {
    one: Side,
    other: Side,
    /// The fields of their specs that differ.
    spec: Vec<String>,
    /// The `seq` after which their commands could be compared: one of the journals no longer has those
    /// up to it, or the swarm was forked later.
    compared_after_seq: u64,
    /// The first commands that differ; `null` if there are none.
    commands: Option<Divergence>,
    /// Whether both are at one step.
    is_same_step: bool,
    /// Whether both have one hash; `null` if they are not at one step, or one of them moved
    /// during the queries.
    is_same_hash: Option<bool>,
    /// How their individuals differ; `null` if they are not at one step.
    individuals: Option<Bodies>,
    /// How fast both drift along one direction; `null` if neither has a common direction of the informed.
    drift: Option<Drift>,
}

/// Drifts along one direction: that of the second's informed individuals, or of the first's.
#[derive(Clone, Copy, Debug, Serialize)]
struct Drift {
    direction: f64,
    one: f64,
    other: f64,
}

/// One of the two swarms.
#[derive(Debug, Serialize)]
struct Side {
    swarm: String,
    epoch: u64,
    step: u64,
    time: f64,
    seq: u64,
    n: usize,
    informed: usize,
    state_hash: Option<String>,
    order: Order,
}

/// One of the two swarms with its state and its commands.
struct Snapshot {
    side: Side,
    state: State,
    spec: Spec,
    history: History,
}

pub async fn diff(context: &Context, arguments: &DiffArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    let DiffArguments { one, other } = arguments;
    if one == other {
        let problem = format!("{other} is also the first swarm: name two different swarms");
        return Err(Failure::argument("OTHER", problem));
    }
    let difference = difference(fetch(client, one).await?, fetch(client, other).await?);
    output.print(&difference, &describe(&difference))
}

async fn fetch(client: &Client, swarm: &str) -> Result<Snapshot, Failure> {
    let spec: Reply<Spec> = client.get(swarm, "spec").await?.read()?;
    let mut queries = 0;
    let (status, state) = loop {
        let status = client.status(swarm).await?;
        let state: State = client.state(swarm).await?.read()?;
        queries += 1;
        let is_one_moment = (status.epoch, status.step) == (state.epoch, state.step);
        if is_one_moment || queries >= MAX_QUERIES {
            break (is_one_moment.then_some(status.result), state);
        }
    };
    let journal = inspect::full_journal(client, swarm).await?;
    let side = Side {
        swarm: swarm.to_owned(),
        epoch: state.epoch,
        step: state.step,
        time: state.time,
        seq: journal.seq,
        n: state.id.len(),
        informed: state.weight.iter().filter(|weight| **weight > 0.0).count(),
        state_hash: status.map(|status| status.state_hash),
        order: state.order,
    };
    Ok(Snapshot {
        side,
        state,
        spec: spec.result,
        history: History::of(journal),
    })
}

fn difference(one: Snapshot, other: Snapshot) -> Difference {
    let is_same_step = one.side.step == other.side.step;
    let hashes = (one.side.state_hash.as_ref()).zip(other.side.state_hash.as_ref());
    let (compared_after_seq, commands) = commands::diverge(&one.history, &other.history);
    Difference {
        spec: fields_that_differ(&one.spec, &other.spec),
        compared_after_seq,
        commands,
        is_same_step,
        is_same_hash: hashes
            .filter(|_| is_same_step)
            .map(|(one, other)| one == other),
        individuals: is_same_step.then(|| bodies::compare(&one.state, &other.state)),
        drift: drift(&one.side.order, &other.side.order),
        one: one.side,
        other: other.side,
    }
}

/// Both drifts along one direction, so that a swarm without informed individuals is comparable.
fn drift(one: &Order, other: &Order) -> Option<Drift> {
    let direction = other.direction.or(one.direction)?;
    let along = |order: &Order| {
        let [x, y] = order.velocity;
        x * direction.cos() + y * direction.sin()
    };
    Some(Drift {
        direction,
        one: along(one),
        other: along(other),
    })
}

/// The fields of two specs that differ, without those that do not affect the state.
fn fields_that_differ(one: &Spec, other: &Spec) -> Vec<String> {
    let fields = |spec: &Spec| match serde_json::to_value(spec) {
        Ok(Value::Object(fields)) => fields,
        _ => serde_json::Map::new(),
    };
    let (one, other) = (fields(one), fields(other));
    let is_compared = |name: &str| !["rate", "publish_every", "measures"].contains(&name);
    one.into_iter()
        .filter(|(name, value)| is_compared(name) && other.get(name) != Some(value))
        .map(|(name, _)| name)
        .collect()
}

fn describe(difference: &Difference) -> String {
    let Difference {
        one,
        other,
        spec,
        compared_after_seq,
        commands,
        is_same_step,
        is_same_hash,
        individuals,
        drift,
    } = difference;
    let mut lines = Vec::new();
    if !spec.is_empty() {
        lines.push(format!("made from other specs: {}", spec.join(", ")));
    }
    // A fork's journal begins with it.
    let after = match compared_after_seq {
        0 => String::new(),
        seq => format!(" after seq {seq} (one of the journals begins there)"),
    };
    match commands {
        Some(divergence) => {
            lines.push(format!("the first commands that differ{after}:"));
            for (side, next) in [(one, &divergence.one), (other, &divergence.other)] {
                lines.push(format!("  {}: {}", side.swarm, command(next.as_ref())));
            }
        }
        None => lines.push(format!("no command differs{after}")),
    }
    lines.push(match (is_same_step, is_same_hash) {
        (false, _) => format!(
            "at different steps, {} and {}: bodies not compared",
            one.step, other.step
        ),
        (true, Some(true)) => format!("both at step {}, the same to the bit", one.step),
        (true, _) => format!("both at step {}, and different", one.step),
    });
    if let Some(bodies) = individuals.as_ref().filter(|_| *is_same_hash != Some(true)) {
        lines.push(bodies.describe());
    }
    lines.push(String::new());
    lines.push(sides(one, other, *drift));
    lines.join("\n")
}

/// The command of one side where the histories diverge.
fn command(command: Option<&Command>) -> String {
    command.map_or_else(
        || "nothing more".into(),
        |it| {
            let what = format::command(&it.verb, &it.args);
            format!("{what} at step {} (seq {})", it.step, it.seq)
        },
    )
}

/// Both side by side, and the difference.
fn sides(one: &Side, other: &Side, drift: Option<Drift>) -> String {
    let whole = |name: &str, of: fn(&Side) -> u64| {
        let (one, other) = (of(one), of(other));
        let more = i128::from(other) - i128::from(one);
        [
            name.into(),
            one.to_string(),
            other.to_string(),
            more.to_string(),
        ]
    };
    let real = |name: &str, one: Option<f64>, other: Option<f64>, wrap: fn(f64) -> f64| {
        let more = one.zip(other).map(|(one, other)| wrap(other - one));
        let [one, other, more] = [one, other, more].map(format::share);
        [name.into(), one, other, more]
    };
    let share = |name: &str, of: fn(&Side) -> Option<f64>| real(name, of(one), of(other), |it| it);
    let angle =
        |name: &str, of: fn(&Side) -> Option<f64>| real(name, of(one), of(other), bodies::wrapped);
    let along = drift.map(|it| format!("drift along {}", format::time(it.direction)));
    let drift = real(
        along.as_deref().unwrap_or("drift"),
        drift.map(|it| it.one),
        drift.map(|it| it.other),
        |it| it,
    );
    let rows = vec![
        whole("step", |side| side.step),
        whole("n", |side| side.n as u64),
        whole("informed", |side| side.informed as u64),
        share("order", |side| Some(side.order.order)),
        drift,
        angle("direction", |side| side.order.direction),
        angle("heading", |side| heading(&side.order)),
        share("mean order", |side| side.order.mean_order),
        share("mean drift", |side| side.order.mean_drift),
    ];
    table::table(
        ["", one.swarm.as_str(), other.swarm.as_str(), "difference"],
        rows,
    )
}

/// The direction of the mean velocity, in radians.
fn heading(order: &Order) -> Option<f64> {
    let [x, y] = order.velocity;
    (x != 0.0 || y != 0.0).then(|| y.atan2(x))
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use serde_json::json;

    use super::*;

    fn side(swarm: &str, direction: f64) -> Side {
        let order = json!({"order": 1, "mean_order": null, "velocity": [direction.cos(), direction.sin()],
            "mean_velocity": null, "direction": direction, "drift": 1, "mean_drift": null});
        Side {
            swarm: swarm.to_owned(),
            epoch: 1,
            step: 5,
            time: 0.1,
            seq: 0,
            n: 3,
            informed: 1,
            state_hash: None,
            order: serde_json::from_value(order).unwrap(),
        }
    }

    #[test]
    fn angles_differ_by_the_shorter_way_round() {
        let text = sides(&side("a", 3.1), &side("b", -3.1), None);
        for name in ["direction", "heading"] {
            let row = text.lines().find(|line| line.contains(name)).unwrap();
            // 2π - 6.2
            assert!(row.contains("0.083") && !row.contains("6.2"), "{text}");
        }
    }
}
