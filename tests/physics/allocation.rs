//! A step like one that has been taken before takes no more memory.

use jostled::model::Parameters;
use jostled::stepper::{Stepper, solve};

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
        let (mut solver, mut solution) = (solve::Workspace::default(), solve::Solution::default());
        // The same steps twice: the first time every buffer grows to what it will ever need.
        for warm in [false, true] {
            state.step = start.step;
            state.configuration.clone_from(&start.configuration);
            let remembered = &mut state.memory.contacts;
            remembered.clear();
            remembered.extend_from_slice(&start.memory.contacts);
            for _ in 0..300 {
                let step = || drop(stepper.step(&mut state).unwrap());
                let mut allocations = allocation_counter::measure(step).count_total;
                let (qp, guess) = stepper.program();
                let solve = || solve::solve(qp, guess, &mut solver, &mut solution);
                // The solver's own, until it has none.
                allocations -= allocation_counter::measure(solve)
                    .count_total
                    .min(allocations);
                assert!(!warm || allocations == 0, "{allocations} in steps of {n}");
            }
        }
    }
}
