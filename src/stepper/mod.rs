//! One step: free motion, contacts, one convex program, the new configuration.
//!
//! P. L. Várkonyi, *Communication and collective consensus making in animal groups via
//! mechanical interactions*, J. Nonlinear Sci. 21 (2011) 387-401: eqs. (1)-(7) and the appendix,
//! referred to below as "the paper". A step is a function of the state alone. The workspace only
//! saves allocations.

pub mod contact;
pub mod free;
pub mod qp;
pub mod solve;

use thiserror::Error;

use crate::model::{Remembered, State, body};
use contact::Contact;
use qp::Qp;

/// How often contacts may be listed again in one step. Every time at least one is added, and
/// hardly any step needs a second list.
const MOST_LISTS: usize = 20;

/// Advances states, and keeps its memory between steps.
#[derive(Debug, Default)]
pub struct Stepper {
    free: free::Free,
    qp: Qp,
    guess: Vec<f64>,
    solution: solve::Solution,
    solver: solve::Workspace,
    travel: Vec<f64>,
    backend: solve::Backend,
}

/// What a step was like.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepReport {
    /// How exactly the step was solved: `max |min(λ, s)|` over its contacts.
    pub residual: f64,
    /// Whether the residual missed its target, yet was good enough to go on.
    pub degraded: bool,
    /// How many contacts were listed.
    pub contacts: usize,
    /// How many of them pushed.
    pub active: usize,
    /// How many linear systems were factored, inside Clarabel too.
    pub iterations: usize,
    /// How often Clarabel was asked.
    pub referee: usize,
    /// Who became uninformed at the end of the step.
    pub lapsed: Vec<u32>,
}

/// Why a step could not be taken.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum StepError {
    /// Two axes cross, or would after the step: no normal pushes them apart.
    #[error(
        "the bodies of individuals {first} and {second} cross: a shorter dt or a smaller pi4 avoids it"
    )]
    CrossedBodies {
        /// Id of the first.
        first: u32,
        /// Id of the second.
        second: u32,
    },
    /// No solution was exact enough.
    #[error("the step is only solved to {residual}")]
    NotSolved {
        /// The best residual reached; infinite if there was none.
        residual: f64,
    },
    /// A position or angle is not a finite number, or would not be after the step.
    #[error("the position of individual {id} is not a finite number")]
    NotFinite {
        /// Who.
        id: u32,
    },
}

impl Stepper {
    /// Creates an empty workspace.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Creates an empty workspace that solves by `backend`.
    #[must_use]
    pub fn with_backend(backend: solve::Backend) -> Self {
        Self {
            backend,
            ..Self::default()
        }
    }

    /// Advances `state` by one step.
    ///
    /// - Source: paper, Principle 1, and the four parts of a step at the end of its appendix.
    ///
    /// # Errors
    ///
    /// [`StepError`]; the state is then as it was.
    pub fn step(&mut self, state: &mut State) -> Result<StepReport, StepError> {
        let pairs = self.assemble(state)?;
        let mut report = self.solve(state, pairs)?;
        let configuration = &mut state.configuration;
        for (index, displacement) in self.solution.displacement.iter().enumerate() {
            configuration.x[index] += displacement[0];
            configuration.y[index] += displacement[1];
            configuration.alpha[index] += displacement[2];
        }
        configuration.re_centre();
        state.step += 1;
        for index in 0..configuration.n() {
            if configuration.lapses_at[index].is_some_and(|step| step <= state.step) {
                configuration.uninform(index);
                report.lapsed.push(configuration.id[index]);
            }
        }
        self.remember(state);
        Ok(report)
    }

    /// Returns the program of `state`'s next step, and the guess it is solved from.
    ///
    /// # Errors
    ///
    /// [`StepError`] as for a step.
    pub fn program(&mut self, state: &State) -> Result<(Qp, Vec<f64>), StepError> {
        self.assemble(state)?;
        contact::recall(
            &state.memory,
            &state.configuration.id,
            &self.qp.contacts,
            &mut self.guess,
        );
        Ok((self.qp.clone(), self.guess.clone()))
    }

    /// Assembles the program of one step; returns the pairs that were looked at.
    fn assemble(&mut self, state: &State) -> Result<Vec<(u32, u32)>, StepError> {
        let State {
            parameters,
            configuration,
            ..
        } = state;
        for index in 0..configuration.n() {
            let sum = configuration.x[index] + configuration.y[index] + configuration.alpha[index];
            if !sum.is_finite() {
                return Err(StepError::NotFinite {
                    id: configuration.id[index],
                });
            }
        }
        self.free.compute(parameters, configuration);
        let reach = parameters.reach(configuration.largest_weight());
        let near = body::Body::new(parameters).centre_distance(reach);
        let pairs = body::pairs_within(&configuration.x, &configuration.y, near);
        self.qp.weights = [1.0, 1.0, parameters.rho2()];
        self.qp.free.clone_from(&self.free.displacement);
        self.qp.contacts.clear();
        let reach_of = |_, _| reach;
        contact::find(
            parameters,
            configuration,
            &self.free.heading,
            &pairs,
            reach_of,
            &mut self.qp.contacts,
        )?;
        Ok(pairs)
    }

