//! What went wrong in a swarm that has faulted.

use std::panic::{AssertUnwindSafe, catch_unwind};

use jostle_physics::model::State;
use jostle_physics::model::body::{Body, pose};
use jostle_physics::simulation::Simulation;
use jostle_physics::stepper::StepError;

/// Why a step failed, and for which individuals.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// What went wrong.
    pub kind: FaultKind,
    /// The individuals that it is about.
    pub ids: Vec<u32>,
    /// The gap between the two that cross, in the last good state, body sizes.
    pub gap: Option<f64>,
}

/// What went wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FaultKind {
    /// Two bodies crossed.
    CrossedBodies,
    /// The program was not solved.
    NotSolved,
    /// An individual turned too far.
    Overturned,
    /// A position is no finite number.
    NotFinite,
    /// The step does not fail.
    Other,
}

impl FaultKind {
    /// Its name on the wire.
    pub fn name(self) -> &'static str {
        match self {
            FaultKind::CrossedBodies => "crossed_bodies",
            FaultKind::NotSolved => "not_solved",
            FaultKind::Overturned => "overturned",
            FaultKind::NotFinite => "not_finite",
            FaultKind::Other => "other",
        }
    }
}

impl Fault {
    /// Of which the steps say nothing.
    pub const OTHER: Fault = Fault {
        kind: FaultKind::Other,
        ids: Vec::new(),
        gap: None,
    };

    /// The fault of a swarm that keeps its last good state: a copy takes the step again, which fails in the
    /// same way. So a fault is known after a restart, also one that an earlier version stored.
    pub fn of(simulation: &Simulation, reason: &str) -> Self {
        let again = catch_unwind(AssertUnwindSafe(|| {
            let checkpoint = simulation.checkpoint();
            Simulation::from_checkpoint(&checkpoint, Box::new(|_| Ok(()))).step()
        }));
        match again {
            Ok(Err(error)) if error.to_string() == reason => {
                Fault::of_step(&error, &simulation.state)
            }
            _ => Fault::OTHER,
        }
    }

    fn of_step(error: &StepError, state: &State) -> Self {
        let (kind, ids) = match *error {
            StepError::CrossedBodies { first, second } => {
                (FaultKind::CrossedBodies, vec![first, second])
            }
            StepError::NotSolved { .. } => (FaultKind::NotSolved, Vec::new()),
            StepError::Overturned { id, .. } => (FaultKind::Overturned, vec![id]),
            StepError::NotFinite { id } => (FaultKind::NotFinite, vec![id]),
            StepError::Parameters(_) => (FaultKind::Other, Vec::new()),
        };
        let gap = match ids[..] {
            [first, second] => gap(state, first, second),
            _ => None,
        };
        Fault { kind, ids, gap }
    }
}

/// The gap between two individuals, body sizes.
fn gap(state: &State, first: u32, second: u32) -> Option<f64> {
    let configuration = &state.configuration;
    let pose = |id| {
        let index = configuration.id.iter().position(|it| *it == id)?;
        Some(pose(configuration, index))
    };
    let body = Body::new(&state.parameters);
    Some(body.nearness(pose(first)?, pose(second)?).gap)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use jostle_physics::model::body;
    use jostle_physics::simulation::Spec;

    use super::*;

    #[test]
    fn each_error_of_a_step_has_its_kind_and_its_individuals() {
        let simulation = Simulation::new(&Spec::new(3, 1)).unwrap();
        let state = &simulation.state;
        let fault = |error| Fault::of_step(&error, state);
        let crossed = fault(StepError::CrossedBodies {
            first: 2,
            second: 0,
        });
        assert_eq!(
            (crossed.kind.name(), crossed.ids),
            ("crossed_bodies", vec![2, 0])
        );
        let worst = body::worst_gap(&state.parameters, &state.configuration);
        assert!(crossed.gap.unwrap() >= worst.unwrap_or(f64::NEG_INFINITY));
        let (exponent, turn) = (4.0, 2.0);
        for (error, name, ids) in [
            (StepError::NotSolved { residual: 1.0 }, "not_solved", vec![]),
            (
                StepError::Overturned {
                    exponent,
                    id: 1,
                    turn,
                },
                "overturned",
                vec![1],
            ),
            (StepError::NotFinite { id: 2 }, "not_finite", vec![2]),
        ] {
            let fault = fault(error);
            assert_eq!((fault.kind.name(), fault.ids, fault.gap), (name, ids, None));
        }
        // The step does not fail.
        assert_eq!(Fault::of(&simulation, "a line is damaged"), Fault::OTHER);
    }
}
