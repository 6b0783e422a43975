//! Who solves the recorded programs, and how good the answers are.

use std::f64::consts::TAU;

use clap::ValueEnum;
use jostle_physics::model::simd::Level;
use jostle_physics::model::{State, body};
use jostle_physics::stepper::qp::Qp;
use jostle_physics::stepper::solve;

use super::clarabel;
use super::record::Recorded;

/// Who solves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Backend {
    /// Ours, the default of the daemon
    Exact,
    /// Clarabel scaled and polished by us: the judge in tests
    Fallback,
    /// Clarabel as it comes: unscaled, default tolerance, set-up included
    Clarabel,
    /// rapier2d in f64: one iteration of 50 sweeps, softness off
    Rapier,
    /// DAQP, warm, through its Python wheel: up to 120 individuals
    Daqp,
    /// PIQP through its Python wheel
    Piqp,
}

impl Backend {
    /// The name on the command line, in the table and in JSON.
    pub fn name(self) -> String {
        let value = self.to_possible_value().expect("none is skipped");
        value.get_name().to_owned()
    }
}

/// A solver in this process, with its room.
pub enum Solver {
    /// One of the daemon's two backends.
    Ours(Box<Ours>),
    /// The multipliers of the last program.
    Clarabel(Vec<f64>, usize),
}

/// A backend of the daemon, with what it keeps.
pub struct Ours {
    backend: solve::Backend,
    workspace: solve::Workspace,
    solution: solve::Solution,
}

impl Solver {
    /// The solver of `backend`, if it lives in this process and solves programs; ours with the
    /// kernels of `level`.
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

    /// Solves one program; this is what is timed.
    pub fn solve(&mut self, recorded: &Recorded) {
        match self {
            Self::Ours(ours) => {
                let (hints, workspace) = (recorded.hints(), &mut ours.workspace);
                let solution = &mut ours.solution;
                let memory = &recorded.state.warm_start;
                workspace.exact.recall(&memory.order, memory.order_age);
                solve::solve(ours.backend, &recorded.qp, &hints, workspace, solution);
            }
            Self::Clarabel(multipliers, iterations) => {
                (*multipliers, *iterations) = clarabel::solve(&recorded.qp);
            }
        }
    }

    /// The last program's multipliers, systems factored, and calls of a second solver.
    pub fn answer(&self) -> (&[f64], usize, usize) {
        match self {
            Self::Ours(ours) => {
                let Ours {
                    backend, solution, ..
                } = &**ours;
                // The fallback's own first call is no fallback.
                let own = usize::from(*backend == solve::Backend::Fallback);
                let fallbacks = solution.fallback.saturating_sub(own);
                (&solution.multipliers, solution.iterations, fallbacks)
            }
            Self::Clarabel(multipliers, iterations) => (multipliers, *iterations, 0),
        }
    }
}

/// How good the answers to a series of programs are.
#[derive(Clone, Copy, Debug, Default)]
pub struct Quality {
    /// Mean number of contacts that push.
    pub active: f64,
    /// Mean number of iterations, in the backend's own sense.
    pub iterations: f64,
    /// How often a second solver was asked, in all.
    pub fallbacks: usize,
    /// Largest `max |min(λ, s)|` of a step; of displacements without multipliers, the largest
    /// overlap they leave in the linearised gaps.
    pub worst_residual: f64,
    /// Deepest overlap after a step, measured by parry.
    pub worst_overlap: f64,
    /// Largest distance of an individual's step from the exact one, over dt v0.
    pub worst_velocity_error: f64,
    /// The mean of the same over all individuals and steps.
    pub mean_velocity_error: f64,
}

impl Quality {
    /// Adds one step's multipliers; `exact` are its true displacements.
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

    /// Adds one step that went from `before` to `after` where `exact` are the true displacements.
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

/// How far everybody moved and turned, where angles may have been wrapped on the way.
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
