//! Free motion: the displacement of every individual in one step without contacts.

use crate::model::attraction::AttractionWorkspace;
use crate::model::heading::unit_vectors;
use crate::model::random::{Purpose, Stream};
use crate::model::simd::Level;
use crate::model::{Configuration, Drive, Parameters, State};

/// Free motion of all individuals.
#[derive(Clone, Debug, Default)]
pub struct Free {
    /// Instruction set of the kernels; it changes no bit of a result.
    pub level: Level,
    /// Unit vectors along the bodies.
    pub heading: Vec<[f64; 2]>,
    /// Displacement in x, y and angle; only [`Free::compute`] sets it.
    pub displacement: Vec<[f64; 3]>,
    attraction: AttractionWorkspace,
    pull: Vec<[f64; 2]>,
    /// Unit vectors along the preferred directions, if any individual has one.
    own: Vec<[f64; 2]>,
}

impl Free {
    /// Computes headings and free displacements of one step.
    ///
    /// - Shapes: n individuals; n headings and n displacements.
    /// - Units: body sizes and radians.
    /// - Source: paper, eqs. (1)-(3), (5), (6), with `c_s = π3` and `c_p` the weight times that.
    pub fn compute(&mut self, parameters: &Parameters, configuration: &Configuration) {
        let mut pull = std::mem::take(&mut self.pull);
        self.attraction
            .compute(parameters.attraction, configuration, &mut pull);
        self.compute_headings(configuration);
        let mut displacement = std::mem::take(&mut self.displacement);
        self.steer(parameters, configuration, &pull, &mut displacement);
        self.displacement = displacement;
        self.pull = pull;
    }

    /// Computes the headings of n individuals into [`Free::heading`].
    pub fn compute_headings(&mut self, configuration: &Configuration) {
        unit_vectors(self.level, &configuration.alpha, &mut self.heading);
    }

    /// Computes free displacements from [`Free::heading`] and from `pull`, the result of
    /// [`AttractionWorkspace::compute`].
    ///
    /// - Shapes: n individuals, n headings, n vectors of `pull`; n displacements.
    /// - Source: paper, eqs. (1)-(3), (5), (6).
    pub fn steer(
        &mut self,
        parameters: &Parameters,
        configuration: &Configuration,
        pull: &[[f64; 2]],
        displacement: &mut Vec<[f64; 3]>,
    ) {
        let Parameters { pi3, dt, .. } = *parameters;
        let moved = |[cos, sin]: [f64; 2], preference: [f64; 2]| {
            let turning = pi3 * (cos * preference[1] - sin * preference[0]);
            [dt * cos, dt * sin, dt * turning]
        };
        displacement.clear();
        let inputs = self.heading.iter().zip(pull);
        let weight = &configuration.weight;
        if weight.iter().all(|&weight| weight == 0.0) {
            let free = inputs.map(|(&heading, &pull)| moved(heading, pull));
            displacement.extend(free);
            return;
        }
        unit_vectors(self.level, &configuration.direction, &mut self.own);
        let preferred = weight.iter().zip(&self.own);
        let free = inputs
            .zip(preferred)
            .map(|((&heading, pull), (weight, own))| {
                let preference = [pull[0] + weight * own[0], pull[1] + weight * own[1]];
                moved(heading, if *weight > 0.0 { preference } else { *pull })
            });
        displacement.extend(free);
    }
}

/// Applies the drives, beyond the paper: replaces a driven individual's turning rate by the given
/// one, limited to `±ω` with `ω = π3 (1 + largest weight)`, and multiplies its speed by a factor
/// from 0 to 1.
///
/// `ω` bounds the free turning rate under every law of attraction but `power`. The longest step
/// and the reach of contacts are computed from `ω`, and a driven individual stays within it.
///
/// - Shapes: n individuals and n displacements.
pub fn drive(
    parameters: &Parameters,
    configuration: &Configuration,
    displacement: &mut [[f64; 3]],
) {
    if configuration.drives.is_empty() {
        return;
    }
    let limit = parameters.turning_rate_scale(configuration.largest_weight());
    for (id, Drive { turn, speed }) in &configuration.drives {
        let Ok(individual) = configuration.id.binary_search(id) else {
            continue;
        };
        let [x, y, angle] = &mut displacement[individual];
        if let Some(turn) = turn {
            *angle = parameters.dt * turn.clamp(-limit, limit);
        }
        if let Some(speed) = speed {
            *x *= speed;
            *y *= speed;
        }
    }
}

