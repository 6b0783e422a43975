//! The instructions that measures cost, beside those of a step.

use std::hint::black_box;

use jostle_measures::{Measure, Past, View, definitions};
use jostle_physics::model::State;
use jostle_physics::stepper::Stepper;

use crate::settled::Case;
use crate::{count_instructions, counted_step};

/// The measures that a run evaluates at every step.
const EVERY_STEP: &str = "order,drift,milling";

/// The largest share of a step that they may cost.
const MAX_SHARE: f64 = 0.05;

/// The length over width of the bodies.
const PI1: f64 = 4.0;

/// The sizes of the groups in the table.
const SIZES: [usize; 2] = [50, 1000];

/// The argument of a measure that has no default: a time.
const LAG: &str = "1";

/// Compares the cost of the measures of every step with that of a step of 50 individuals. Returns
/// whether it is within the limit.
pub fn compare(step: u64) -> bool {
    let cost = count(SIZES[0], EVERY_STEP);
    let share = cost as f64 / step as f64;
    let is_ok = share <= MAX_SHARE;
    let verdict = match is_ok {
        true => "ok",
        false => "above 5 %: make the measures cheaper",
    };
    let percent = 100.0 * share;
    println!("{EVERY_STEP}, n = 50: {cost} instructions, {percent:.1} % of a step, {verdict}");
    is_ok
}

/// Prints the table of the costs of all measures.
pub fn print_table() {
    let steps = SIZES.map(|n| count(n, ""));
    println!("| measure | n = 50 | of a step | n = 1,000 | of a step |");
    println!("|---|---|---|---|---|");
    println!("| a step | {} | | {} | |", steps[0], steps[1]);
    let all = definitions().iter().map(|definition| {
        let is_required = |it: jostle_measures::Argument| it.default.is_none();
        match definition.argument.is_some_and(is_required) {
            true => format!("{}({LAG})", definition.name),
            false => definition.name.to_owned(),
        }
    });
    for names in [EVERY_STEP.to_owned()].into_iter().chain(all) {
        let cells = [0, 1].map(|k| {
            let cost = count(SIZES[k], &names);
            let percent = 100.0 * cost as f64 / steps[k] as f64;
            format!("{cost} | {percent:.1} %")
        });
        println!("| {} | {} |", names.replace(',', ", "), cells.join(" | "));
    }
}

/// Counts the instructions of one evaluation of these measures, or of a step if there are none.
fn count(n: usize, names: &str) -> u64 {
    // The child reads the group from its file: to compute it under callgrind takes minutes.
    Case { pi1: PI1, n }.settled();
    let function = match names {
        "" => "counted_step",
        _ => "counted_measures",
    };
    count_instructions(function, &["--measure", &n.to_string(), names], "measures")
}

/// Evaluates measures of a settled group, of which a fifth is informed; or takes a step if there are
/// none.
pub fn run(n: usize, names: &str) {
    let mut state = Case { pi1: PI1, n }.settled();
    let mut stepper = Stepper::new();
    if names.is_empty() {
        counted_step(&mut stepper, &mut state);
        return;
    }
    for index in 0..n / 5 {
        state.configuration.weight[index] = 1.0;
        state.configuration.direction[index] = 0.5;
    }
    let measures = names
        .split(',')
        .map(|name| name.parse().expect("a measure"));
    let measures: Vec<Measure> = measures.collect();
    let dt = state.parameters.dt;
    let lag = measures.iter().map(|measure| measure.lag(dt)).max();
    let lag = lag.expect("there is a measure");
    let mut past = Past::new(lag);
    for _ in 0..lag {
        past.observe(&state);
        stepper.step(&mut state).expect("every step is solved");
    }
    let values = counted_measures(&state, &mut past, lag, &measures);
    assert_eq!(values, measures.len(), "every measure is defined");
}

/// The function that callgrind counts, selected by its name; a closure in it would have this name,
/// too, and callgrind would stop there.
#[inline(never)]
fn counted_measures(state: &State, past: &mut Past, lag: u64, measures: &[Measure]) -> usize {
    evaluate(state, past, lag, measures)
}

/// Does what a run with these measures does after a step. Returns the number of values.
#[inline(never)]
fn evaluate(state: &State, past: &mut Past, lag: u64, measures: &[Measure]) -> usize {
    if lag > 0 {
        past.observe(state);
    }
    let view = View::new(state, past);
    let values = measures
        .iter()
        .filter_map(|measure| measure.evaluate(&view));
    values.filter(|value| black_box(*value).is_finite()).count()
}