    /// Solves the program, lists what the solution could have closed, and solves again until
    /// nothing was missed.
    fn solve(
        &mut self,
        state: &State,
        mut pairs: Vec<(u32, u32)>,
    ) -> Result<StepReport, StepError> {
        let State {
            configuration,
            memory,
            ..
        } = state;
        let mut report = StepReport::default();
        contact::recall(
            memory,
            &configuration.id,
            &self.qp.contacts,
            &mut self.guess,
        );
        let crate::model::SolverMemory {
            order, order_age, ..
        } = memory;
        let order_age = *order_age;
        for _ in 0..MOST_LISTS {
            let hints = solve::Hints {
                multipliers: &self.guess,
                order,
                order_age,
                x: &configuration.x,
                y: &configuration.y,
            };
            let (solver, solution) = (&mut self.solver, &mut self.solution);
            solve::solve(self.backend, &self.qp, &hints, solver, solution);
            let solution = &self.solution;
            report.iterations += solution.iterations;
            report.referee += solution.referee;
            if solution.residual.is_nan() || solution.residual > solve::ACCEPTABLE {
                return Err(StepError::NotSolved {
                    residual: solution.residual,
                });
            }
            let missed = self.missed(state, &mut pairs)?;
            if missed.is_empty() {
                report.residual = self.solution.residual;
                report.degraded = self.solution.residual > solve::TARGET;
                report.contacts = self.qp.contacts.len();
                report.active = self
                    .solution
                    .multipliers
                    .iter()
                    .filter(|&&value| value > 0.0)
                    .count();
                self.check_result(state, &pairs)?;
                return Ok(report);
            }
            self.add(missed);
        }
        Err(StepError::NotSolved {
            residual: f64::INFINITY,
        })
    }

    /// Finds the contacts not listed that the displacements close in the linearised gap.
    fn missed(
        &mut self,
        state: &State,
        pairs: &mut Vec<(u32, u32)>,
    ) -> Result<Vec<Contact>, StepError> {
        let State {
            parameters,
            configuration,
            ..
        } = state;
        let (h, displacement) = (parameters.half_length(), &self.solution.displacement);
        self.travel.clear();
        self.travel.extend(
            displacement
                .iter()
                .map(|[x, y, alpha]| (x * x + y * y).sqrt() + h * alpha.abs()),
        );
        let (furthest, second) = two_largest(&self.travel);
        let reach = parameters.reach(configuration.largest_weight());
        if furthest + second <= reach {
            return Ok(Vec::new());
        }
        let near = body::Body::new(parameters).centre_distance(furthest + second);
        *pairs = body::pairs_within(&configuration.x, &configuration.y, near);
        let travel = &self.travel;
        let closing = |i: usize, j: usize| travel[i] + travel[j];
        let mut reachable = Vec::new();
        contact::find(
            parameters,
            configuration,
            &self.free.heading,
            pairs,
            closing,
            &mut reachable,
        )?;
        let listed = &self.qp.contacts;
        reachable.retain(|contact| {
            listed
                .binary_search_by_key(&contact.key(), Contact::key)
                .is_err()
                && contact.linearised_gap(displacement) < 0.0
        });
        Ok(reachable)
    }

    /// Lists more contacts; the multipliers found so far are the guess for the next solution.
    fn add(&mut self, missed: Vec<Contact>) {
        let old = self
            .qp
            .contacts
            .drain(..)
            .zip(self.solution.multipliers.drain(..));
        let mut all: Vec<(Contact, f64)> = old
            .chain(missed.into_iter().map(|contact| (contact, 0.0)))
            .collect();
        all.sort_by_key(|(contact, _)| contact.key());
        (self.qp.contacts, self.guess) = all.into_iter().unzip();
    }

    /// Refuses a result that is not finite, or in which axes cross.
    fn check_result(&self, state: &State, pairs: &[(u32, u32)]) -> Result<(), StepError> {
        let State {
            parameters,
            configuration,
            ..
        } = state;
        let after = |index: usize| {
            let [x, y, alpha] = self.solution.displacement[index];
            let (sin, cos) = libm::sincos(configuration.alpha[index] + alpha);
            (
                [configuration.x[index] + x, configuration.y[index] + y],
                [cos, sin],
            )
        };
        let poses: Vec<_> = (0..configuration.n()).map(after).collect();
        for (index, (centre, heading)) in poses.iter().enumerate() {
            if !(centre[0] + centre[1] + heading[0]).is_finite() {
                return Err(StepError::NotFinite {
                    id: configuration.id[index],
                });
            }
        }
        let h = parameters.half_length();
        for &(i, j) in pairs {
            let ([from, heading_i], [to, heading_j]) = (
                [poses[i as usize].0, poses[i as usize].1],
                [poses[j as usize].0, poses[j as usize].1],
            );
            let offset = [to[0] - from[0], to[1] - from[1]];
            if contact::axes_cross(h, offset, heading_i, heading_j) {
                let [first, second] = [i, j].map(|index| configuration.id[index as usize]);
                return Err(StepError::CrossedBodies { first, second });
            }
        }
        Ok(())
    }

