//! One step: free motion, contacts, one convex program, the new configuration.
//!
//! P. L. Várkonyi, *Communication and collective consensus making in animal groups via
//! mechanical interactions*, J. Nonlinear Sci. 21 (2011) 387-401: eqs. (1)-(7) and the appendix,
//! referred to below as "the paper". A step is a function of the state alone. The buffers of a
//! [`Stepper`] affect only its duration.

pub mod contact;
mod displacement;
mod end_contacts;
pub mod free;
mod neighbours;
pub mod qp;
mod report;
pub mod solve;
#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
mod warm_start;

use crate::model::attraction::AttractionWorkspace;
use crate::model::heading::unit_vector;
use crate::model::simd::Level;
use crate::model::threads::Pool;
use crate::model::{Configuration, ContactRule, Parameters, State, Stepping, WarmStart};
use contact::Contact;
use displacement::{
    ROUNDING, all_finite, displace, displace_all, furthest_travel, reach, two_largest,
};
use neighbours::Neighbours;
use qp::Qp;
pub use report::{StepError, StepReport};

/// Maximum number of contact lists in one program. Each list adds at least one contact to the last,
/// and hardly any program needs a second list.
const MAX_LISTS: usize = 20;

/// Advances states. Keeps its buffers between steps.
#[derive(Debug, Default)]
pub struct Stepper {
    /// The parameters that were checked last.
    checked: Option<Parameters>,
    level: Level,
    backend: solve::Backend,
    attraction: AttractionWorkspace,
    pull: Vec<[f64; 2]>,
    free: free::Free,
    neighbours: Neighbours,
    qp: Qp,
    guess: Vec<f64>,
    solution: solve::Solution,
    solver: solve::Workspace,
    /// Displacements relative to the configuration about which the second program is linearised,
    /// and the longest displacement of any point of each body.
    relative: Vec<[f64; 3]>,
    travel: Vec<f64>,
    /// Contacts that the list lacked, and all contacts with their multipliers while they are
    /// sorted.
    missed: Vec<Contact>,
    listed: Vec<(Contact, f64)>,
    /// Worst gap of the listed contacts, and number of crossed pairs.
    worst_gap: Option<f64>,
    crossed: usize,
    /// Displacement of the configuration about which the program is linearised. Empty for the first
    /// program; for the second, the solution of the first.
    carried: Vec<[f64; 3]>,
    /// The configuration about which the second program is linearised.
    predicted: Configuration,
    /// Headings of the predicted configuration, or of the start during the second program.
    other_headings: Vec<[f64; 2]>,
    /// Solution of the first program, from which the second one is guessed.
    first_solution: WarmStart,
}

impl Stepper {
    /// Creates a stepper with empty buffers.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Creates a stepper that solves by `backend`.
    #[must_use]
    pub fn with_backend(backend: solve::Backend) -> Self {
        Self {
            backend,
            ..Self::default()
        }
    }

    /// Creates a stepper whose kernels use the instruction set `level`. This changes the duration
    /// of a step and no bit of its result.
    #[must_use]
    pub fn with_level(level: Level) -> Self {
        let mut stepper = Self {
            level,
            ..Self::default()
        };
        stepper.attraction.level = level;
        stepper.free.level = level;
        stepper.neighbours.search.level = level;
        stepper.solver.exact.level = level;
        stepper
    }

    /// Creates a stepper that computes the attraction of large groups on the threads of `pool`.
    /// This changes the duration of a step and no bit of its result.
    #[must_use]
    pub fn with_pool(pool: Pool) -> Self {
        let mut stepper = Self::default();
        stepper.attraction.pool = Some(pool);
        stepper
    }

