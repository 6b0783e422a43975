//! One step: free motion, contacts, one convex program, the new configuration.
//!
//! P. L. Várkonyi, *Communication and collective consensus making in animal groups via
//! mechanical interactions*, J. Nonlinear Sci. 21 (2011) 387-401: eqs. (1)-(7) and the appendix,
//! referred to below as "the paper". A step is a function of the state alone. The workspace only
//! saves time.

pub mod contact;
mod end_contacts;
pub mod free;
mod neighbours;
pub mod qp;
pub mod solve;
mod warm_start;

use thiserror::Error;

use crate::model::attraction::AttractionWorkspace;
use crate::model::heading::unit_vector;
use crate::model::simd::Level;
use crate::model::threads::Pool;
use crate::model::{CELL, Configuration, ContactRule, Parameters, State, Stepping, WarmStart};
use contact::Contact;
use neighbours::Neighbours;
use qp::Qp;

/// How often contacts may be listed again in one step. Every time at least one is added, and
/// hardly any step needs a second list.
const MOST_LISTS: usize = 20;

/// What a bound on a distance leaves for rounding, at the largest coordinates and angles.
const ROUNDING: f64 = 1e-6;

/// Advances states, and keeps its buffers between steps.
#[derive(Debug, Default)]
pub struct Stepper {
    level: Level,
    backend: solve::Backend,
    social: AttractionWorkspace,
    pull: Vec<[f64; 2]>,
    free: free::Free,
    neighbours: Neighbours,
    qp: Qp,
    guess: Vec<f64>,
    solution: solve::Solution,
    solver: solve::Workspace,
    /// How far all go from where a second program is linearised; how far any point of each goes.
    way: Vec<[f64; 3]>,
    travel: Vec<f64>,
    /// Contacts that the first list missed, and all with their multipliers while they are sorted.
    missed: Vec<Contact>,
    listed: Vec<(Contact, f64)>,
    /// The least gap that is listed, and how many pairs cross.
    least_gap: Option<f64>,
    crossed: usize,
    /// By how much all are displaced where the program is linearised; nobody, but for a second
    /// program. That is about the configuration which the first one predicts.
    carried: Vec<[f64; 3]>,
    predicted: Configuration,
    /// The headings of the configuration that the program not at hand is about.
    other_headings: Vec<[f64; 2]>,
    between: WarmStart,
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
    pub fallback: usize,
    /// The least gap of any pair as the step began; none where all were out of reach.
    pub least_gap: Option<f64>,
    /// How many pairs crossed as the step began; under `endpoints` none.
    pub crossed: usize,
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
    /// - Shapes: n individuals and n vectors of `pull`, which [`AttractionWorkspace::compute`] gives.
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
        let mut report = StepReport {
            least_gap: self.least_gap,
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

    /// Assembles the program of one step, the attraction being known, and guesses its
    /// multipliers: [`Stepper::program`] then has both.
    ///
    /// - Shapes: n individuals and n vectors of `pull`, which [`AttractionWorkspace::compute`] gives.
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

    /// Lists the contacts of `configuration`, whose headings are known.
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
        self.least_gap = gaps.reduce(|least, gap| if gap < least { gap } else { least });
        if parameters.stepping == Stepping::Velocity {
            contacts.retain(|contact| contact.gap <= 0.0);
            contacts.iter_mut().for_each(|contact| contact.gap = 0.0);
        }
        Ok(())
    }

    /// Assembles and solves a second program about what the first one's solution predicts.
    ///
    /// Its gaps and gradients are those of the predicted configuration, its objective is the
    /// first one's: what is left of overlap comes from the second displacement alone.
    fn relinearise(&mut self, state: &State, report: &mut StepReport) -> Result<(), StepError> {
        let State {
            parameters,
            configuration,
            ..
        } = state;
        let id = &configuration.id;
        let (multipliers, order) = (&self.solution.multipliers, self.solver.exact.order());
        warm_start::store(id, &self.qp.contacts, multipliers, order, &mut self.between);
        let mut predicted = std::mem::take(&mut self.predicted);
        predicted.clone_from(configuration);
        self.carried.clone_from(&self.solution.displacement);
        displace_all(&mut predicted, &self.carried);
        std::mem::swap(&mut self.free.heading, &mut self.other_headings);
        self.free.compute_headings(&predicted);
        let result = self.list(parameters, &predicted).and_then(|()| {
            for contact in &mut self.qp.contacts {
                contact.gap -= contact.closing(&self.carried);
            }
            warm_start::load(&self.between, id, &self.qp.contacts, &mut self.guess);
            self.solve(state, &predicted, report)
        });
        self.predicted = predicted;
        std::mem::swap(&mut self.free.heading, &mut self.other_headings);
        result
    }

    /// Unit vectors along the bodies as the last step began.
    #[must_use]
    pub fn headings(&self) -> &[[f64; 2]] {
        &self.free.heading
    }

