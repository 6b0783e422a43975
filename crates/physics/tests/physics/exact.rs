//! Random groups over the parameter ranges: every step meets its target residual, and the fallback
//! agrees with the exact solver.

use std::f64::consts::{PI, TAU};
use std::fmt;
use std::ops::AddAssign;

use jostle_physics::model::random::{Purpose, Stream};
use jostle_physics::model::{Parameters, State, start};
use jostle_physics::stepper::solve::{self, Backend};
use jostle_physics::stepper::{StepError, StepReport, Stepper};

use crate::with;

/// Steps of one `cargo test`; ten times as many if `JOSTLE_LONG` is set in the environment.
const STEPS: u64 = 100_000;

/// Steps between two that are computed by the fallback too.
const CHECK_INTERVAL: u64 = 100;

/// Largest difference of the displacements of two solutions, per unit of their residuals. An error
/// ε of a gap moves a body by ε over the sine of the angle between gradients: nearly dependent
/// contacts amplify errors, at most 55 times in a million steps.
const MAX_AMPLIFICATION: f64 = 100.0;

/// Largest difference if both residuals are 0: amplified rounding.
const ROUNDING: f64 = 1e-10;

/// Totals and maxima over many steps.
#[derive(Clone, Debug, Default)]
pub struct StepTotals {
    /// Steps taken.
    pub steps: u64,
    /// Contacts listed, in total.
    pub contacts: usize,
    /// Contacts that pushed, in total and at most in a step.
    pub active: usize,
    pub max_active: usize,
    /// Systems factored, in total and at most in a step.
    pub iterations: usize,
    pub max_iterations: usize,
    /// Steps that called the fallback.
    pub fallbacks: u64,
    /// Largest residual.
    pub residual: f64,
}

impl AddAssign<&StepReport> for StepTotals {
    fn add_assign(&mut self, report: &StepReport) {
        self.steps += 1;
        self.contacts += report.contacts;
        self.active += report.active;
        self.max_active = self.max_active.max(report.active);
        self.iterations += report.iterations;
        self.max_iterations = self.max_iterations.max(report.iterations);
        self.fallbacks += u64::from(report.fallback > 0);
        self.residual = self.residual.max(report.residual);
    }
}

impl fmt::Display for StepTotals {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let mean = |sum: usize| sum as f64 / self.steps.max(1) as f64;
        write!(
            f,
            "{} steps, {:.1} contacts, {:.1} push ({} at most), {:.2} factorisations ({} at most), \
             {} fallbacks, worst residual {:.1e}",
            self.steps,
            mean(self.contacts),
            mean(self.active),
            self.max_active,
            mean(self.iterations),
            self.max_iterations,
            self.fallbacks,
            self.residual
        )
    }
}

/// Draws a number between `low` and `high` with a uniform logarithm.
fn logarithmic(stream: &mut Stream, low: f64, high: f64) -> f64 {
    low * (high / low).powf(stream.uniform())
}

/// Draws a crowded group, its parameters, and its number of steps.
fn draw(seed: u64) -> (State, u64) {
    let mut stream = Stream::new(seed, 0, 0, Purpose::Selection);
    let stream = &mut stream;
    let n = logarithmic(stream, 1.0, 201.0) as usize;
    let is_disc = stream.uniform() < 0.2;
    let pi1 = logarithmic(stream, 1.0, 32.0);
    let mut parameters = Parameters {
        pi1: if is_disc { 1.0 } else { pi1 },
        pi3: logarithmic(stream, 0.01, 10.0),
        pi4: logarithmic(stream, 1e-3, 1e3),
        ..Parameters::default()
    };
    let weight = 2.0 * stream.uniform();
    let longest = parameters.longest_step(weight);
    parameters.dt = logarithmic(stream, 0.02 * longest, longest).min(longest);
    let steps = logarithmic(stream, 30.0, 1000.0) as u64;
    let (h, r) = (parameters.half_length(), parameters.radius());
    let fill = 0.1 + 0.2 * stream.uniform();
    let mut radius = (n as f64 * (4.0 * h * r + PI * r * r) / fill / PI).sqrt();
    // Randomly placed long bodies fill a disc less densely than discs.
    let mut configuration = loop {
        match start::disc(&parameters, n, Some(radius), seed) {
            Ok(configuration) => break configuration,
            Err(_) => radius *= 1.2,
        }
    };
    let informed = (stream.uniform() * stream.uniform() * n as f64) as usize;
    let common = (stream.uniform() < 0.5).then(|| TAU * stream.uniform());
    for index in 0..informed {
        let direction = common.unwrap_or_else(|| TAU * stream.uniform());
        configuration.inform(index, weight, direction, None);
    }
    (with(parameters, seed, configuration), steps)
}

