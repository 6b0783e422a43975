//! Backends that solve the recorded programs, and the quality of their answers.

use std::f64::consts::TAU;

use clap::ValueEnum;
use jostle_physics::model::simd::Level;
use jostle_physics::model::{State, body};
use jostle_physics::stepper::qp::Qp;
use jostle_physics::stepper::solve;

use super::clarabel;
use super::record::Recorded;

/// A solver of the recorded programs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Backend {
    /// The exact solver, the default of the daemon
    Exact,
    /// The daemon's fallback: Clarabel with scaling and polishing, the reference in tests
    Fallback,
    /// Clarabel without scaling, with default tolerances, set-up included
    Clarabel,
    /// rapier2d in f64: one iteration of 50 sweeps, softness off
    Rapier,
    /// DAQP with a warm start, from its Python wheel: up to 120 individuals
    Daqp,
    /// PIQP, from its Python wheel
    Piqp,
}

impl Backend {
    /// Returns the name on the command line, in the table and in JSON.
    pub fn name(self) -> String {
        let value = self.to_possible_value().expect("no variant is skipped");
        value.get_name().to_owned()
    }
}

/// A solver in this process, with its buffers and its last answer.
pub enum Solver {
    /// One of the daemon's two backends.
    Ours(Box<Ours>),
    /// Clarabel: multipliers and number of iterations of the last program.
    Clarabel(Vec<f64>, usize),
}

/// A backend of the daemon, with its workspace and its last solution.
pub struct Ours {
    backend: solve::Backend,
    workspace: solve::Workspace,
    solution: solve::Solution,
}

impl Solver {
    /// Returns the solver of `backend`; none if the backend runs in another process or does not
    /// solve programs. The daemon's backends use the kernels of `level`.
    pub fn new(backend: Backend, level: Level) -> Option<Self> {
        let ours = |backend| {
            let mut workspace = solve::Workspace::default();
            workspace.exact.level = level;
            Self::Ours(Box::new(Ours {
                backend,
                workspace,
                solution: solve::Solution::default(),
            }))
        };
        match backend {
            Backend::Exact => Some(ours(solve::Backend::Exact)),
            Backend::Fallback => Some(ours(solve::Backend::Fallback)),
            Backend::Clarabel => Some(Self::Clarabel(Vec::new(), 0)),
            Backend::Rapier | Backend::Daqp | Backend::Piqp => None,
        }
    }

    /// Solves one program. The bench measures this call.
    pub fn solve(&mut self, recorded: &Recorded) {
        match self {
            Self::Ours(ours) => {
                let (hints, workspace) = (recorded.hints(), &mut ours.workspace);
                let solution = &mut ours.solution;
                let warm = &recorded.state.warm_start;
                workspace.exact.load_order(&warm.order, warm.order_age);
                solve::solve(ours.backend, &recorded.qp, &hints, workspace, solution);
            }
            Self::Clarabel(multipliers, iterations) => {
                (*multipliers, *iterations) = clarabel::solve(&recorded.qp);
            }
        }
    }

    /// Returns the multipliers of the last program, the number of factored systems, and the number
    /// of calls of a second solver.
    pub fn answer(&self) -> (&[f64], usize, usize) {
        match self {
            Self::Ours(ours) => {
                let Ours {
                    backend, solution, ..
                } = &**ours;
                // The first call of the fallback backend is its regular one.
                let own = usize::from(*backend == solve::Backend::Fallback);
                let fallbacks = solution.fallback.saturating_sub(own);
                (&solution.multipliers, solution.iterations, fallbacks)
            }
            Self::Clarabel(multipliers, iterations) => (multipliers, *iterations, 0),
        }
    }
}

/// Quality of the answers to a series of programs.
#[derive(Clone, Copy, Debug, Default)]
pub struct Quality {
    /// Mean number of contacts that push.
    pub active: f64,
    /// Mean number of iterations, as the backend defines them.
    pub iterations: f64,
    /// Calls of a second solver, in total.
    pub fallbacks: usize,
    /// Largest residual `max |min(λ, s)|` of a step. For a backend without multipliers, the largest
    /// overlap in the linearised gaps.
    pub worst_residual: f64,
    /// Largest overlap after a step, measured by parry.
    pub worst_overlap: f64,
    /// Largest distance of an individual's displacement from the exact one, over dt v0.
    pub worst_velocity_error: f64,
    /// Mean of this distance over all individuals and steps.
    pub mean_velocity_error: f64,
}

impl Quality {
    /// Adds the multipliers of one step; `exact` are its exact displacements.
    pub fn add(&mut self, recorded: &Recorded, multipliers: &[f64], exact: &[[f64; 3]]) {
        let Recorded { state, qp, .. } = recorded;
        let mut displacement = Vec::new();
        let residual = qp.residual(multipliers, &mut displacement);
        self.worst_residual = self.worst_residual.max(residual);
        let pushing = qp.contacts.iter().zip(multipliers);
        self.active += pushing
            .filter(|(contact, multiplier)| **multiplier > contact.linearised_gap(&displacement))
            .count() as f64;
        let mut after = state.configuration.clone();
        for (index, [x, y, alpha]) in displacement.iter().enumerate() {
            after.x[index] += x;
            after.y[index] += y;
            after.alpha[index] += alpha;
        }
        let gap = body::worst_gap(&state.parameters, &after);
        self.worst_overlap = self.worst_overlap.max(-gap.unwrap_or(0.0));
        let pairs = displacement.iter().zip(exact);
        let errors = pairs.map(|(one, other)| [one[0] - other[0], one[1] - other[1]]);
        self.add_errors(errors, state.parameters.dt);
    }

    /// Adds one step from `before` to `after`; `exact` are its exact displacements.
    pub fn add_displacement(&mut self, before: &State, after: &State, exact: &[[f64; 3]], qp: &Qp) {
        let displacement = displacement(before, after);
        for contact in &qp.contacts {
            let overlap = -contact.linearised_gap(&displacement);
            self.worst_residual = self.worst_residual.max(overlap);
        }
        let gap = body::worst_gap(&after.parameters, &after.configuration);
        self.worst_overlap = self.worst_overlap.max(-gap.unwrap_or(0.0));
        let pairs = displacement.iter().zip(exact);
        let errors = pairs.map(|(one, other)| [one[0] - other[0], one[1] - other[1]]);
        self.add_errors(errors, before.parameters.dt);
    }

    fn add_errors(&mut self, errors: impl ExactSizeIterator<Item = [f64; 2]>, dt: f64) {
        let count = errors.len() as f64;
        for [x, y] in errors {
            let error = x.hypot(y) / dt;
            self.worst_velocity_error = self.worst_velocity_error.max(error);
            self.mean_velocity_error += error / count;
        }
    }

    /// Turns sums over `count` steps into means.
    pub fn divide(&mut self, count: usize) {
        let count = count as f64;
        self.active /= count;
        self.iterations /= count;
        self.mean_velocity_error /= count;
    }
}

/// Returns the displacements (x, y, alpha) between two states, whose angles may differ by whole
/// turns.
pub fn displacement(before: &State, after: &State) -> Vec<[f64; 3]> {
    let (from, to) = (&before.configuration, &after.configuration);
    let moved = |i: usize| {
        let turned = to.alpha[i] - from.alpha[i];
        let turns = libm::round(turned / TAU);
        [
            to.x[i] - from.x[i],
            to.y[i] - from.y[i],
            turned - turns * TAU,
        ]
    };
    (0..from.n()).map(moved).collect()
}