    /// Advances `state` by one step.
    ///
    /// - Source: paper, Principle 1, eq. (7), and the four parts of a step at the end of its
    ///   appendix.
    ///
    /// # Errors
    ///
    /// [`StepError`]; the state is then unchanged.
    pub fn step(&mut self, state: &mut State) -> Result<StepReport, StepError> {
        // Parameters that are not a number differ from themselves: they are checked each time.
        if self.checked.as_ref() != Some(&state.parameters) {
            let largest_weight = state.configuration.largest_weight();
            state.parameters.check(largest_weight)?;
            self.checked = Some(state.parameters);
        }
        let mut pull = std::mem::take(&mut self.pull);
        let attraction = state.parameters.attraction;
        self.attraction
            .compute(attraction, &state.configuration, &mut pull);
        let result = self.advance(state, &pull);
        let result = result.map_err(|error| error.with_cause(state, &pull));
        self.pull = pull;
        result
    }

    /// Advances `state` by one step with the given attraction. Does not check the parameters.
    ///
    /// - Shapes: n individuals; n vectors of `pull`, the result of
    ///   [`AttractionWorkspace::compute`].
    ///
    /// # Errors
    ///
    /// [`StepError`]; the state is then unchanged.
    pub fn advance(
        &mut self,
        state: &mut State,
        pull: &[[f64; 2]],
    ) -> Result<StepReport, StepError> {
        self.assemble(state, pull)?;
        let mut report = StepReport {
            worst_gap: self.worst_gap,
            crossed: self.crossed,
            ..StepReport::default()
        };
        self.solve(state, &state.configuration, &mut report)?;
        if state.parameters.relinearise {
            self.relinearise(state, &mut report)?;
        }
        warm_start::store(
            &state.configuration.id,
            &self.qp.contacts,
            &self.solution.multipliers,
            self.solver.exact.order(),
            &mut state.warm_start,
        );
        displace(&mut state.configuration, &self.solution.displacement);
        state.step += 1;
        lapse(state, &mut report.lapsed);
        Ok(report)
    }

    /// Assembles the program of one step with the given attraction, and guesses its multipliers.
    /// [`Stepper::program`] then returns both.
    ///
    /// - Shapes: n individuals; n vectors of `pull`, the result of
    ///   [`AttractionWorkspace::compute`].
    ///
    /// # Errors
    ///
    /// [`StepError::NotFinite`] and [`StepError::CrossedBodies`].
    pub fn assemble(&mut self, state: &State, pull: &[[f64; 2]]) -> Result<(), StepError> {
        let State {
            parameters,
            configuration,
            warm_start,
            ..
        } = state;
        let Configuration { x, y, alpha, .. } = configuration;
        let poses = x.iter().zip(y).zip(alpha);
        all_finite(configuration, poses.map(|((x, y), alpha)| x + y + alpha))?;
        self.free.compute_headings(configuration);
        let free = &mut self.qp.free;
        self.free.steer(parameters, configuration, pull, free);
        free::drive(parameters, configuration, free);
        free::add_noise(state, free);
        self.qp.weights = [1.0, 1.0, parameters.rho2()];
        self.carried.clear();
        self.list(parameters, configuration)?;
        warm_start::load(
            warm_start,
            &configuration.id,
            &self.qp.contacts,
            &mut self.guess,
        );
        Ok(())
    }

    /// Lists the contacts of `configuration`, whose headings have been computed.
    fn list(
        &mut self,
        parameters: &Parameters,
        configuration: &Configuration,
    ) -> Result<(), StepError> {
        let reach = reach(parameters, configuration);
        let (heading, contacts) = (&self.free.heading, &mut self.qp.contacts);
        contacts.clear();
        self.neighbours
            .update(parameters, configuration, heading, reach);
        self.crossed = contact::find(
            self.level,
            parameters,
            configuration,
            heading,
            self.neighbours.pairs(),
            |_, _| reach,
            contacts,
        )?;
        let gaps = contacts.iter().map(|contact| contact.gap);
        self.worst_gap = gaps.reduce(|least, gap| if gap < least { gap } else { least });
        if parameters.stepping == Stepping::Velocity {
            contacts.retain(|contact| contact.gap <= 0.0);
            // The constraint becomes ∇g·d ≥ 0.
            contacts.iter_mut().for_each(|contact| contact.gap = 0.0);
        }
        Ok(())
    }

