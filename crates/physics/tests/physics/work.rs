//! Work of a step. A defect of the exact solver does not show in the residual, since the fallback
//! corrects it; it shows in the counts of factorisations and fallbacks.

use jostle_physics::model::{Parameters, State};
use jostle_physics::stepper::Stepper;

use crate::{advance, drawn};

/// Steps in contact that are counted.
const COUNTED: usize = 500;

/// Work of [`COUNTED`] steps of one group.
struct Work {
    /// Mean factorisations per step.
    factors: f64,
    /// Calls of the fallback, in total.
    fallback: usize,
    /// Largest residual.
    worst: f64,
}

/// Steps a group of `n` for `settling` steps, then counts the work of [`COUNTED`] steps.
fn work_of_steps(n: usize, settling: u64) -> Work {
    let mut stepper = Stepper::new();
    let mut state: State = drawn(Parameters::default(), n, 1);
    for index in 0..n / 5 {
        state.configuration.inform(index, 0.5, 0.0, None);
    }
    advance(&mut stepper, &mut state, settling);
    let mut work = Work {
        factors: 0.0,
        fallback: 0,
        worst: 0.0,
    };
    let mut pushes = 0;
    for _ in 0..COUNTED {
        let report = stepper.step(&mut state).unwrap();
        work.factors += report.iterations as f64 / COUNTED as f64;
        work.fallback += report.fallback;
        work.worst = work.worst.max(report.residual);
        pushes += report.active;
    }
    let (pushes, factors) = (pushes / COUNTED, work.factors);
    println!("n = {n}: {pushes} contacts push, {factors:.3} factorisations per step");
    work
}

/// The exact solver solves settled groups without the fallback.
#[test]
fn ordinary_steps_take_one_factorisation_and_no_fallback() {
    for (n, settling, max_factors) in [
        (20, 500, 1.3),
        (50, 1000, 1.1),
        (120, 1500, 1.1),
        (200, 1500, 1.1),
    ] {
        let work = work_of_steps(n, settling);
        assert_eq!(work.fallback, 0, "n = {n}");
        assert!(work.worst <= 1e-9, "n = {n}: {}", work.worst);
        assert!(
            work.factors <= max_factors,
            "n = {n}: {} factorisations",
            work.factors
        );
    }
}
