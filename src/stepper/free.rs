//! What every individual would do alone in one step.

use crate::model::attraction::Social;
use crate::model::{Configuration, Parameters};

/// Free motion of all individuals.
#[derive(Clone, Debug, Default)]
pub struct Free {
    /// Unit vectors along the bodies.
    pub heading: Vec<[f64; 2]>,
    /// Displacement in x, y and angle.
    pub displacement: Vec<[f64; 3]>,
    social: Social,
    pull: Vec<[f64; 2]>,
}

impl Free {
    /// Computes headings and free displacements of one step.
    ///
    /// - Shapes: n individuals in; n headings, n displacements.
    /// - Source: paper, eqs. (1)-(3), (5), (6), with `c_s = π3` and `c_p` the weight times that.
    pub fn compute(&mut self, parameters: &Parameters, configuration: &Configuration) {
        let Parameters { pi3, dt, .. } = *parameters;
        self.social
            .compute(parameters.attraction, configuration, &mut self.pull);
        self.heading.clear();
        self.displacement.clear();
        for (index, social) in self.pull.iter().enumerate() {
            let (sin, cos) = libm::sincos(configuration.alpha[index]);
            let weight = configuration.weight[index];
            let mut wanted = *social;
            if weight > 0.0 {
                let (own_sin, own_cos) = libm::sincos(configuration.direction[index]);
                wanted = [wanted[0] + weight * own_cos, wanted[1] + weight * own_sin];
            }
            let turning = pi3 * (cos * wanted[1] - sin * wanted[0]);
            self.heading.push([cos, sin]);
            self.displacement.push([dt * cos, dt * sin, dt * turning]);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

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
        // Pulled up by 1 and down by 0.5, at twice the unit rate.
        let [x, y, turn] = free.displacement[0];
        assert_eq!((x, y), (0.02, 0.0));
        assert!((turn - 0.02 * 2.0 * 0.5).abs() < 1e-16);
        // The other looks away from the first: it is pulled straight back, and does not turn.
        let [x, y, turn] = free.displacement[1];
        assert!(x.abs() < 1e-17 && (y - 0.02).abs() < 1e-17 && turn.abs() < 1e-17);
    }
}
