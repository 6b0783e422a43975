//! `diff`: where and how two swarms part.

mod bodies;
mod past;

use jostle_proto::{Order, Reply, Spec, State, Status};
use serde::Serialize;
use serde_json::Value;

use self::bodies::Bodies;
use self::past::Parting;
use crate::arguments::DiffArguments;
use crate::bus::Bus;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::table;
use crate::verbs::look;

/// How often both are looked at until state and status of each are of one moment.
const LOOKS: usize = 5;

/// All that `diff` tells, as programs read it.
#[derive(Debug, Serialize)]
struct Difference {
    /// The first swarm.
    one: Side,
    /// The second swarm.
    other: Side,
    /// The fields of their specs that differ.
    spec: Vec<String>,
    /// The `seq` after which their commands could be compared: what one of them no longer keeps,
    /// or never saw since it was forked later, is not.
    compared_after_seq: u64,
    /// The first commands that differ; `null` if there are none.
    commands: Option<Parting>,
    /// Whether both are at one step.
    is_same_step: bool,
    /// Whether both have one hash; `null` if they are not at one step, or moved while looked at.
    is_same_hash: Option<bool>,
    /// How their individuals differ; `null` if they are not at one step.
    individuals: Option<Bodies>,
    /// How fast both drift along one direction; `null` if nobody is informed of any.
    drift: Option<Drift>,
}

/// Drifts along one direction: that of the second's informed individuals, or of the first's.
#[derive(Clone, Copy, Debug, Serialize)]
struct Drift {
    direction: f64,
    one: f64,
    other: f64,
}

/// One of the two.
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

/// What is known of one of the two.
struct Seen {
    side: Side,
    state: State,
    spec: Spec,
    past: past::Past,
}

/// Compares two swarms.
///
/// # Errors
///
/// Why one of them cannot be looked at.
pub async fn diff(bus: &Bus, output: Output, arguments: &DiffArguments) -> Result<(), Failure> {
    if arguments.one == arguments.other {
        return Err(Failure::Argument {
            argument: "OTHER".to_owned(),
            problem: format!(
                "{} is also the first swarm: name two different swarms",
                arguments.other
            ),
        });
    }
    let one = seen(bus, &arguments.one).await?;
    let other = seen(bus, &arguments.other).await?;
    let difference = difference(one, other);
    if output.json {
        let json = serde_json::to_string(&difference).map_err(Failure::defect)?;
        return output.data(&json);
    }
    output.data(&words(&difference))
}

async fn seen(bus: &Bus, swarm: &str) -> Result<Seen, Failure> {
    let spec: Reply<Spec> = bus.get(swarm, "spec").await?.read()?;
    let mut looks = 0;
    let (status, state) = loop {
        let status: Reply<Status> = bus.get(swarm, "status").await?.read()?;
        let state: State = bus.state(swarm).await?.read()?;
        looks += 1;
        let is_one_moment = (status.epoch, status.step) == (state.epoch, state.step);
        if is_one_moment || looks >= LOOKS {
            break (is_one_moment.then_some(status.result), state);
        }
    };
    let journal = look::whole(bus, swarm).await?;
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
    Ok(Seen {
        side,
        state,
        spec: spec.result,
        past: past::Past::of(journal),
    })
}

fn difference(one: Seen, other: Seen) -> Difference {
    let is_same_step = one.side.step == other.side.step;
    let hashes = one
        .side
        .state_hash
        .as_ref()
        .zip(other.side.state_hash.as_ref());
    let (compared_after_seq, commands) = past::parting(&one.past, &other.past);
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

/// What if they had been informed: the drift of those who were not is told along the same direction.
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

/// The fields of two specs that differ, but for those that no state depends on.
fn fields_that_differ(one: &Spec, other: &Spec) -> Vec<String> {
    let fields = |spec: &Spec| match serde_json::to_value(spec) {
        Ok(Value::Object(fields)) => fields,
        _ => serde_json::Map::new(),
    };
    let (one, other) = (fields(one), fields(other));
    let is_told = |name: &str| !["rate", "publish_every"].contains(&name);
    one.into_iter()
        .filter(|(name, value)| is_told(name) && other.get(name) != Some(value))
        .map(|(name, _)| name)
        .collect()
}

fn words(difference: &Difference) -> String {
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
    match commands {
        Some(parting) => {
            lines.push("the first commands that differ:".to_owned());
            lines.push(format!("  {}: {}", one.swarm, told(parting.one.as_ref())));
            lines.push(format!(
                "  {}: {}",
                other.swarm,
                told(parting.other.as_ref())
            ));
        }
        None => lines.push("no command differs".to_owned()),
    }
    if *compared_after_seq > 0 {
        lines.push(format!(
            "(commands up to seq {compared_after_seq} not compared: one of them does not know them)"
        ));
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
        lines.push(bodies.words());
    }
    lines.push(String::new());
    lines.push(sides(one, other, *drift));
    lines.join("\n")
}

/// What a swarm was told where the other was told otherwise.
fn told(command: Option<&past::Told>) -> String {
    command.map_or_else(
        || "nothing more".into(),
        |told| {
            let what = format::command(&told.verb, &told.args);
            format!("{what} at step {} (seq {})", told.step, told.seq)
        },
    )
}

/// Both beside each other, and how much more the second has.
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
    let share = |name: &str, of: fn(&Side) -> Option<f64>| {
        let (one, other) = (of(one), of(other));
        let more = one.zip(other).map(|(one, other)| other - one);
        shares(name, one, other, more)
    };
    let angle = |name: &str, of: fn(&Side) -> Option<f64>| {
        let (one, other) = (of(one), of(other));
        let more = one
            .zip(other)
            .map(|(one, other)| bodies::wrapped(other - one));
        shares(name, one, other, more)
    };
    let drift = match drift {
        Some(Drift {
            direction,
            one,
            other,
        }) => shares(
            &format!("drift along {}", format::time(direction)),
            Some(one),
            Some(other),
            Some(other - one),
        ),
        None => shares("drift", None, None, None),
    };
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

/// A row of numbers, each of which may be missing.
fn shares(name: &str, one: Option<f64>, other: Option<f64>, more: Option<f64>) -> [String; 4] {
    [
        name.into(),
        format::share(one),
        format::share(other),
        format::share(more),
    ]
}

/// Where the group is going, in radians.
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
