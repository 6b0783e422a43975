//! Tests of the physics: exact cases, invariants of the model, reproducibility, and a claim of the
//! paper.
#![expect(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a test with a wrong number fails and reports the line"
)]
// The walls of the crate are for its library.
#![expect(
    clippy::disallowed_methods,
    reason = "tests read cases and start threads"
)]

mod adversarial;
mod allocation;
mod cases;
mod claim;
mod closed_form;
mod exact;
mod facts;
mod reference;
mod repeat;
mod threads;
mod work;

use jostle_physics::model::simd::Level;
use jostle_physics::model::{Configuration, Parameters, State, start};
use jostle_physics::stepper::qp::Qp;
use jostle_physics::stepper::{Stepper, contact, free};

/// Returns a state of `n` individuals drawn in the default disc.
fn drawn(parameters: Parameters, n: usize, seed: u64) -> State {
    let configuration = start::disc(&parameters, n, None, seed).unwrap();
    with(parameters, seed, configuration)
}

fn with(parameters: Parameters, seed: u64, configuration: Configuration) -> State {
    State {
        parameters,
        seed,
        configuration,
        ..State::default()
    }
}

fn advance(stepper: &mut Stepper, state: &mut State, steps: u64) {
    for _ in 0..steps {
        stepper.step(state).unwrap();
    }
}

/// Returns the quadratic program of one step with all contacts whose gap is at most `reach`. All
/// pairs are examined.
fn program(state: &State, reach: f64) -> Qp {
    let State {
        parameters,
        configuration,
        ..
    } = state;
    let mut free = free::Free::default();
    free.compute(parameters, configuration);
    let n = u32::try_from(configuration.n()).unwrap();
    let pairs: Vec<(u32, u32)> = (0..n)
        .flat_map(|i| (i + 1..n).map(move |j| (i, j)))
        .collect();
    let mut contacts = Vec::new();
    contact::find(
        Level::default(),
        parameters,
        configuration,
        &free.heading,
        &pairs,
        |_, _| reach,
        &mut contacts,
    )
    .unwrap();
    Qp {
        weights: [1.0, 1.0, parameters.rho2()],
        free: free.displacement,
        contacts,
    }
}
