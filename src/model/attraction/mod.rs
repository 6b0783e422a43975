//! Social attraction: where each individual wants to turn because of the others.

mod direct;

use super::lanes::{self, Level};
use super::{Attraction, Configuration};

use direct::Direct;

/// Computes the social pull of every individual; holds what is reused from call to call.
#[derive(Clone, Debug)]
pub struct Social {
    /// Which version of the kernels runs; it changes no bit.
    pub level: Level,
    direct: Direct,
}

impl Default for Social {
    fn default() -> Self {
        Self {
            level: lanes::level(),
            direct: Direct::default(),
        }
    }
}

impl Social {
    /// Computes `p_s` of every individual into `pull`.
    ///
    /// - Shapes: n individuals in, n vectors out.
    /// - Units: lengths at most 1, to rounding. Alone, an individual is pulled nowhere; one at
    ///   the same place pulls nowhere but is counted.
    /// - Source: paper, eq. (4).
    pub fn compute(
        &mut self,
        attraction: Attraction,
        configuration: &Configuration,
        pull: &mut Vec<[f64; 2]>,
    ) {
        let Configuration { x, y, .. } = configuration;
        pull.clear();
        if x.len() < 2 {
            pull.resize(x.len(), [0.0; 2]);
            return;
        }
        let [sum_x, sum_y] = match attraction {
            Attraction::All => self.direct.sum(self.level, x, y),
        };
        let share = 1.0 / (x.len() as f64 - 1.0);
        let sums = sum_x.iter().zip(sum_y).take(x.len());
        pull.extend(sums.map(|(x, y)| [x * share, y * share]));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pull_of(places: &[[f64; 2]]) -> Vec<[f64; 2]> {
        let mut configuration = Configuration::default();
        places.iter().for_each(|place| {
            configuration.push(place[0], place[1], 0.0);
        });
        let mut pull = Vec::new();
        Social::default().compute(Attraction::All, &configuration, &mut pull);
        pull
    }

    fn example(n: u32) -> Configuration {
        let mut configuration = Configuration::default();
        for k in (0..n).map(f64::from) {
            let side = f64::from(n).sqrt();
            configuration.push(side * libm::sin(1.7 * k), side * libm::cos(k * k), 0.0);
        }
        configuration
    }

    fn plain(configuration: &Configuration) -> Vec<[f64; 2]> {
        let Configuration { x, y, .. } = configuration;
        let towards = |i: usize, j: usize| {
            let (dx, dy) = (x[j] - x[i], y[j] - y[i]);
            let share = 1.0 / (x.len() as f64 - 1.0);
            [dx / dx.hypot(dy) * share, dy / dx.hypot(dy) * share]
        };
        let pull_of = |i: usize| {
            let others = (0..x.len()).filter(|&j| j != i);
            others
                .map(|j| towards(i, j))
                .fold([0.0, 0.0], |sum, one| [sum[0] + one[0], sum[1] + one[1]])
        };
        (0..x.len()).map(pull_of).collect()
    }

    fn bits(pull: &[[f64; 2]]) -> Vec<u64> {
        pull.as_flattened().iter().map(|it| it.to_bits()).collect()
    }

    #[test]
    fn one_alone_is_pulled_nowhere() {
        assert_eq!(pull_of(&[[3.0, 4.0]]), [[0.0, 0.0]]);
    }

    #[test]
    fn two_are_pulled_towards_each_other_whatever_their_distance() {
        let pull = pull_of(&[[0.0, 0.0], [30.0, 40.0]]);
        assert!((pull[0][0] - 0.6).abs() < 1e-15 && (pull[0][1] - 0.8).abs() < 1e-15);
        assert_eq!(pull[1], [-pull[0][0], -pull[0][1]]);
    }

    #[test]
    fn an_individual_at_the_same_place_counts_but_pulls_nowhere() {
        let pull = pull_of(&[[0.0, 0.0], [0.0, 0.0], [5.0, 0.0]]);
        assert_eq!(pull, [[0.5, 0.0], [0.5, 0.0], [-1.0, 0.0]]);
    }

    #[test]
    fn every_number_of_individuals_adds_up_to_the_plain_sum_at_every_level() {
        for n in 1..=200 {
            let configuration = example(n);
            let mut pull = Vec::new();
            Social::default().compute(Attraction::All, &configuration, &mut pull);
            for (one, plain) in pull.iter().zip(plain(&configuration)) {
                let off = (one[0] - plain[0]).abs().max((one[1] - plain[1]).abs());
                assert!(off < 2e-15, "n = {n}: {off:e}");
            }
            for level in Level::available() {
                let mut social = Social {
                    level,
                    ..Social::default()
                };
                let mut same = Vec::new();
                social.compute(Attraction::All, &configuration, &mut same);
                assert_eq!(bits(&same), bits(&pull), "n = {n} at {level:?}");
            }
        }
    }

    /// Far more than a tile of sources, and used before for a larger group.
    #[test]
    fn tiles_add_up_and_leave_nothing_behind() {
        let mut social = Social::default();
        let mut pull = Vec::new();
        for n in [1100, 519, 513, 257, 9] {
            let configuration = example(n);
            social.compute(Attraction::All, &configuration, &mut pull);
            for (one, plain) in pull.iter().zip(plain(&configuration)) {
                let off = (one[0] - plain[0]).abs().max((one[1] - plain[1]).abs());
                assert!(off < 1e-14, "n = {n}: {off:e}");
            }
        }
    }
}
