//! Social attraction: the vector `p_s` with which the others pull each individual.

mod direct;
mod expansion;
mod far;
mod local_laws;
mod tree;
mod voronoi;

use super::simd::Level;
use super::threads::{Pool, SHARED_FROM};
use super::{Attraction, Configuration};

use direct::Direct;
use far::Far;
use tree::Tree;

/// Settings of the series that reach an accuracy.
struct SeriesSettings {
    accuracy: f64,
    /// Number of powers of the series.
    powers: usize,
    /// Truncation error allowed for one group, as a share of the whole sum.
    tolerance: f64,
    /// Number of individuals from which on the series are faster than the direct sum; smaller
    /// groups use the direct sum.
    from: usize,
}

/// An accuracy uses the first entry that is not coarser. The errors are measured, not bounded: the
/// largest is 0.02 to 0.7 times the accuracy in one group of any shape, and up to 10 times the
/// accuracy in a swarm that has split into a few flocks.
const SETTINGS: [SeriesSettings; 7] = [
    settings(1e-3, 4, 4e-3, 1000),
    settings(1e-4, 4, 4e-4, 2000),
    settings(1e-5, 8, 2e-4, 2500),
    settings(1e-6, 8, 2e-5, 3000),
    settings(1e-7, 8, 2e-6, 4000),
    settings(1e-8, 12, 4e-7, 5000),
    settings(1e-9, 12, 4e-8, 6000),
];

const fn settings(accuracy: f64, powers: usize, tolerance: f64, from: usize) -> SeriesSettings {
    SeriesSettings {
        accuracy,
        powers,
        tolerance,
        from,
    }
}

/// Computes the social pull of every individual, and reuses its buffers from call to call.
#[derive(Clone, Debug, Default)]
pub struct AttractionWorkspace {
    /// Selects the version of the kernels; it changes no bit.
    pub level: Level,
    /// Pool whose threads share the work for large groups; it changes no bit. With a pool a call
    /// allocates lists: one of tiles in the direct sum, or three for every group whose halves are
    /// processed in parallel.
    pub pool: Option<Pool>,
    direct: Direct,
    tree: Tree,
    far_4: Far<4>,
    far_8: Far<8>,
    far_12: Far<12>,
}

impl AttractionWorkspace {
    /// Computes `p_s` of every individual into `pull`.
    ///
    /// - Shapes: n individuals in, n vectors out.
    /// - Units: none. Lengths are at most 1, up to the accuracy; under `power` they may exceed 1.
    /// - Source: paper, eq. (4). A single individual has `p_s = 0`. Of two individuals at the same
    ///   point each contributes 0 to the other and is counted. Deviations: with an accuracy, far
    ///   groups are summed by series, and `p_s` sums to 0 over the group only to that accuracy,
    ///   not to rounding. The other laws are means over the individuals that they count, and 0 if
    ///   they count none.
    pub fn compute(
        &mut self,
        attraction: Attraction,
        configuration: &Configuration,
        pull: &mut Vec<[f64; 2]>,
    ) {
        let n = configuration.n();
        pull.clear();
        pull.resize(n, [0.0; 2]);
        if n < 2 {
            return;
        }
        match attraction {
            Attraction::All { accuracy } => self.all(accuracy, configuration, pull),
            Attraction::Voronoi => voronoi::voronoi(configuration, pull),
            Attraction::Metric { radius } => local_laws::metric(configuration, radius, pull),
            Attraction::Topological { neighbours } => {
                local_laws::topological(configuration, neighbours, pull);
            }
            Attraction::Power { exponent } => local_laws::power(configuration, exponent, pull),
        }
    }

    /// Computes the mean over all others, eq. (4).
    fn all(&mut self, accuracy: Option<f64>, configuration: &Configuration, pull: &mut [[f64; 2]]) {
        let Configuration { x, y, .. } = configuration;
        let n = x.len();
        let share = 1.0 / (n as f64 - 1.0);
        let (level, pool) = (self.level, self.pool.as_ref());
        let pool = pool.filter(|_| n >= SHARED_FROM);
        let Some(settings) = accuracy
            .map(settings_of)
            .filter(|settings| n >= settings.from)
        else {
            let [sum_x, sum_y] = self.direct.sum(level, pool, x, y);
            for ((pull, x), y) in pull.iter_mut().zip(sum_x).zip(sum_y) {
                *pull = [x * share, y * share];
            }
            return;
        };
        let tree = &mut self.tree;
        tree.build(pool, x, y);
        let [sum_x, sum_y] = match settings.powers {
            4 => self.far_4.sum(level, pool, tree, settings.tolerance),
            8 => self.far_8.sum(level, pool, tree, settings.tolerance),
            _ => self.far_12.sum(level, pool, tree, settings.tolerance),
        };
        for ((index, x), y) in tree.indices().zip(sum_x).zip(sum_y) {
            pull[index] = [x * share, y * share];
        }
    }
}

