//! How little a step takes: a defect of the exact solver shows here, for the residual hides it.

use jostle_physics::model::{Parameters, State};
use jostle_physics::stepper::Stepper;

use crate::{advance, drawn};

/// Steps in contact that are counted.
const COUNTED: usize = 500;

/// What steps of one group took.
struct Work {
    /// Factors a step, on average.
    factors: f64,
    fallback: usize,
    worst: f64,
}

/// Steps a group of `n` from its seed until it pushes, and then counts.
fn counted(n: usize, settling: u64) -> Work {
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
    println!("n = {n}: {pushes} push, {factors:.3} factors a step");
    work
}

/// The exact solver is right by itself: the fallback is for what no ordinary step is.
#[test]
fn ordinary_steps_take_one_factor_and_no_referee() {
    for (n, settling, most) in [
        (20, 500, 1.3),
        (50, 1000, 1.1),
        (120, 1500, 1.1),
        (200, 1500, 1.1),
    ] {
        let work = counted(n, settling);
        assert_eq!(work.fallback, 0, "n = {n}");
        assert!(work.worst <= 1e-9, "n = {n}: {}", work.worst);
        assert!(work.factors <= most, "n = {n}: {} factors", work.factors);
    }
}