    fn remember(&self, state: &mut State) {
        let (order, age) = self.solver.exact.order();
        if state.memory.order != order {
            state.memory.order.clear();
            state.memory.order.extend_from_slice(order);
        }
        state.memory.order_age = age;
        let id = &state.configuration.id;
        let remembered = &mut state.memory.contacts;
        remembered.clear();
        let pushed = self
            .qp
            .contacts
            .iter()
            .zip(&self.solution.multipliers)
            .filter(|(_, value)| **value > 0.0);
        remembered.extend(pushed.map(|(contact, &multiplier)| {
            let [first, second] = [contact.i, contact.j].map(|index| id[index as usize]);
            Remembered {
                first,
                second,
                code: contact.code,
                multiplier,
            }
        }));
    }
}

fn two_largest(values: &[f64]) -> (f64, f64) {
    values.iter().fold((0.0, 0.0), |(first, second), &value| {
        if value > first {
            (value, first)
        } else {
            (first, f64::max(second, value))
        }
    })
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::model::random::{Purpose, Stream};
    use crate::model::{Configuration, Parameters};

    /// Two bodies side by side, touching, and one far away.
    fn touching() -> State {
        let mut configuration = Configuration::default();
        configuration.push(0.0, 0.0, 0.0);
        configuration.push(0.1, 0.4, -0.01);
        configuration.push(9.0, 9.0, 0.0);
        State {
            configuration,
            ..State::default()
        }
    }

    fn refusal(mut state: State) -> StepError {
        let before = format!("{state:?}");
        let error = Stepper::new().step(&mut state).unwrap_err();
        assert_eq!(
            format!("{state:?}"),
            before,
            "a failed step has changed something"
        );
        error
    }

    #[test]
    fn a_step_counts_itself_and_remembers_who_pushed() {
        let mut state = touching();
        let report = Stepper::new().step(&mut state).unwrap();
        assert_eq!(
            (state.step, report.active),
            (1, state.memory.contacts.len())
        );
        assert!(report.active > 0 && report.contacts >= report.active && report.iterations > 0);
        assert!(
            state
                .memory
                .contacts
                .iter()
                .all(|contact| contact.multiplier > 0.0)
        );
    }

    #[test]
    fn crossed_bodies_are_refused() {
        let mut state = touching();
        state.configuration.alpha[1] = 1.5;
        state.configuration.id = vec![4, 7, 9];
        assert_eq!(
            refusal(state),
            StepError::CrossedBodies {
                first: 4,
                second: 7
            }
        );
    }

    #[test]
    fn bodies_that_would_cross_are_refused_before_they_do() {
        // Steps far too long for the parameters to pass their check: linearisation fails.
        let parameters = Parameters {
            pi1: 32.0,
            pi3: 20.0,
            dt: 0.2,
            ..Parameters::default()
        };
        let mut stream = Stream::new(1, 0, 0, Purpose::Start);
        let mut refused = 0;
        for _ in 0..2000 {
            let mut state = State {
                parameters,
                ..State::default()
            };
            for _ in 0..3 {
                let [x, y, alpha] = [0, 1, 2].map(|_| 3.0 * stream.uniform());
                state.configuration.push(x, y, alpha);
            }
            let gaps = body::gaps(&parameters, &state.configuration);
            let before = format!("{state:?}");
            match Stepper::new().step(&mut state) {
                Ok(_) => assert_eq!(body::gaps(&parameters, &state.configuration).crossed, 0),
                Err(error) => {
                    assert!(matches!(error, StepError::CrossedBodies { .. }), "{error}");
                    assert_eq!(format!("{state:?}"), before);
                    refused += usize::from(gaps.crossed == 0);
                }
            }
        }
        assert!(refused > 0, "no step would have crossed");
    }

    #[test]
    fn what_is_not_finite_is_refused_by_name() {
        for bad in [f64::NAN, f64::INFINITY] {
            for column in 0..3 {
                let mut state = touching();
                let Configuration { x, y, alpha, .. } = &mut state.configuration;
                [x, y, alpha][column][2] = bad;
                assert_eq!(refusal(state), StepError::NotFinite { id: 2 });
            }
        }
    }

    #[test]
    fn what_cannot_be_solved_is_refused() {
        let mut state = touching();
        state.parameters.pi4 = f64::NAN;
        let error = refusal(state);
        assert!(matches!(error, StepError::NotSolved { residual } if residual > solve::ACCEPTABLE));
    }
}
