//! The phases of a step before it is solved, apart from one another.

use jostle_physics::model::State;
use jostle_physics::model::attraction::AttractionWorkspace;
use jostle_physics::model::simd::Level;
use jostle_physics::stepper::Stepper;
use jostle_physics::stepper::qp::Qp;

/// Room for the phases; like the stepper's, it is used again and again.
#[derive(Default)]
pub struct Phases {
    social: AttractionWorkspace,
    stepper: Stepper,
    /// What attraction came to last.
    pub pull: Vec<[f64; 2]>,
}

impl Phases {
    /// The phases with one version of our kernels.
    pub fn at(level: Level) -> Self {
        let mut phases = Self {
            stepper: Stepper::with_level(level),
            ..Self::default()
        };
        phases.social.level = level;
        phases
    }

    /// Attraction alone.
    pub fn attraction(&mut self, state: &State) {
        let law = state.parameters.attraction;
        self.social
            .compute(law, &state.configuration, &mut self.pull);
    }

    /// All that a step does before it solves, the attraction being known: trigonometry,
    /// neighbours, contacts, and the guess of their multipliers.
    pub fn assemble(&mut self, state: &State, pull: &[[f64; 2]]) {
        self.stepper.assemble(state, pull).expect("no axes cross");
    }

    /// The program of `state`, and the guess of its multipliers.
    pub fn program(&mut self, state: &State) -> (Qp, Vec<f64>) {
        self.attraction(state);
        let pull = std::mem::take(&mut self.pull);
        self.assemble(state, &pull);
        self.pull = pull;
        let (qp, guess) = self.stepper.program();
        (qp.clone(), guess.to_vec())
    }
}
