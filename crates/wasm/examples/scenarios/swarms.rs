//! Random swarms with commands, and swarms of many individuals.

use jostle_measures::Measure;
use serde_json::{Value, json};

use crate::numbers::Numbers;
use crate::scenario::Scenario;

/// Returns a random swarm and, for one in three, the swarm that continues it from a snapshot.
pub fn random(set: &str, seed: u64) -> Vec<Scenario> {
    let mut numbers = Numbers::new(set, seed);
    let n = size(&mut numbers, 200);
    let mut first = Scenario::new(&json!({"create": {"spec": spec(&mut numbers, n, seed)}}));
    let slice = 10 + numbers.below(91);
    let slices = 2 + numbers.below(if n > 100 { 6 } else { 16 });
    let continues = numbers.chance(3).then_some(slices / 2);
    let mut scenarios = Vec::new();
    for done in 0..slices {
        if Some(done) == continues {
            let continued = first.continued();
            scenarios.push(std::mem::replace(&mut first, continued));
        }
        for _ in 0..numbers.below(2) {
            let request = command(&mut numbers, first.ids());
            first.send(&request);
        }
        first.step(slice, slice);
        if numbers.chance(2) {
            first.send(&measures(&mut numbers));
        }
    }
    scenarios.push(first);
    scenarios
}

/// Returns groups of 500 to 2,000 individuals.
pub fn several_hundred() -> impl Iterator<Item = Scenario> {
    let sizes = [500, 700, 1000, 2000];
    sizes.into_iter().zip(0..).map(|(n, seed)| {
        let mut numbers = Numbers::new("several hundred", seed);
        let mut scenario = Scenario::new(&json!({"create": {"spec": spec(&mut numbers, n, seed)}}));
        scenario.step(40, 10);
        let request = command(&mut numbers, scenario.ids());
        scenario.send(&request);
        scenario.step(20, 10);
        scenario.send(&measures(&mut numbers));
        scenario
    })
}

/// Returns a group of 10,000 individuals.
pub fn of_ten_thousand() -> Scenario {
    let spec = json!({"n": 10_000, "seed": 1, "attraction": {"kind": "all", "accuracy": 1e-6}});
    let mut scenario = Scenario::new(&json!({"create": {"spec": spec}}));
    scenario.step(20, 5);
    scenario
}

/// Returns a size from 2 to `largest`, small ones as often as large ones.
fn size(numbers: &mut Numbers, largest: u64) -> u64 {
    let least = 2 << numbers.below(7);
    (least + numbers.below(least)).min(largest)
}

fn spec(numbers: &mut Numbers, n: u64, seed: u64) -> Value {
    let pi1 = if numbers.chance(6) {
        1.0
    } else {
        numbers.within(1.0, 8.0)
    };
    let contacts = contacts(numbers);
    let stepping = if numbers.chance(2) {
        "position"
    } else {
        "velocity"
    };
    let relinearise = u64::from(stepping == "position" && numbers.chance(3));
    let noise = if numbers.chance(2) {
        0.0
    } else {
        numbers.within(0.0, 0.5)
    };
    json!({
        "n": n,
        "pi1": pi1,
        "pi2": numbers.within(0.1, 2.0),
        "pi3": numbers.within(0.2, 4.0),
        "pi4": numbers.within(1.0, 30.0),
        "dt": numbers.within(0.005, 0.03),
        "contacts": contacts,
        "stepping": stepping,
        "relinearise": relinearise,
        "seed": seed,
        "attraction": attraction(numbers),
        "noise": noise,
    })
}

fn contacts(numbers: &mut Numbers) -> &'static str {
    match numbers.below(3) {
        0 => "endpoints",
        1 => "closest",
        _ => "clamped",
    }
}

fn attraction(numbers: &mut Numbers) -> Value {
    match numbers.below(7) {
        0 | 1 => json!({"kind": "all"}),
        2 => json!({"kind": "all", "accuracy": 1e-4}),
        3 => json!({"kind": "voronoi"}),
        4 => json!({"kind": "metric", "radius": numbers.within(2.0, 12.0)}),
        5 => json!({"kind": "topological", "neighbours": 1 + numbers.below(9)}),
        _ => json!({"kind": "power", "exponent": numbers.within(-3.0, 3.0)}),
    }
}

