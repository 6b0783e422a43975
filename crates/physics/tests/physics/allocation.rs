//! Allocations of a step: repeating a sequence of steps allocates nothing.

use jostle_physics::model::Parameters;
use jostle_physics::stepper::Stepper;

use crate::{advance, drawn};

/// Steps until a drawn group is packed and in contact: t = 20.
const SETTLING: u64 = 1000;

#[test]
fn a_warm_step_allocates_nothing() {
    for n in [10, 50, 74, 200] {
        let mut state = drawn(Parameters::default(), n, 1);
        state.configuration.inform(1, 0.5, 1.0, None);
        advance(&mut Stepper::new(), &mut state, SETTLING);
        let start = state.clone();
        let mut stepper = Stepper::new();
        // The same steps twice: in the first pass every buffer grows to its final size.
        for warm in [false, true] {
            state.step = start.step;
            state.configuration.clone_from(&start.configuration);
            let (now, before) = (&mut state.warm_start, &start.warm_start);
            now.contacts.clone_from(&before.contacts);
            now.order.clone_from(&before.order);
            now.order_age = before.order_age;
            for _ in 0..300 {
                let step = || drop(stepper.step(&mut state).unwrap());
                let allocations = allocation_counter::measure(step).count_total;
                assert!(
                    !warm || allocations == 0,
                    "n = {n}: {allocations} allocations"
                );
            }
        }
    }
}
