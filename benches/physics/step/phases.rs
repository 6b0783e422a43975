//! The phases of a step before the solution, each callable by itself.

use jostle_physics::model::State;
use jostle_physics::model::attraction::AttractionWorkspace;
use jostle_physics::model::simd::Level;
use jostle_physics::stepper::Stepper;
use jostle_physics::stepper::qp::Qp;

/// The phases and their buffers, which are reused like those of the stepper.
#[derive(Default)]
pub struct Phases {
    attraction: AttractionWorkspace,
    stepper: Stepper,
    /// The last computed attraction, n rows of x, y.
    pub pull: Vec<[f64; 2]>,
}

impl Phases {
    /// Returns the phases with kernels of one SIMD level.
    pub fn at(level: Level) -> Self {
        let mut phases = Self {
            stepper: Stepper::with_level(level),
            ..Self::default()
        };
        phases.attraction.level = level;
        phases
    }

    /// Computes the attraction.
    pub fn attraction(&mut self, state: &State) {
        let law = state.parameters.attraction;
        self.attraction
            .compute(law, &state.configuration, &mut self.pull);
    }

    /// Assembles the program, given the attraction: trigonometry, neighbours, contacts, and the
    /// guess of their multipliers.
    pub fn assemble(&mut self, state: &State, pull: &[[f64; 2]]) {
        self.stepper.assemble(state, pull).expect("no axes cross");
    }

    /// Returns the program of `state` and the guess of its multipliers.
    pub fn program(&mut self, state: &State) -> (Qp, Vec<f64>) {
        self.attraction(state);
        let pull = std::mem::take(&mut self.pull);
        self.assemble(state, &pull);
        self.pull = pull;
        let (qp, guess) = self.stepper.program();
        (qp.clone(), guess.to_vec())
    }
}