/// Returns a command. Some are rejected, as selections of more individuals than there are.
fn command(numbers: &mut Numbers, ids: &[u32]) -> Value {
    let angle = numbers.within(-4.0, 4.0);
    let change =
        |verb: &str, args: Value| json!({"apply": {"change": {"verb": verb, "args": args}}});
    match numbers.below(9) {
        0 | 1 => change(
            "inform",
            json!({"select": select(numbers, ids), "direction": angle}),
        ),
        2 => change(
            "inform",
            json!({
                "select": select(numbers, ids),
                "direction": angle,
                "weight": numbers.within(0.01, 3.0),
                "for_time": numbers.within(0.1, 3.0),
            }),
        ),
        3 => change("uninform", json!({"select": select(numbers, ids)})),
        4 => change(
            "inject",
            json!({"count": 1 + numbers.below(5), "direction": angle}),
        ),
        5 => {
            let within = json!({"x": angle, "y": 0.0, "radius": numbers.within(1.0, 20.0)});
            change(
                "inject",
                json!({"count": 1 + numbers.below(3), "within": within}),
            )
        }
        6 => change("remove", json!({"select": select(numbers, ids)})),
        7 => change("set", setting(numbers)),
        _ => steer(numbers, ids),
    }
}

fn select(numbers: &mut Numbers, ids: &[u32]) -> Value {
    match numbers.below(7) {
        0 => json!({"ids": some(numbers, ids)}),
        1 => json!({"count": numbers.below(6)}),
        2 | 3 => json!({"fraction": numbers.within(0.0, 0.6)}),
        4 => json!({"within": {"x": 0.0, "y": numbers.within(-5.0, 5.0), "radius": 4.0}}),
        5 => json!({"informed": numbers.chance(2)}),
        _ => json!({"foremost": {"count": numbers.below(5), "along": numbers.within(-3.0, 3.0)}}),
    }
}

/// Returns some of the ids, in their order; once in a while also one that there is not.
fn some(numbers: &mut Numbers, ids: &[u32]) -> Vec<u32> {
    let mut chosen: Vec<u32> = ids.iter().copied().filter(|_| numbers.chance(4)).collect();
    if numbers.chance(10) {
        chosen.push(u32::MAX);
    }
    chosen
}

fn setting(numbers: &mut Numbers) -> Value {
    match numbers.below(8) {
        0 => json!({"pi1": numbers.within(1.0, 8.0), "make_room": true}),
        1 => json!({"pi1": numbers.within(1.0, 4.0)}),
        2 => json!({"pi3": numbers.within(0.2, 4.0), "pi4": numbers.within(1.0, 40.0)}),
        3 => json!({"noise": numbers.within(0.0, 1.0)}),
        4 => json!({"contacts": contacts(numbers)}),
        5 => json!({"stepping": "position", "relinearise": numbers.below(2)}),
        6 => json!({"attraction": attraction(numbers)}),
        _ => json!({"pi2": numbers.within(0.0, 2.0)}),
    }
}

fn steer(numbers: &mut Numbers, ids: &[u32]) -> Value {
    let ids = some(numbers, ids);
    let mut column =
        |from, to| -> Vec<f64> { ids.iter().map(|_| numbers.within(from, to)).collect() };
    let direction = column(-3.0, 3.0);
    let weight = column(0.0, 2.0);
    let rates = column(-2.0, 2.0);
    let speeds = column(0.0, 1.0);
    let some_of = |column: Vec<f64>, numbers: &mut Numbers| -> Vec<Option<f64>> {
        column
            .into_iter()
            .map(|it| (!numbers.chance(3)).then_some(it))
            .collect()
    };
    match numbers.below(3) {
        0 => json!({"steer": {"ids": ids, "direction": direction}}),
        1 => json!({"steer": {"ids": ids, "direction": direction, "weight": weight}}),
        _ => {
            let turn = some_of(rates, numbers);
            let speed = some_of(speeds, numbers);
            json!({"steer": {"ids": ids, "direction": direction, "weight": weight, "turn": turn, "speed": speed}})
        }
    }
}

/// Returns a request for all measures of one state, or for one with an argument.
fn measures(numbers: &mut Numbers) -> Value {
    let names: Vec<String> = match numbers.below(4) {
        0 => vec![
            "order".to_owned(),
            format!("contacts_per_body({})", numbers.within(0.01, 1.0)),
        ],
        _ => Measure::all_of_one_state()
            .iter()
            .map(ToString::to_string)
            .collect(),
    };
    json!({"measures": {"measures": names}})
}