/// Comparison of the exact solver with the fallback.
#[derive(Clone, Copy, Debug, Default)]
struct Comparison {
    /// Compared steps; each has contacts that push.
    steps: u64,
    /// Compared steps that the fallback did not solve to the target. An interior-point solver
    /// sometimes misses it.
    missed: u64,
    /// Largest distance between a body's two results, over the points of its axis.
    worst: f64,
    /// Largest ratio of that distance to its bound.
    share: f64,
    /// Seed of the group with that ratio.
    seed: u64,
}

impl Comparison {
    /// Computes the step from `before` with the fallback and compares the result with `after`, the
    /// result of the exact solver.
    fn compare(&mut self, before: &State, after: &State, report: &StepReport) {
        self.steps += 1;
        let mut reference = before.clone();
        let checked = Stepper::with_backend(Backend::Fallback).step(&mut reference);
        let Some(checked) = checked.ok().filter(|checked| !checked.degraded) else {
            self.missed += 1;
            return;
        };
        let (ours, theirs) = (&after.configuration, &reference.configuration);
        let h = before.parameters.half_length();
        let apart = |k: usize| {
            let (x, y) = (ours.x[k] - theirs.x[k], ours.y[k] - theirs.y[k]);
            x.hypot(y) + h * (ours.alpha[k] - theirs.alpha[k]).abs()
        };
        let worst = (0..ours.n()).map(apart).fold(0.0, f64::max);
        let bound = MAX_AMPLIFICATION * (report.residual + checked.residual) + ROUNDING;
        let share = worst / bound;
        self.worst = self.worst.max(worst);
        if share > self.share {
            (self.share, self.seed) = (share, before.seed);
        }
    }
}

#[test]
fn every_step_of_random_groups_is_exact_and_the_fallback_agrees() {
    let long = std::env::var_os("JOSTLE_LONG").is_some();
    let steps = if long { 10 * STEPS } else { STEPS };
    let (mut totals, mut comparison, mut crossed) =
        (StepTotals::default(), Comparison::default(), 0);
    let mut seed = 0;
    while totals.steps < steps {
        seed += 1;
        let (mut state, lasts) = draw(seed);
        let mut stepper = Stepper::new();
        for _ in 0..lasts {
            let before = (totals.steps % CHECK_INTERVAL == 0).then(|| state.clone());
            let report = match stepper.step(&mut state) {
                Ok(report) => report,
                // For some of the drawn drags the step is too long.
                Err(StepError::CrossedBodies { .. }) => {
                    crossed += 1;
                    break;
                }
                Err(error) => panic!("seed {seed}, step {}: {error}", state.step),
            };
            totals += &report;
            if let Some(before) = before.filter(|_| report.active > 0) {
                comparison.compare(&before, &state, &report);
            }
            if report.fallback > 0 {
                println!("seed {seed}, step {}: {report:?}", state.step - 1);
            }
            assert!(
                report.residual <= solve::TARGET,
                "seed {seed}, step {}: {report:?}",
                state.step - 1
            );
        }
    }
    println!("seeds 1 to {seed}, {crossed} of them ended by crossed axes: {totals}");
    println!("fallback: {comparison:?}");
    assert!(
        totals.active as u64 > 5 * totals.steps,
        "too few contacts push"
    );
    assert!(
        comparison.share <= 1.0 && comparison.missed * 100 <= comparison.steps,
        "{comparison:?}"
    );
}
