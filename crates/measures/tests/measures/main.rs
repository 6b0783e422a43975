//! All measures on states of simulations: against plain computations, under changes that no measure
//! depends on, and on degenerate groups.

#![expect(clippy::unwrap_used, reason = "tests")]

mod brute_force;
mod degenerate;
mod fixture;
mod invariance;

use jostle_measures::{Measure, Past, View, definitions};
use jostle_physics::model::State;
use jostle_physics::model::selection::Selection;
use jostle_physics::simulation::{Change, Simulation, Spec};

/// Returns all measures, those with an argument also with another one.
fn measures() -> Vec<Measure> {
    let texts = definitions().iter().flat_map(|definition| {
        let name = definition.name;
        match definition.argument {
            Some(argument) if argument.default.is_some() => {
                vec![name.to_owned(), format!("{name}(0.3)")]
            }
            Some(_) => vec![format!("{name}(0.02)"), format!("{name}(0.5)")],
            None => vec![name.to_owned()],
        }
    });
    texts.map(|text| text.parse().unwrap()).collect()
}

/// The states of a simulation with informed individuals, after 0 to 50 steps.
fn states(n: usize, pi1: f64, seed: u64) -> Vec<State> {
    let mut spec = Spec::new(n, seed);
    spec.parameters.pi1 = pi1;
    let mut simulation = Simulation::new(&spec).unwrap();
    let informed = Change::inform(Selection::Count(n.div_ceil(4)), 0.7);
    simulation.apply(&informed).unwrap();
    let mut states = vec![simulation.state.clone()];
    for _ in 0..50 {
        simulation.step().unwrap();
        states.push(simulation.state.clone());
    }
    states
}

/// Evaluates a measure on the last of some states.
fn value(measure: &Measure, states: &[State]) -> Option<f64> {
    let last = states.last().unwrap();
    let mut past = Past::new(measure.lag(last.parameters.dt));
    states.iter().for_each(|state| past.observe(state));
    measure.evaluate(&View::new(last, &past))
}