fn settings_of(accuracy: f64) -> &'static SeriesSettings {
    let finest = &SETTINGS[SETTINGS.len() - 1];
    let mut all = SETTINGS.iter();
    all.find(|settings| settings.accuracy <= accuracy)
        .unwrap_or(finest)
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
        AttractionWorkspace::default().compute(Attraction::default(), &configuration, &mut pull);
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
    fn a_single_individual_has_pull_zero() {
        assert_eq!(pull_of(&[[3.0, 4.0]]), [[0.0, 0.0]]);
    }

    #[test]
    fn two_individuals_are_pulled_towards_each_other_at_any_distance() {
        let pull = pull_of(&[[0.0, 0.0], [30.0, 40.0]]);
        assert!((pull[0][0] - 0.6).abs() < 1e-15 && (pull[0][1] - 0.8).abs() < 1e-15);
        assert_eq!(pull[1], [-pull[0][0], -pull[0][1]]);
    }

    #[test]
    fn an_individual_at_the_same_point_counts_and_contributes_zero() {
        let pull = pull_of(&[[0.0, 0.0], [0.0, 0.0], [5.0, 0.0]]);
        assert_eq!(pull, [[0.5, 0.0], [0.5, 0.0], [-1.0, 0.0]]);
    }

    #[test]
    fn the_direct_sum_equals_the_plain_sum_for_every_n_and_level() {
        for n in 1..=200 {
            let configuration = example(n);
            let mut pull = Vec::new();
            AttractionWorkspace::default().compute(
                Attraction::default(),
                &configuration,
                &mut pull,
            );
            for (one, plain) in pull.iter().zip(plain(&configuration)) {
                let off = (one[0] - plain[0]).abs().max((one[1] - plain[1]).abs());
                assert!(off < 2e-15, "n = {n}: {off:e}");
            }
            for level in Level::available() {
                let mut social = AttractionWorkspace {
                    level,
                    ..AttractionWorkspace::default()
                };
                let mut same = Vec::new();
                social.compute(Attraction::default(), &configuration, &mut same);
                assert_eq!(bits(&same), bits(&pull), "n = {n} at {level:?}");
            }
        }
    }

    /// Several tiles of sources, and buffers that an earlier, larger group has used.
    #[test]
    fn tiles_add_up_and_buffers_carry_nothing_over() {
        let mut social = AttractionWorkspace::default();
        let mut pull = Vec::new();
        for n in [1100, 519, 513, 257, 9] {
            let configuration = example(n);
            social.compute(Attraction::default(), &configuration, &mut pull);
            for (one, plain) in pull.iter().zip(plain(&configuration)) {
                let off = (one[0] - plain[0]).abs().max((one[1] - plain[1]).abs());
                assert!(off < 1e-14, "n = {n}: {off:e}");
            }
        }
    }

    const ACCURACIES: [f64; 7] = [1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9];

    /// Returns the largest error of a configuration's pulls at each accuracy, with series for any
    /// number of individuals.
    fn errors(configuration: &Configuration) -> Vec<f64> {
        let Configuration { x, y, .. } = configuration;
        let mut direct = Vec::new();
        AttractionWorkspace::default().compute(Attraction::default(), configuration, &mut direct);
        let share = 1.0 / (x.len() as f64 - 1.0);
        let mut social = AttractionWorkspace::default();
        social.tree.build(None, x, y);
        let error_of = |settings: &SeriesSettings| {
            let tree = &social.tree;
            let [sum_x, sum_y] = match settings.powers {
                4 => social
                    .far_4
                    .sum(social.level, None, tree, settings.tolerance),
                8 => social
                    .far_8
                    .sum(social.level, None, tree, settings.tolerance),
                _ => social
                    .far_12
                    .sum(social.level, None, tree, settings.tolerance),
            };
            let sums = tree.indices().zip(sum_x).zip(sum_y);
            let off =
                sums.map(|((k, x), y)| (x * share - direct[k][0]).hypot(y * share - direct[k][1]));
            off.fold(0.0, f64::max)
        };
        SETTINGS.iter().map(error_of).collect()
    }

    fn made(n: u32, place: impl Fn(f64) -> [f64; 2]) -> Configuration {
        let mut configuration = Configuration::default();
        for k in 0..n {
            let [x, y] = place(f64::from(k));
            configuration.push(x, y, 0.0);
        }
        configuration
    }

    /// Returns a number in [0, 1) without a pattern that matters here.
    fn drawn(k: f64, purpose: f64) -> f64 {
        let scaled = libm::sin(k * 12.9898 + purpose * 78.233) * 43_758.545_3;
        scaled - scaled.floor()
    }

    fn disc(n: u32) -> Configuration {
        made(n, |k| {
            let angle = std::f64::consts::TAU * drawn(k, 1.0);
            let radius = (f64::from(n) * drawn(k, 2.0)).sqrt();
            [radius * libm::cos(angle), radius * libm::sin(angle)]
        })
    }

    /// Returns `count` groups of the density of touching bodies, about `apart` of their radii
    /// apart.
    fn flocks(n: u32, count: f64, apart: f64) -> Configuration {
        let radius = (f64::from(n) / count).sqrt();
        let spread = apart * radius * count.sqrt();
        let one = disc(n);
        made(n, |k| {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "whole"
            )]
            let (index, flock) = (k as usize, k % count);
            let shrink = 1.0 / count.sqrt();
            [
                spread * drawn(flock, 9.0) + shrink * one.x[index],
                spread * drawn(flock, 8.0) + shrink * one.y[index],
            ]
        })
    }

    fn assert_accurate(name: &str, configuration: &Configuration, times: f64) {
        for (error, accuracy) in errors(configuration).into_iter().zip(ACCURACIES) {
            let n = configuration.n();
            assert!(
                error <= times * accuracy,
                "{n} in a {name}: {error:e} for {accuracy:e}"
            );
        }
    }

    #[test]
    fn series_of_far_groups_reach_the_accuracy() {
        for n in [2, 3, 8, 31, 100, 500, 1000, 3000] {
            let side = f64::from(n).sqrt();
            assert_accurate("disc", &disc(n), 1.0);
            let square = made(n, |k| [side * drawn(k, 3.0), side * drawn(k, 4.0)]);
            assert_accurate("square", &square, 1.0);
            assert_accurate("line", &made(n, |k| [k, 0.0]), 1.0);
            assert_accurate("slope", &made(n, |k| [0.3 * k, 0.7 * k]), 1.0);
            assert_accurate("band", &made(n, |k| [k, 3.0 * drawn(k, 5.0)]), 1.0);
            assert_accurate("pair of flocks", &flocks(n, 2.0, 4.0), 1.0);
        }
    }

    #[test]
    fn in_far_flocks_the_error_is_at_most_ten_times_the_accuracy() {
        for n in [500, 3000] {
            for (count, apart) in [(3.0, 4.0), (5.0, 4.0), (5.0, 40.0), (20.0, 40.0)] {
                assert_accurate("few flocks", &flocks(n, count, apart), 10.0);
            }
        }
    }

    #[test]
    fn coincident_points_keep_the_accuracy() {
        let pairs = made(600, |k| [(k / 2.0).floor(), 0.0]);
        let all = made(300, |_| [7.0, -7.0]);
        let two = made(300, |k| [1e-200 * (k % 2.0), 1e3 * (k / 100.0).floor()]);
        for configuration in [pairs, all, two] {
            for (error, accuracy) in errors(&configuration).into_iter().zip(ACCURACIES) {
                assert!(error <= accuracy, "{error:e} for {accuracy}");
            }
        }
    }

    #[test]
    fn series_give_the_same_bytes_at_every_level_and_after_any_other_call() {
        let configuration = disc(9000);
        for accuracy in ACCURACIES {
            let attraction = Attraction::All {
                accuracy: Some(accuracy),
            };
            let [mut pull, mut same] = [Vec::new(), Vec::new()];
            AttractionWorkspace::default().compute(attraction, &configuration, &mut pull);
            for level in Level::available() {
                let mut social = AttractionWorkspace {
                    level,
                    ..AttractionWorkspace::default()
                };
                for before in [made(9000, |k| [-k, k % 100.0]), configuration.clone()] {
                    social.compute(attraction, &before, &mut same);
                }
                assert_eq!(bits(&same), bits(&pull), "{accuracy} at {level:?}");
            }
        }
    }
}
