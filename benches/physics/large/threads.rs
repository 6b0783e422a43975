//! What threads save: the same group stepped without and with them by turns.

use std::sync::Arc;
use std::time::Instant;

use jostle_physics::model::State;
use jostle_physics::model::attraction::AttractionWorkspace;
use jostle_physics::model::threads::Pool;
use jostle_physics::stepper::Stepper;
use rayon::ThreadPoolBuilder;

use crate::{Arguments, drawn, milliseconds};

/// The least wall-clock milliseconds, without and with threads.
struct Least([f64; 2]);

impl Least {
    fn new() -> Self {
        Self([f64::INFINITY; 2])
    }

    fn measure(&mut self, which: usize, work: impl FnOnce()) {
        let began = Instant::now();
        work();
        self.0[which] = self.0[which].min(milliseconds(began.elapsed()));
    }

    fn text(&self) -> String {
        let [alone, shared] = self.0;
        format!("{alone:>10.3} {shared:>10.3} {:>6.2}", alone / shared)
    }
}

pub fn heading() -> String {
    let columns = "     alone    threads  times";
    format!(
        "{:>7} {:>29} {:>29}\n{:>7} {columns:>29} {columns:>29}",
        "", "attraction_ms", "step_ms", "n"
    )
}

/// Steps one group twice, and compares the hashes at the end.
pub fn measure(n: usize, threads: usize, arguments: &Arguments) -> String {
    let pool = ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = Pool::new(Arc::new(pool.expect("threads can be started")));
    let start = drawn(n, arguments);
    let mut states: [State; 2] = [start.clone(), start];
    let mut steppers = [Stepper::new(), Stepper::with_pool(pool.clone())];
    let mut socials = [
        AttractionWorkspace::default(),
        AttractionWorkspace::default(),
    ];
    socials[1].pool = Some(pool);
    let (mut attraction, mut step, mut pull) = (Least::new(), Least::new(), Vec::new());
    while states[0].time() < arguments.time {
        for (state, stepper) in states.iter_mut().zip(&mut steppers) {
            stepper.step(state).expect("every step is solved");
        }
    }
    for _ in 0..arguments.steps {
        for (which, state) in states.iter_mut().enumerate() {
            let kind = state.parameters.attraction;
            let social = &mut socials[which];
            attraction.measure(which, || {
                social.compute(kind, &state.configuration, &mut pull);
            });
            let stepper = &mut steppers[which];
            step.measure(which, || {
                drop(stepper.step(state).expect("every step is solved"));
            });
        }
    }
    assert_eq!(states[0].hash(), states[1].hash(), "threads changed a bit");
    format!("{n:>7} {} {}", attraction.text(), step.text())
}