/// Adds white noise of intensity `D_α` to the turns: `√(2 D_α dt) ξ`, ξ standard normal.
///
/// Each draw is a function of seed, step, id and purpose, so the order of evaluation and a restart
/// do not change it.
///
/// - Shapes: n individuals and n displacements.
pub fn add_noise(state: &State, displacement: &mut [[f64; 3]]) {
    let Parameters { noise, dt, .. } = state.parameters;
    if noise == 0.0 {
        return;
    }
    let spread = (2.0 * noise * dt).sqrt();
    for (&id, [_, _, turn]) in state.configuration.id.iter().zip(displacement) {
        *turn +=
            spread * Stream::new(state.seed, state.step, u64::from(id), Purpose::Noise).normal();
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    #[test]
    fn a_driven_individual_follows_its_drive_within_the_turning_limit() {
        let parameters = Parameters::default();
        let mut configuration = Configuration::default();
        for place in 0..3 {
            configuration.push(5.0 * f64::from(place), 0.0, FRAC_PI_2);
        }
        let mut free = Free::default();
        free.compute(&parameters, &configuration);
        let free_motion = free.displacement.clone();
        let driven = |turn, speed| Drive { turn, speed };
        configuration.drives.insert(0, driven(Some(0.5), None));
        configuration
            .drives
            .insert(2, driven(Some(-1e6), Some(0.25)));
        drive(&parameters, &configuration, &mut free.displacement);
        let [first, second, third] = free.displacement[..] else {
            panic!("expected three displacements");
        };
        assert_eq!(first, [free_motion[0][0], free_motion[0][1], 0.02 * 0.5]);
        assert_eq!(second, free_motion[1]);
        let [x, y, _] = free_motion[2];
        assert!(x != 0.0, "a right angle is rounded");
        assert_eq!(third[..2], [0.25 * x, 0.25 * y]);
        assert_eq!(third[2], -0.02 * parameters.turning_rate_scale(0.0));
    }

    #[test]
    fn an_informed_individual_turns_between_the_others_and_its_own_direction() {
        let parameters = Parameters {
            pi3: 2.0,
            ..Parameters::default()
        };
        let mut configuration = Configuration::default();
        configuration.push(0.0, 0.0, 0.0);
        configuration.push(0.0, 5.0, FRAC_PI_2);
        configuration.inform(0, 0.5, -FRAC_PI_2, None);
        let mut free = Free::default();
        free.compute(&parameters, &configuration);
        // The pull is 1 upwards, the own direction 0.5 downwards; `pi3` doubles the rate.
        let [x, y, turn] = free.displacement[0];
        assert_eq!((x, y), (0.02, 0.0));
        assert!((turn - 0.02 * 2.0 * 0.5).abs() < 1e-16);
        // The second individual faces away from the first: the pull is backwards and turns nothing.
        let [x, y, turn] = free.displacement[1];
        assert!(x.abs() < 1e-17 && (y - 0.02).abs() < 1e-17 && turn.abs() < 1e-17);
    }

    #[test]
    fn noise_is_white_and_each_draw_depends_on_step_and_id() {
        let mut state = State {
            seed: 5,
            ..State::default()
        };
        (0..20_000).for_each(|k| {
            state.configuration.push(f64::from(k), 0.0, 0.0);
        });
        let turns = |state: &State| {
            let mut displacement = vec![[0.0; 3]; state.configuration.n()];
            add_noise(state, &mut displacement);
            displacement
                .iter()
                .map(|moved| moved[2])
                .collect::<Vec<_>>()
        };
        assert!(
            turns(&state).iter().all(|&turn| turn == 0.0),
            "off by default"
        );
        state.parameters.noise = 0.3;
        let first = turns(&state);
        let count = first.len() as f64;
        let mean = first.iter().sum::<f64>() / count;
        let variance = first.iter().map(|turn| turn * turn).sum::<f64>() / count;
        let expected = 2.0 * 0.3 * 0.02;
        assert!(mean.abs() < 4.0 * (expected / count).sqrt(), "{mean}");
        assert!((variance / expected - 1.0).abs() < 4.0 * (2.0 / count).sqrt());
        // After the removal of the first individual, the draws of the others are the same.
        state.configuration.remove(&[0]);
        assert_eq!(turns(&state), first[1..]);
        state.step = 1;
        let next = turns(&state);
        let together: f64 = next.iter().zip(&first[1..]).map(|(a, b)| a * b).sum();
        assert!((together / count / expected).abs() < 4.0 / count.sqrt());
    }
}
