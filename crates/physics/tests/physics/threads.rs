//! Same bytes whatever the threads: they share the work of large groups, and no sum depends on
//! how many they are.

use std::sync::Arc;

use jostle_physics::model::threads::Pool;
use jostle_physics::model::{Attraction, Parameters, State, start};
use jostle_physics::stepper::Stepper;
use rayon::ThreadPoolBuilder;

use crate::{advance, with};

fn shared(threads: usize) -> Stepper {
    let pool = ThreadPoolBuilder::new().num_threads(threads).build();
    Stepper::with_pool(Pool::new(Arc::new(pool.unwrap())))
}

/// Steps `n` drawn in a disc of a radius in roots of n, without a pool and with some.
fn the_same_steps(attraction: Attraction, n: usize, radius: f64, steps: u64) {
    let parameters = Parameters {
        attraction,
        ..Parameters::default()
    };
    let disc = start::disc(&parameters, n, Some(radius * (n as f64).sqrt()), 5).unwrap();
    let start = with(parameters, 5, disc);
    let run = |mut stepper: Stepper| -> State {
        let mut state = start.clone();
        advance(&mut stepper, &mut state, steps);
        state
    };
    let alone = run(Stepper::new());
    let pushing = alone.warm_start.contacts.len();
    assert!(10 * pushing > n, "only {pushing} of {n} push");
    for threads in [1, 2, 4] {
        let hash = run(shared(threads)).hash();
        assert_eq!(hash, alone.hash(), "{n} with {threads} threads");
    }
}

#[test]
fn threads_change_no_bit_of_the_direct_sum_nor_of_contacts() {
    let direct = Attraction::All { accuracy: None };
    the_same_steps(direct, 2000, 0.64, 200);
}

#[test]
fn threads_change_no_bit_of_far_groups_taken_as_a_whole() {
    let accuracy = Some(1e-6);
    the_same_steps(Attraction::All { accuracy }, 20_000, 0.8, 10);
}
