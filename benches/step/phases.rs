//! The phases of a step before it is solved, apart from one another.

use jostled::model::attraction::Social;
use jostled::model::{State, body};
use jostled::stepper::qp::Qp;
use jostled::stepper::{contact, free};

/// Room for the phases; like the stepper's, it is used again and again.
#[derive(Default)]
pub struct Phases {
    social: Social,
    free: free::Free,
    pull: Vec<[f64; 2]>,
    qp: Qp,
    guess: Vec<f64>,
}

impl Phases {
    /// Attraction alone.
    pub fn attraction(&mut self, state: &State) {
        let law = state.parameters.attraction;
        self.social
            .compute(law, &state.configuration, &mut self.pull);
    }

    /// All that a step does before it solves: attraction, trigonometry, neighbours, contacts, and
    /// the guess of their multipliers.
    pub fn assemble(&mut self, state: &State) {
        let State {
            parameters,
            configuration,
            ..
        } = state;
        self.free.compute(parameters, configuration);
        let reach = parameters.reach(configuration.largest_weight());
        let near = body::Body::new(parameters).centre_distance(reach);
        let pairs = body::pairs_within(&configuration.x, &configuration.y, near);
        self.qp.weights = [1.0, 1.0, parameters.rho2()];
        self.qp.free.clone_from(&self.free.displacement);
        self.qp.contacts.clear();
        contact::find(
            parameters,
            configuration,
            &self.free.heading,
            &pairs,
            |_, _| reach,
            &mut self.qp.contacts,
        )
        .expect("no axes cross");
        let id = &configuration.id;
        contact::recall(&state.memory, id, &self.qp.contacts, &mut self.guess);
    }

    /// The program of `state`.
    pub fn program(&mut self, state: &State) -> Qp {
        self.assemble(state);
        self.qp.clone()
    }

    /// The guess for the program assembled last.
    pub fn guess(&self) -> Vec<f64> {
        self.guess.clone()
    }
}
