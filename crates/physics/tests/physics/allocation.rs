//! A step like one that has been taken before takes no more memory.

use jostle_physics::model::Parameters;
use jostle_physics::stepper::Stepper;

use crate::{advance, drawn};

/// Steps until a drawn group has closed up and pushes: t = 20.
const SETTLING: u64 = 1000;

#[test]
fn a_warm_step_allocates_nothing() {
    for n in [10, 50, 74, 200] {
        let mut state = drawn(Parameters::default(), n, 1);
        state.configuration.inform(1, 0.5, 1.0, None);
        advance(&mut Stepper::new(), &mut state, SETTLING);
        let start = state.clone();
        let mut stepper = Stepper::new();
        // The same steps twice: the first time every buffer grows to what it will ever need.
        for warm in [false, true] {
            state.step = start.step;
            state.configuration.clone_from(&start.configuration);
            let (memory, before) = (&mut state.warm_start, &start.warm_start);
            memory.contacts.clone_from(&before.contacts);
            memory.order.clone_from(&before.order);
            memory.order_age = before.order_age;
            for _ in 0..300 {
                let step = || drop(stepper.step(&mut state).unwrap());
                let allocations = allocation_counter::measure(step).count_total;
                assert!(!warm || allocations == 0, "{allocations} in steps of {n}");
            }
        }
    }
}