    /// Assembles and solves a second program, linearised about the result of the first one.
    ///
    /// Its gaps and gradients are those of the predicted configuration; its objective is that of
    /// the first program. The overlap that remains is due to the difference of the two solutions
    /// alone.
    fn relinearise(&mut self, state: &State, report: &mut StepReport) -> Result<(), StepError> {
        let State {
            parameters,
            configuration,
            ..
        } = state;
        let id = &configuration.id;
        let (multipliers, order) = (&self.solution.multipliers, self.solver.exact.order());
        warm_start::store(
            id,
            &self.qp.contacts,
            multipliers,
            order,
            &mut self.first_solution,
        );
        let mut predicted = std::mem::take(&mut self.predicted);
        predicted.clone_from(configuration);
        self.carried.clone_from(&self.solution.displacement);
        displace_all(&mut predicted, &self.carried);
        std::mem::swap(&mut self.free.heading, &mut self.other_headings);
        self.free.compute_headings(&predicted);
        let result = self.list(parameters, &predicted).and_then(|()| {
            // The constraint becomes g(z1) + ∇g(z1)·(d - d1) ≥ 0.
            for contact in &mut self.qp.contacts {
                contact.gap -= contact.gap_change(&self.carried);
            }
            warm_start::load(&self.first_solution, id, &self.qp.contacts, &mut self.guess);
            self.solve(state, &predicted, report)
        });
        self.predicted = predicted;
        std::mem::swap(&mut self.free.heading, &mut self.other_headings);
        result
    }

    /// Returns the n unit vectors along the bodies at the start of the last step.
    #[must_use]
    pub fn headings(&self) -> &[[f64; 2]] {
        &self.free.heading
    }

    /// Returns the n displacements of the last step in x, y and angle.
    #[must_use]
    pub fn displacement(&self) -> &[[f64; 3]] {
        &self.solution.displacement
    }

    /// Returns the program assembled last, and the guess of its m multipliers.
    #[must_use]
    pub fn program(&self) -> (&Qp, &[f64]) {
        (&self.qp, &self.guess)
    }

    /// Solves the program linearised about `configuration`. Adds the contacts that the list lacks
    /// and the solution violates, and solves again until there are none.
    fn solve(
        &mut self,
        state: &State,
        configuration: &Configuration,
        report: &mut StepReport,
    ) -> Result<(), StepError> {
        let State {
            parameters,
            warm_start,
            ..
        } = state;
        if self.carried.is_empty() {
            self.solver
                .exact
                .load_order(&warm_start.order, warm_start.order_age);
        }
        for _ in 0..MAX_LISTS {
            let hints = solve::Hints {
                multipliers: &self.guess,
                x: &configuration.x,
                y: &configuration.y,
            };
            let (solver, solution) = (&mut self.solver, &mut self.solution);
            solve::solve(self.backend, &self.qp, &hints, solver, solution);
            let solution = &self.solution;
            report.iterations += solution.iterations;
            report.fallback += solution.fallback;
            if solution.residual.is_nan() || solution.residual > solve::ACCEPTABLE {
                return Err(StepError::NotSolved {
                    residual: solution.residual,
                });
            }
            if !self.carried.is_empty() {
                self.compute_relative();
            }
            let closing = self.find_missed(parameters, configuration)?;
            if self.missed.is_empty() {
                report.residual = f64::max(report.residual, self.solution.residual);
                report.degraded = report.residual > solve::TARGET;
                report.contacts = self.qp.contacts.len();
                let multipliers = &self.solution.multipliers;
                report.active = multipliers.iter().filter(|&&value| value > 0.0).count();
                return self.check_result(parameters, configuration, closing);
            }
            self.add_missed();
        }
        Err(StepError::NotSolved {
            residual: f64::INFINITY,
        })
    }

    /// Computes the displacements relative to the configuration of the second program.
    fn compute_relative(&mut self) {
        let displacements = self.solution.displacement.iter().zip(&self.carried);
        self.relative.clear();
        self.relative.extend(
            displacements.map(|(moved, carried)| [0, 1, 2].map(|axis| moved[axis] - carried[axis])),
        );
    }

