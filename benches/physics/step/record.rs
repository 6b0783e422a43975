//! Records successive steps of a group.

use jostle_physics::model::State;
use jostle_physics::stepper::Stepper;
use jostle_physics::stepper::qp::Qp;
use jostle_physics::stepper::solve::Hints;

use super::phases::Phases;

/// One recorded step: the state before it and its program.
#[derive(Clone, Debug)]
pub struct Recorded {
    /// The state before the step, with its warm start.
    pub state: State,
    /// The attraction of each individual, n rows of x, y.
    pub pull: Vec<[f64; 2]>,
    /// The program of the step.
    pub qp: Qp,
    /// The multipliers guessed from the warm start, one per contact.
    pub guess: Vec<f64>,
}

impl Recorded {
    /// Returns the hints for the solver: the guessed multipliers, and the positions.
    pub fn hints(&self) -> Hints<'_> {
        let configuration = &self.state.configuration;
        Hints {
            multipliers: &self.guess,
            x: &configuration.x,
            y: &configuration.y,
        }
    }
}

/// Records `count` successive steps from `state`.
pub fn record(mut state: State, count: usize) -> Vec<Recorded> {
    let (mut stepper, mut phases) = (Stepper::new(), Phases::default());
    let mut records = Vec::with_capacity(count);
    for _ in 0..count {
        let (qp, guess) = phases.program(&state);
        records.push(Recorded {
            state: state.clone(),
            pull: phases.pull.clone(),
            qp,
            guess,
        });
        stepper.step(&mut state).expect("every step is solved");
    }
    records
}
