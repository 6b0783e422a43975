//! One step: free motion, contacts, one convex program, the new configuration.
//!
//! P. L. Várkonyi, *Communication and collective consensus making in animal groups via
//! mechanical interactions*, J. Nonlinear Sci. 21 (2011) 387-401: eqs. (1)-(7) and the appendix,
//! referred to below as "the paper". A step is a function of the state alone. The workspace only
//! saves time.

pub mod contact;
mod ends;
pub mod free;
pub mod heading;
mod memory;
mod neighbours;
pub mod qp;
pub mod solve;

use thiserror::Error;

use crate::model::attraction::Social;
use crate::model::lanes::Level;
use crate::model::threads::Pool;
use crate::model::{CELL, Configuration, State};
use contact::Contact;
use heading::unit_vector;
use neighbours::Neighbours;
use qp::Qp;

/// How often contacts may be listed again in one step. Every time at least one is added, and
/// hardly any step needs a second list.
const MOST_LISTS: usize = 20;

/// What a bound on a distance leaves for rounding, at the largest coordinates and angles.
const ROUNDING: f64 = 1e-6;

/// Advances states, and keeps its memory between steps.
#[derive(Debug, Default)]
pub struct Stepper {
    level: Level,
    backend: solve::Backend,
    social: Social,
    pull: Vec<[f64; 2]>,
    free: free::Free,
    neighbours: Neighbours,
    qp: Qp,
    guess: Vec<f64>,
    solution: solve::Solution,
    solver: solve::Workspace,
    travel: Vec<f64>,
    /// Contacts that the first list missed, and all with their multipliers while they are sorted.
    missed: Vec<Contact>,
    listed: Vec<(Contact, f64)>,
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

    /// Creates an empty workspace whose kernels are those of `level`: it takes another time and
    /// changes no bit.
    #[must_use]
    pub fn with_level(level: Level) -> Self {
        let mut stepper = Self {
            level,
            ..Self::default()
        };
        stepper.social.level = level;
        stepper.free.level = level;
        stepper.neighbours.search.level = level;
        stepper.solver.exact.level = level;
        stepper
    }

    /// Creates an empty workspace that shares the attraction of large groups among the threads
    /// of `pool`: it takes another time and changes no bit.
    #[must_use]
    pub fn with_pool(pool: Pool) -> Self {
        let mut stepper = Self::default();
        stepper.social.pool = Some(pool);
        stepper
    }

    /// Advances `state` by one step.
    ///
    /// - Source: paper, Principle 1, and the four parts of a step at the end of its appendix.
    ///
    /// # Errors
    ///
    /// [`StepError`]; the state is then as it was.
    pub fn step(&mut self, state: &mut State) -> Result<StepReport, StepError> {
        let mut pull = std::mem::take(&mut self.pull);
        let attraction = state.parameters.attraction;
        self.social
            .compute(attraction, &state.configuration, &mut pull);
        let result = self.advance(state, &pull);
        self.pull = pull;
        result
    }

    /// Advances `state` by one step, the attraction being known.
    ///
    /// - Shapes: n individuals and n vectors of `pull`, which [`Social::compute`] gives.
    ///
    /// # Errors
    ///
    /// [`StepError`]; the state is then as it was.
    pub fn advance(
        &mut self,
        state: &mut State,
        pull: &[[f64; 2]],
    ) -> Result<StepReport, StepError> {
        self.assemble(state, pull)?;
        let mut report = self.solve(state)?;
        memory::remember(
            &state.configuration.id,
            &self.qp.contacts,
            &self.solution.multipliers,
            self.solver.exact.order(),
            &mut state.memory,
        );
        displace(&mut state.configuration, &self.solution.displacement);
        state.step += 1;
        lapse(state, &mut report.lapsed);
        Ok(report)
    }

