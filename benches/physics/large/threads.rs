//! Gain of threads: the same group is stepped without and with threads, in alternation.

use std::sync::Arc;
use std::time::Instant;

use jostle_physics::model::State;
use jostle_physics::model::attraction::AttractionWorkspace;
use jostle_physics::model::threads::Pool;
use jostle_physics::stepper::Stepper;
use rayon::ThreadPoolBuilder;

use crate::{Arguments, drawn, milliseconds};

/// Least wall-clock times in ms, without and with threads.
struct Least([f64; 2]);

impl Least {
    fn new() -> Self {
        Self([f64::INFINITY; 2])
    }

    fn measure(&mut self, index: usize, work: impl FnOnce()) {
        let began = Instant::now();
        work();
        self.0[index] = self.0[index].min(milliseconds(began.elapsed()));
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

/// Steps one group without and with threads, compares the hashes at the end, and returns a line of
/// the table.
pub fn measure(n: usize, threads: usize, arguments: &Arguments) -> String {
    let pool = ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = Pool::new(Arc::new(pool.expect("threads can be started")));
    let start = drawn(n, arguments);
    let mut states: [State; 2] = [start.clone(), start];
    let mut steppers = [Stepper::new(), Stepper::with_pool(pool.clone())];
    let mut workspaces = [
        AttractionWorkspace::default(),
        AttractionWorkspace::default(),
    ];
    workspaces[1].pool = Some(pool);
    let (mut attraction, mut step, mut pull) = (Least::new(), Least::new(), Vec::new());
    while states[0].time() < arguments.time {
        for (state, stepper) in states.iter_mut().zip(&mut steppers) {
            stepper.step(state).expect("every step is solved");
        }
    }
    for _ in 0..arguments.steps {
        for (index, state) in states.iter_mut().enumerate() {
            let law = state.parameters.attraction;
            let workspace = &mut workspaces[index];
            attraction.measure(index, || {
                workspace.compute(law, &state.configuration, &mut pull);
            });
            let stepper = &mut steppers[index];
            step.measure(index, || {
                drop(stepper.step(state).expect("every step is solved"));
            });
        }
    }
    assert_eq!(
        states[0].hash(),
        states[1].hash(),
        "threads changed the result"
    );
    format!("{n:>7} {} {}", attraction.text(), step.text())
}
