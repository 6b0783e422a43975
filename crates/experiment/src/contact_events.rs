//! Measures the contacts of a run and their effect on the bodies.

use jostle_physics::model::body::{Body, near_pairs};
use jostle_physics::model::{CELL, Configuration, State};
use jostle_physics::stepper::{StepReport, Stepper};
use jostle_results::contact_statistics::ContactStatistics;
use serde::{Deserialize, Serialize};

/// The largest gap of two bodies that count as side by side, in body sizes.
const NEAR: f64 = 0.05;

/// The largest angle between the headings of two such bodies, in radians.
const PARALLEL: f64 = 0.25;

/// Time units between two counts of bodies side by side.
const EVERY: f64 = 1.0;

/// Sums over a run from which [`ContactStatistics`] is computed; a checkpoint contains them.
#[derive(Clone, Deserialize, Serialize)]
pub struct ContactMeter {
    /// Centroid at the start.
    from: [f64; 2],
    steps: u64,
    /// Contacts listed and contacts that pushed, summed over steps.
    listed: u64,
    pushing: u64,
    /// Individuals that contacts moved, summed over steps, and the sums of the angles and lengths
    /// by which contacts moved them.
    pushed: u64,
    turned: f64,
    shifted: f64,
    /// Counts of bodies side by side, and the sum of their results.
    samples: u64,
    beside: u64,
}

impl ContactMeter {
    /// Starts at the first state of a run.
    pub fn new(state: &State) -> Self {
        Self {
            from: centroid(&state.configuration),
            steps: 0,
            listed: 0,
            pushing: 0,
            pushed: 0,
            turned: 0.0,
            shifted: 0.0,
            samples: 0,
            beside: 0,
        }
    }

    /// Adds the step whose result is `state`.
    pub fn add(&mut self, stepper: &Stepper, report: &StepReport, state: &State) {
        self.steps += 1;
        self.listed += report.contacts as u64;
        self.pushing += report.active as u64;
        let free = &stepper.program().0.free;
        for (moved, free) in stepper.displacement().iter().zip(free) {
            // An individual without a pushing contact has exactly its free displacement.
            if moved != free {
                self.pushed += 1;
                self.turned += (moved[2] - free[2]).abs();
                let [x, y] = [moved[0] - free[0], moved[1] - free[1]];
                self.shifted += (x * x + y * y).sqrt();
            }
        }
        if state.time() >= EVERY * (self.samples + 1) as f64 {
            self.samples += 1;
            self.beside += beside(state);
        }
    }

    /// Returns the row of the run named `run`; none if it has no step.
    pub fn finish(self, run: &str, contacts: &str, state: &State) -> Option<ContactStatistics> {
        let (parameters, n) = (&state.parameters, state.configuration.n());
        let to = centroid(&state.configuration);
        let way = [to[0] - self.from[0], to[1] - self.from[1]];
        let share = |part: f64, whole: u64| if whole > 0 { part / whole as f64 } else { 0.0 };
        (self.steps > 0).then(|| ContactStatistics {
            run: run.to_owned(),
            n: n as u64,
            pi1: parameters.pi1,
            pi3: parameters.pi3,
            pi4: parameters.pi4,
            contacts: contacts.to_owned(),
            dt: parameters.dt,
            listed: share(self.listed as f64, self.steps * n as u64),
            pushing: share(self.pushing as f64, self.steps * n as u64),
            turned: share(self.turned / parameters.dt, self.pushed),
            shifted: share(self.shifted / parameters.dt, self.pushed),
            beside: share(self.beside as f64, self.samples * n as u64),
            way: (way[0] * way[0] + way[1] * way[1]).sqrt() / state.time(),
        })
    }
}

/// Returns the mean position, independent of the choice of the origin.
fn centroid(configuration: &Configuration) -> [f64; 2] {
    let near = configuration.centroid();
    [0, 1].map(|axis| near[axis] + CELL * configuration.origin[axis] as f64)
}

