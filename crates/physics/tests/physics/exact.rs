//! Every step is exact, whatever the parameters: many random groups, and the fallback beside them.

use std::f64::consts::{PI, TAU};
use std::fmt;
use std::ops::AddAssign;

use jostle_physics::model::random::{Purpose, Stream};
use jostle_physics::model::{Parameters, State, start};
use jostle_physics::stepper::solve::{self, Backend};
use jostle_physics::stepper::{StepError, StepReport, Stepper};

use crate::with;

/// Steps of one `cargo test`; ten times as many with `JOSTLE_LONG` in the environment.
const STEPS: u64 = 100_000;

/// Every so many steps the fallback takes the same one.
const REFEREED: u64 = 100;

/// What displacements of two solutions may differ by, for each unit of their residuals. A gap
/// wrong by ε moves a body by ε over the sine of the angle between gradients: contacts that
/// nearly depend on each other amplify, in a million steps 55 times at most.
const AMPLIFIED: f64 = 100.0;

/// What they may differ by where both residuals are nothing: rounding, amplified alike.
const ROUNDING: f64 = 1e-10;

/// What many steps were like.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Steps taken.
    pub steps: u64,
    /// Contacts listed, in all.
    pub contacts: usize,
    /// Contacts that pushed, in all and at most.
    pub active: usize,
    pub most_active: usize,
    /// Systems factored, in all and at most.
    pub iterations: usize,
    pub most_iterations: usize,
    /// Steps for which the fallback was asked.
    pub fallbacks: u64,
    /// The largest residual.
    pub residual: f64,
}

impl AddAssign<&StepReport> for Tally {
    fn add_assign(&mut self, report: &StepReport) {
        self.steps += 1;
        self.contacts += report.contacts;
        self.active += report.active;
        self.most_active = self.most_active.max(report.active);
        self.iterations += report.iterations;
        self.most_iterations = self.most_iterations.max(report.iterations);
        self.fallbacks += u64::from(report.fallback > 0);
        self.residual = self.residual.max(report.residual);
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let mean = |sum: usize| sum as f64 / self.steps.max(1) as f64;
        write!(
            f,
            "{} steps, {:.1} contacts, {:.1} push ({} at most), {:.2} factorisations ({} at most), \
             {} fallbacks, worst residual {:.1e}",
            self.steps,
            mean(self.contacts),
            mean(self.active),
            self.most_active,
            mean(self.iterations),
            self.most_iterations,
            self.fallbacks,
            self.residual
        )
    }
}

/// A number between two, its logarithm uniform.
fn logarithmic(stream: &mut Stream, low: f64, high: f64) -> f64 {
    low * (high / low).powf(stream.uniform())
}

/// A crowded group with parameters from all of their ranges, and how many steps it takes.
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
    // Long bodies at random fill a disc less densely than round ones.
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

/// What the fallback said of the steps that it took too.
#[derive(Clone, Copy, Debug, Default)]
struct Refereed {
    /// Steps that pushed.
    steps: u64,
    /// Of these, steps that it did not solve to the target, as interior points sometimes do not.
    missed: u64,
    /// The largest way between a body's places, of any point on its axis.
    worst: f64,
    /// The largest share of what it may be.
    share: f64,
    /// The seed of that.
    seed: u64,
}

impl Refereed {
    /// Takes the step of `before` as well, which the stepper says led to `after`.
    fn judge(&mut self, before: &State, after: &State, report: &StepReport) {
        self.steps += 1;
        let mut refereed = before.clone();
        let judged = Stepper::with_backend(Backend::Fallback).step(&mut refereed);
        let Some(judged) = judged.ok().filter(|judged| !judged.degraded) else {
            self.missed += 1;
            return;
        };
        let (ours, theirs) = (&after.configuration, &refereed.configuration);
        let h = before.parameters.half_length();
        let apart = |k: usize| {
            let (x, y) = (ours.x[k] - theirs.x[k], ours.y[k] - theirs.y[k]);
            x.hypot(y) + h * (ours.alpha[k] - theirs.alpha[k]).abs()
        };
        let worst = (0..ours.n()).map(apart).fold(0.0, f64::max);
        let share = worst / (AMPLIFIED * (report.residual + judged.residual) + ROUNDING);
        self.worst = self.worst.max(worst);
        if share > self.share {
            (self.share, self.seed) = (share, before.seed);
        }
    }
}

#[test]
fn every_step_of_random_groups_is_exact_and_the_referee_agrees() {
    let long = std::env::var_os("JOSTLE_LONG").is_some();
    let steps = if long { 10 * STEPS } else { STEPS };
    let (mut tally, mut refereed, mut crossed) = (Tally::default(), Refereed::default(), 0);
    let mut seed = 0;
    while tally.steps < steps {
        seed += 1;
        let (mut state, lasts) = draw(seed);
        let mut stepper = Stepper::new();
        for _ in 0..lasts {
            let before = (tally.steps % REFEREED == 0).then(|| state.clone());
            let report = match stepper.step(&mut state) {
                Ok(report) => report,
                // Some of these steps are too long for their drag.
                Err(StepError::CrossedBodies { .. }) => {
                    crossed += 1;
                    break;
                }
                Err(error) => panic!("seed {seed}, step {}: {error}", state.step),
            };
            tally += &report;
            if let Some(before) = before.filter(|_| report.active > 0) {
                refereed.judge(&before, &state, &report);
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
    println!("seeds 1 to {seed}, {crossed} of them until axes crossed: {tally}");
    println!("the fallback: {refereed:?}");
    assert!(tally.active as u64 > 5 * tally.steps, "too few push");
    assert!(
        refereed.share <= 1.0 && refereed.missed * 100 <= refereed.steps,
        "{refereed:?}"
    );
}