    /// By how much the last step displaced everybody: x, y and angle.
    #[must_use]
    pub fn displacement(&self) -> &[[f64; 3]] {
        &self.solution.displacement
    }

    /// The program assembled last, and a guess of its multipliers.
    #[must_use]
    pub fn program(&self) -> (&Qp, &[f64]) {
        (&self.qp, &self.guess)
    }

    /// Solves the program about `configuration`, lists what the solution could have closed, and
    /// solves again until nothing was missed.
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
                .recall(&warm_start.order, warm_start.order_age);
        }
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
            report.fallback += solution.fallback;
            if solution.residual.is_nan() || solution.residual > solve::ACCEPTABLE {
                return Err(StepError::NotSolved {
                    residual: solution.residual,
                });
            }
            if !self.carried.is_empty() {
                self.measure_way();
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

    /// Measures how far all go from where a second program is linearised.
    fn measure_way(&mut self) {
        let ways = self.solution.displacement.iter().zip(&self.carried);
        self.way.clear();
        self.way
            .extend(ways.map(|(moved, carried)| [0, 1, 2].map(|axis| moved[axis] - carried[axis])));
    }

    /// How far all go from where the program is linearised.
    fn way(&self) -> &[[f64; 3]] {
        if self.carried.is_empty() {
            return &self.solution.displacement;
        }
        &self.way
    }

    /// Finds the contacts not listed that the displacements close in the linearised gap; returns
    /// by how much any two bodies can have closed, at most.
    fn find_missed(
        &mut self,
        parameters: &Parameters,
        configuration: &Configuration,
    ) -> Result<f64, StepError> {
        let h = parameters.half_length();
        self.missed.clear();
        let reach = reach(parameters, configuration);
        let bound = 2.0 * furthest_travel(h, self.way());
        // Velocities are only limited where bodies touch as the step begins.
        if bound <= reach || parameters.stepping == Stepping::Velocity {
            return Ok(bound);
        }
        let mut travel = std::mem::take(&mut self.travel);
        travel.clear();
        let ways = self.way().iter();
        travel.extend(ways.map(|[x, y, alpha]| (x * x + y * y).sqrt() + h * alpha.abs()));
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
                contact.gap -= contact.closing(carried);
            }
            let is_listed = listed.binary_search_by_key(&contact.key(), Contact::key);
            is_listed.is_err() && contact.linearised_gap(displacement) < 0.0
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

    /// Refuses a result that is not finite, or under `endpoints` one in which axes cross; no two
    /// bodies have closed by more than `closing`.
    fn check_result(
        &self,
        parameters: &Parameters,
        configuration: &Configuration,
        closing: f64,
    ) -> Result<(), StepError> {
        let Configuration { x, y, alpha, .. } = configuration;
        let way = self.way();
        let poses = x.iter().zip(y).zip(alpha).zip(way);
        let sums = poses
            .map(|(((x, y), alpha), moved)| (x + moved[0]) + (y + moved[1]) + (alpha + moved[2]));
        all_finite(configuration, sums)?;
        // Axes come to cross where the distance between them is used up, and every pair is as
        // far apart as its nearest contact; without one, further than the reach.
        let nearest = self.least_gap.unwrap_or(f64::INFINITY);
        let nearest = f64::min(nearest, reach(parameters, configuration));
        let distance = nearest + 2.0 * parameters.radius();
        if distance > closing + ROUNDING || parameters.contacts == ContactRule::Closest {
            return Ok(());
        }
        let after = |index: u32| {
            let index = index as usize;
            let [x, y, alpha] = way[index];
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

/// How near a contact must be to be listed at first.
fn reach(parameters: &Parameters, configuration: &Configuration) -> f64 {
    match parameters.stepping {
        Stepping::Position => parameters.reach(configuration.largest_weight()),
        // Bodies that overlap touch too: their distance says by how much they do.
        Stepping::Velocity => ROUNDING,
    }
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
    let all_near = displace_all(configuration, displacement);
    // Where nobody is further than half a cell from the origin, the centroid is not either.
    if !all_near {
        configuration.re_centre();
    }
}

/// Moves all, and tells whether everybody is then within half a cell of the origin.
fn displace_all(configuration: &mut Configuration, displacement: &[[f64; 3]]) -> bool {
    let Configuration { x, y, alpha, .. } = configuration;
    let poses = x.iter_mut().zip(y.iter_mut()).zip(alpha);
    let mut all_near = true;
    for (((x, y), alpha), moved) in poses.zip(displacement) {
        *x += moved[0];
        *y += moved[1];
        *alpha += moved[2];
        all_near &= (x.abs() <= CELL / 2.0) & (y.abs() <= CELL / 2.0);
    }
    all_near
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
    use crate::model::body;
    use crate::model::random::{Purpose, Stream};

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
            (1, state.warm_start.contacts.len())
        );
        assert!(report.active > 0 && report.contacts >= report.active && report.iterations > 0);
        assert!(
            state
                .warm_start
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