    /// Returns the displacements relative to the configuration of the present program.
    fn relative(&self) -> &[[f64; 3]] {
        if self.carried.is_empty() {
            return &self.solution.displacement;
        }
        &self.relative
    }

    /// Finds the contacts that are not listed and whose linearised gap is negative after the
    /// displacements. Returns an upper bound on the change of the distance of any two bodies.
    fn find_missed(
        &mut self,
        parameters: &Parameters,
        configuration: &Configuration,
    ) -> Result<f64, StepError> {
        let h = parameters.half_length();
        self.missed.clear();
        let reach = reach(parameters, configuration);
        let bound = 2.0 * furthest_travel(h, self.relative());
        // Velocities are limited only at contacts that touch at the start of the step. The
        // neighbour list is then complete only up to `reach`: near the longest `dt` a pair that is
        // not listed may cross. `check_result` does not find it, and the next step fails.
        if bound <= reach || parameters.stepping == Stepping::Velocity {
            return Ok(bound);
        }
        let mut travel = std::mem::take(&mut self.travel);
        travel.clear();
        let displacements = self.relative().iter();
        travel.extend(displacements.map(|[x, y, alpha]| (x * x + y * y).sqrt() + h * alpha.abs()));
        self.travel = travel;
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
        let (listed, carried) = (&self.qp.contacts, &self.carried);
        let displacement = &self.solution.displacement;
        self.missed.retain_mut(|contact| {
            if !carried.is_empty() {
                contact.gap -= contact.gap_change(carried);
            }
            let is_listed = listed.binary_search_by_key(&contact.key(), Contact::key);
            is_listed.is_err() && contact.linearised_gap(displacement) < 0.0
        });
        Ok(bound)
    }

    /// Adds the missed contacts to the list. The guess for the next solution is the multipliers
    /// found so far, and 0 for the added contacts.
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

    /// Checks that the result is finite and, under `endpoints` and `clamped`, that no axes cross.
    /// The distance of two bodies has changed by at most `closing`.
    fn check_result(
        &self,
        parameters: &Parameters,
        configuration: &Configuration,
        closing: f64,
    ) -> Result<(), StepError> {
        let Configuration { x, y, alpha, .. } = configuration;
        let relative = self.relative();
        let poses = x.iter().zip(y).zip(alpha).zip(relative);
        let sums = poses
            .map(|(((x, y), alpha), moved)| (x + moved[0]) + (y + moved[1]) + (alpha + moved[2]));
        all_finite(configuration, sums)?;
        // Axes can cross only if the step closes their whole distance. The distance of a pair is
        // that of its nearest contact; without a contact it exceeds the reach.
        let nearest = self.worst_gap.unwrap_or(f64::INFINITY);
        let nearest = f64::min(nearest, reach(parameters, configuration));
        let distance = nearest + 2.0 * parameters.radius();
        if distance > closing + ROUNDING || parameters.contacts == ContactRule::Closest {
            return Ok(());
        }
        let after = |index: u32| {
            let index = index as usize;
            let [x, y, alpha] = relative[index];
            (
                [configuration.x[index] + x, configuration.y[index] + y],
                unit_vector(configuration.alpha[index] + alpha),
            )
        };
        let h = parameters.half_length();
        for &(i, j) in self.neighbours.pairs() {
            let ((from, heading_i), (to, heading_j)) = (after(i), after(j));
            let offset = [to[0] - from[0], to[1] - from[1]];
            if end_contacts::axes_cross(h, offset, heading_i, heading_j) {
                let [first, second] = [i, j].map(|index| configuration.id[index as usize]);
                return Err(StepError::CrossedBodies { first, second });
            }
        }
        Ok(())
    }
}

/// Makes individuals uninformed whose preference has expired, and appends their ids to `lapsed`.
fn lapse(state: &mut State, lapsed: &mut Vec<u32>) {
    let configuration = &mut state.configuration;
    for index in 0..configuration.n() {
        if configuration.lapses_at[index].is_some_and(|step| step <= state.step) {
            configuration.uninform(index);
            lapsed.push(configuration.id[index]);
        }
    }
}