    /// Assembles the program of one step, the attraction being known, and guesses its
    /// multipliers: [`Stepper::program`] then has both.
    ///
    /// - Shapes: n individuals and n vectors of `pull`, which [`Social::compute`] gives.
    ///
    /// # Errors
    ///
    /// [`StepError::NotFinite`] and [`StepError::CrossedBodies`].
    pub fn assemble(&mut self, state: &State, pull: &[[f64; 2]]) -> Result<(), StepError> {
        let State {
            parameters,
            configuration,
            memory,
            ..
        } = state;
        let Configuration { x, y, alpha, .. } = configuration;
        let poses = x.iter().zip(y).zip(alpha);
        all_finite(configuration, poses.map(|((x, y), alpha)| x + y + alpha))?;
        self.free.head(configuration);
        self.free
            .steer(parameters, configuration, pull, &mut self.qp.free);
        self.qp.weights = [1.0, 1.0, parameters.rho2()];
        self.qp.contacts.clear();
        let (qp, free) = (&mut self.qp, &self.free);
        let reach = parameters.reach(configuration.largest_weight());
        self.neighbours
            .update(parameters, configuration, &free.heading, reach);
        contact::find(
            self.level,
            parameters,
            configuration,
            &free.heading,
            self.neighbours.pairs(),
            |_, _| reach,
            &mut qp.contacts,
        )?;
        memory::recall(memory, &configuration.id, &qp.contacts, &mut self.guess);
        Ok(())
    }

    /// The program assembled last, and a guess of its multipliers.
    #[must_use]
    pub fn program(&self) -> (&Qp, &[f64]) {
        (&self.qp, &self.guess)
    }