/// Counts the individuals with another one at their side: headings within [`PARALLEL`], a gap of at
/// most [`NEAR`], and the other's centre less than a half-length ahead or behind.
fn beside(state: &State) -> u64 {
    let State {
        parameters,
        configuration,
        ..
    } = state;
    let Configuration { x, y, alpha, .. } = configuration;
    let body = Body::new(parameters);
    let mut has = vec![false; configuration.n()];
    for (i, j, nearness) in near_pairs(body, configuration, NEAR) {
        let [i, j] = [i, j].map(|index| index as usize);
        let (sin, cos) = libm::sincos(alpha[i]);
        let along = (x[j] - x[i]) * cos + (y[j] - y[i]) * sin;
        let turn = alpha[j] - alpha[i];
        let is_parallel = libm::cos(turn) > libm::cos(PARALLEL);
        if is_parallel && along.abs() < body.half_length && !nearness.crossed {
            (has[i], has[j]) = (true, true);
        }
    }
    has.iter().filter(|&&it| it).count() as u64
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn run(poses: &[[f64; 3]], steps: u64) -> ContactStatistics {
        let mut state = State::default();
        for [x, y, alpha] in poses {
            state.configuration.push(*x, *y, *alpha);
        }
        let (mut meter, mut stepper) = (ContactMeter::new(&state), Stepper::new());
        for _ in 0..steps {
            let report = stepper.step(&mut state).unwrap();
            meter.add(&stepper, &report, &state);
        }
        meter.finish("a", "endpoints", &state).unwrap()
    }

    #[test]
    fn bodies_side_by_side_are_beside_and_turned() {
        let touch = run(&[[0.0, 0.0, 0.0], [0.0, 0.4, 0.0]], 50);
        assert_eq!((touch.n, touch.beside), (2, 1.0));
        // Free bodies would turn towards each other at rate 1; contacts cancel most of it.
        assert!(touch.turned > 0.0 && touch.turned < 1.0, "{touch:?}");
        assert!((0.5..=1.0).contains(&touch.pushing), "{touch:?}");
        assert!(touch.way > 0.99, "{touch:?}");
    }

    #[test]
    fn bodies_that_push_head_on_are_shifted_by_their_whole_way() {
        // Along y, tip to tip: each would move 1 per time unit, and stays.
        let up = std::f64::consts::FRAC_PI_2;
        let touch = run(&[[0.0, 0.0, up], [0.0, 1.6, -up]], 50);
        assert!((touch.shifted - 1.0).abs() < 1e-9, "{touch:?}");
        assert!(touch.turned < 1e-9 && touch.way < 1e-9, "{touch:?}");
        // One contact of two bodies.
        assert_eq!((touch.pushing, touch.listed, touch.beside), (0.5, 0.5, 0.0));
    }

    #[test]
    fn the_way_is_from_the_first_centroid_to_the_last() {
        // 3 along x and 4 along y in 5 time units.
        let touch = run(&[[7.0, -9.0, libm::atan2(4.0, 3.0)]], 250);
        assert!((touch.way - 1.0).abs() < 1e-12, "{touch:?}");
        let state = State::default();
        assert_eq!(
            ContactMeter::new(&state).finish("a", "endpoints", &state),
            None
        );
    }

    #[test]
    fn distant_bodies_have_no_contacts() {
        let touch = run(&[[0.0, 0.0, 0.0], [9.0, 9.0, 3.0]], 50);
        let found = (touch.pushing, touch.turned, touch.beside);
        assert_eq!(found, (0.0, 0.0, 0.0));
    }

    #[test]
    fn a_body_ahead_or_of_opposite_heading_is_not_beside() {
        assert_eq!(run(&[[0.0, 0.0, 0.0], [1.62, 0.0, 0.0]], 50).beside, 0.0);
        let opposite = [[0.0, 0.0, 0.0], [0.0, 0.41, std::f64::consts::PI]];
        assert_eq!(run(&opposite, 50).beside, 0.0);
    }
}