    /// Solves the program, lists what the solution could have closed, and solves again until
    /// nothing was missed.
    fn solve(&mut self, state: &State) -> Result<StepReport, StepError> {
        let mut report = StepReport::default();
        let State {
            configuration,
            memory,
            ..
        } = state;
        self.solver.exact.recall(&memory.order, memory.order_age);
        for _ in 0..MOST_LISTS {
            let hints = solve::Hints {
                multipliers: &self.guess,
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
            let closing = self.find_missed(state)?;
            if self.missed.is_empty() {
                report.residual = self.solution.residual;
                report.degraded = self.solution.residual > solve::TARGET;
                report.contacts = self.qp.contacts.len();
                let multipliers = &self.solution.multipliers;
                report.active = multipliers.iter().filter(|&&value| value > 0.0).count();
                self.check_result(state, closing)?;
                return Ok(report);
            }
            self.add_missed();
        }
        Err(StepError::NotSolved {
            residual: f64::INFINITY,
        })
    }

    /// Finds the contacts not listed that the displacements close in the linearised gap; returns
    /// by how much any two bodies can have closed, at most.
    fn find_missed(&mut self, state: &State) -> Result<f64, StepError> {
        let State {
            parameters,
            configuration,
            ..
        } = state;
        let (h, displacement) = (parameters.half_length(), &self.solution.displacement);
        self.missed.clear();
        let reach = parameters.reach(configuration.largest_weight());
        let bound = 2.0 * furthest_travel(h, displacement);
        if bound <= reach {
            return Ok(bound);
        }
        self.travel.clear();
        self.travel.extend(
            displacement
                .iter()
                .map(|[x, y, alpha]| (x * x + y * y).sqrt() + h * alpha.abs()),
        );
        let (furthest, second) = two_largest(&self.travel);
        let bound = furthest + second;
        if bound <= reach {
            return Ok(bound);
        }
        let heading = &self.free.heading;
        self.neighbours
            .update(parameters, configuration, heading, bound);
        let travel = &self.travel;
        contact::find(
            self.level,
            parameters,
            configuration,
            heading,
            self.neighbours.pairs(),
            |i, j| travel[i] + travel[j],
            &mut self.missed,
        )?;
        let listed = &self.qp.contacts;
        self.missed.retain(|contact| {
            listed
                .binary_search_by_key(&contact.key(), Contact::key)
                .is_err()
                && contact.linearised_gap(displacement) < 0.0
        });
        Ok(bound)
    }

    /// Lists what was missed; the multipliers found so far are the guess for the next solution.
    fn add_missed(&mut self) {
        let old = self.qp.contacts.drain(..);
        self.listed.clear();
        self.listed
            .extend(old.zip(self.solution.multipliers.drain(..)));
        self.listed
            .extend(self.missed.drain(..).map(|contact| (contact, 0.0)));
        self.listed
            .sort_unstable_by_key(|(contact, _)| contact.key());
        self.guess.clear();
        for (contact, multiplier) in self.listed.drain(..) {
            self.qp.contacts.push(contact);
            self.guess.push(multiplier);
        }
    }

    /// Refuses a result that is not finite, or in which axes cross; no two bodies have closed by
    /// more than `closing`.
    fn check_result(&self, state: &State, closing: f64) -> Result<(), StepError> {
        let State {
            parameters,
            configuration,
            ..
        } = state;
        let Configuration { x, y, alpha, .. } = configuration;
        let displacement = &self.solution.displacement;
        let poses = x.iter().zip(y).zip(alpha).zip(displacement);
        let sums = poses
            .map(|(((x, y), alpha), moved)| (x + moved[0]) + (y + moved[1]) + (alpha + moved[2]));
        all_finite(configuration, sums)?;
        // Axes come to cross where the distance between them is used up, and every pair is as
        // far apart as its nearest contact; without one, further than the reach.
        let reach = parameters.reach(configuration.largest_weight());
        let gaps = self.qp.contacts.iter().map(|contact| contact.gap);
        let nearest = gaps.fold(reach, |least, gap| if gap < least { gap } else { least });
        let distance = nearest + 2.0 * parameters.radius();
        if distance > closing + ROUNDING {
            return Ok(());
        }
        let after = |index: u32| {
            let index = index as usize;
            let [x, y, alpha] = displacement[index];
            (
                [configuration.x[index] + x, configuration.y[index] + y],
                unit_vector(configuration.alpha[index] + alpha),
            )
        };
        let h = parameters.half_length();
        for &(i, j) in self.neighbours.pairs() {
            let ((from, heading_i), (to, heading_j)) = (after(i), after(j));
            let offset = [to[0] - from[0], to[1] - from[1]];
            if ends::axes_cross(h, offset, heading_i, heading_j) {
                let [first, second] = [i, j].map(|index| configuration.id[index as usize]);
                return Err(StepError::CrossedBodies { first, second });
            }
        }
        Ok(())
    }
}

/// Refuses to go on with anybody whose sum of coordinates is not finite.
fn all_finite(
    configuration: &Configuration,
    sums: impl Iterator<Item = f64> + Clone,
) -> Result<(), StepError> {
    // Without a branch for each, as nearly always all are.
    let finite = sums.clone().fold(true, |all, sum| all & sum.is_finite());
    if finite {
        return Ok(());
    }
    let first = sums.into_iter().position(|sum| !sum.is_finite());
    let id = configuration.id[first.expect("one is not finite")];
    Err(StepError::NotFinite { id })
}

/// How far any point of an axis is carried, at most.
fn furthest_travel(h: f64, displacement: &[[f64; 3]]) -> f64 {
    let larger = |one: f64, other: f64| if one > other { one } else { other };
    let (mut way, mut turn) = ([0.0; 4], [0.0; 4]);
    for four in displacement.chunks(4) {
        for (lane, [x, y, alpha]) in four.iter().enumerate() {
            way[lane] = larger(x * x + y * y, way[lane]);
            turn[lane] = larger(alpha.abs(), turn[lane]);
        }
    }
    let [way, turn] = [way, turn].map(|lanes| lanes.into_iter().fold(0.0, larger));
    way.sqrt() + h * turn
}

/// Moves all, and keeps them near their origin.
fn displace(configuration: &mut Configuration, displacement: &[[f64; 3]]) {
    let Configuration { x, y, alpha, .. } = configuration;
    let poses = x.iter_mut().zip(y.iter_mut()).zip(alpha);
    let mut all_near = true;
    for (((x, y), alpha), moved) in poses.zip(displacement) {
        *x += moved[0];
        *y += moved[1];
        *alpha += moved[2];
        all_near &= (x.abs() <= CELL / 2.0) & (y.abs() <= CELL / 2.0);
    }
    // Where nobody is further than half a cell from the origin, the centroid is not either.
    if !all_near {
        configuration.re_centre();
    }
}

/// Ends the preferences whose time has come, and tells whose.
fn lapse(state: &mut State, lapsed: &mut Vec<u32>) {
    let configuration = &mut state.configuration;
    for index in 0..configuration.n() {
        if configuration.lapses_at[index].is_some_and(|step| step <= state.step) {
            configuration.uninform(index);
            lapsed.push(configuration.id[index]);
        }
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
    use crate::model::{Parameters, body};

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
