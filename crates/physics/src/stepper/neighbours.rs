//! The neighbour list: pairs of bodies that could touch, reused for several steps.

use super::contact::Axes;
use super::end_contacts::{self, Pairs};
use crate::model::body::Body;
use crate::model::pairs::{PairSearch, order};
use crate::model::{Configuration, Parameters};

/// Least distance beyond the reach up to which pairs are listed, in body sizes. A larger value
/// makes every step examine more pairs; with a smaller one a list lasts for fewer steps.
const SLACK: f64 = 0.25;

/// Number of lanes in which changes are compared.
const LANES: usize = 4;

/// Margin for rounding of a distance: many times the error at the largest coordinates and angles.
const ROUNDING: f64 = 1e-6;

/// The pairs that could be in contact. The list is reused until bodies have moved too far.
///
/// A list may contain pairs that are too far apart, and never lacks a near pair; callers measure
/// every pair again. So the list affects the duration of a step but no bit of its result, and is
/// not part of a state.
#[derive(Debug, Default)]
pub struct Neighbours {
    /// The search for pairs. Its level is that of all kernels here.
    pub search: PairSearch,
    pairs: Vec<(u32, u32)>,
    /// Shape of the bodies, largest gap and configuration for which the list was built.
    body: Option<Body>,
    limit: f64,
    x: Vec<f64>,
    y: Vec<f64>,
    alpha: Vec<f64>,
}

impl Neighbours {
    /// Ensures that all pairs with a gap up to `reach` are listed, including crossed pairs.
    ///
    /// - Shapes: n individuals and n headings; [`Neighbours::pairs`] are ordered by (i, j), i < j.
    /// - Units: body sizes.
    pub fn update(
        &mut self,
        parameters: &Parameters,
        configuration: &Configuration,
        heading: &[[f64; 2]],
        reach: f64,
    ) {
        let body = Body::new(parameters);
        let is_valid = self.body == Some(body)
            && self.alpha.len() == configuration.n()
            && reach + self.drift(body, configuration) + ROUNDING <= self.limit;
        if !is_valid {
            self.list(body, configuration, heading, reach);
        }
    }

    /// Returns the listed pairs.
    #[must_use]
    pub fn pairs(&self) -> &[(u32, u32)] {
        &self.pairs
    }

    fn list(
        &mut self,
        body: Body,
        configuration: &Configuration,
        heading: &[[f64; 2]],
        reach: f64,
    ) {
        let Configuration { x, y, alpha, .. } = configuration;
        self.body = Some(body);
        self.limit = reach + reach.max(SLACK);
        let axes = self.limit + 2.0 * body.radius;
        let centres = body.centre_distance(self.limit);
        self.pairs.clear();
        let all = Axes::new(configuration, heading);
        let (level, mut lanes) = (self.search.level, Pairs::default());
        let pairs = &mut self.pairs;
        let mut keep = |near: &[(u32, u32)]| {
            for (lane, &(i, j)) in near.iter().enumerate() {
                lanes.set(lane, &all.at(i), &all.at(j), axes);
            }
            let signs = near.iter().zip(lanes.signs(level, body.half_length));
            let listed = signs.filter(|&(_, signs)| end_contacts::within(signs));
            pairs.extend(listed.map(|(&pair, _)| pair));
        };
        // Pairs whose centres are near enough are examined as soon as all lanes are filled.
        let (mut near, mut count) = ([(0, 0); end_contacts::LANES], 0);
        self.search.visit(x, y, centres, |i, j| {
            near[count] = (i, j);
            count += 1;
            if count == end_contacts::LANES {
                keep(&near);
                count = 0;
            }
        });
        keep(&near[..count]);
        order(&mut self.pairs);
        self.x.clone_from(x);
        self.y.clone_from(y);
        self.alpha.clone_from(alpha);
    }

    /// Returns an upper bound on the change of any gap since the list was built: the largest
    /// difference between the displacements of two centres, plus the largest turn times the
    /// length of the axis. A common displacement does not count.
    fn drift(&self, body: Body, configuration: &Configuration) -> f64 {
        let Configuration { x, y, alpha, .. } = configuration;
        let [left, right] = range(&self.x, x);
        let [down, up] = range(&self.y, y);
        let [clockwise, counter_clockwise] = range(&self.alpha, alpha);
        let (wide, high) = (right - left, up - down);
        let turn = f64::max(-clockwise, counter_clockwise);
        (wide * wide + high * high).sqrt() + 2.0 * body.half_length * turn
    }
}

/// Returns the least and the largest change of any entry.
fn range(before: &[f64], now: &[f64]) -> [f64; 2] {
    let (mut least, mut largest) = ([f64::INFINITY; LANES], [f64::NEG_INFINITY; LANES]);
    let mut widen = |lane: usize, change: f64| {
        least[lane] = if change < least[lane] {
            change
        } else {
            least[lane]
        };
        largest[lane] = if change > largest[lane] {
            change
        } else {
            largest[lane]
        };
    };
    let (before_blocks, before_rest) = before.as_chunks::<LANES>();
    let (now_blocks, now_rest) = now.as_chunks::<LANES>();
    for (before, now) in before_blocks.iter().zip(now_blocks) {
        for lane in 0..LANES {
            widen(lane, now[lane] - before[lane]);
        }
    }
    for (lane, (before, now)) in before_rest.iter().zip(now_rest).enumerate() {
        widen(lane, now - before);
    }
    [
        least.into_iter().fold(f64::INFINITY, f64::min),
        largest.into_iter().fold(f64::NEG_INFINITY, f64::max),
    ]
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::model::body::near_pairs;
    use crate::model::heading::unit_vectors;
    use crate::model::random::{Purpose, Stream};
    use crate::model::simd::Level;
    use crate::model::start;

    /// Updates as a step does, checks the list, and returns whether it was rebuilt.
    fn update_and_check(
        neighbours: &mut Neighbours,
        parameters: &Parameters,
        now: &Configuration,
    ) -> bool {
        let reach = parameters.reach(0.0);
        let (mut heading, before) = (Vec::new(), neighbours.alpha.clone());
        unit_vectors(Level::default(), &now.alpha, &mut heading);
        neighbours.update(parameters, now, &heading, reach);
        let near = near_pairs(Body::new(parameters), now, reach);
        for (i, j, nearness) in near {
            assert!(
                neighbours.pairs.binary_search(&(i, j)).is_ok(),
                "{i} and {j} at {nearness:?} are not listed"
            );
        }
        assert!(neighbours.pairs.is_sorted());
        before != neighbours.alpha
    }

    #[test]
    fn no_near_pair_is_missing_while_bodies_move() {
        for (pi1, n) in [(1.0, 40), (4.0, 40), (12.0, 40), (4.0, 300)] {
            let parameters = Parameters {
                pi1,
                ..Parameters::default()
            };
            let mut now = start::disc(&parameters, n, None, 5).unwrap();
            let mut neighbours = Neighbours::default();
            let mut stream = Stream::new(3, 0, 0, Purpose::Start);
            let mut lists = 0;
            for _ in 0..200 {
                lists += usize::from(update_and_check(&mut neighbours, &parameters, &now));
                for index in 0..n {
                    let mut step = |width: f64| width * (2.0 * stream.uniform() - 1.0);
                    // Bodies may cross here; a crossed pair must be listed as well.
                    now.x[index] += 0.3 + step(0.02);
                    now.y[index] += step(0.02);
                    now.alpha[index] += step(0.02);
                }
            }
            assert!((2..150).contains(&lists), "{lists} lists for {n} of {pi1}");
        }
    }

    #[test]
    fn common_motion_keeps_the_list_and_other_changes_rebuild_it() {
        let parameters = Parameters::default();
        let mut now = start::disc(&parameters, 30, None, 1).unwrap();
        let mut neighbours = Neighbours::default();
        assert!(update_and_check(&mut neighbours, &parameters, &now));
        now.x.iter_mut().for_each(|x| *x += 1024.0);
        assert!(!update_and_check(&mut neighbours, &parameters, &now));
        now.alpha[3] += TAU;
        assert!(update_and_check(&mut neighbours, &parameters, &now));
        now.remove(&[0]);
        assert!(update_and_check(&mut neighbours, &parameters, &now));
        let longer = Parameters {
            pi1: 5.0,
            ..parameters
        };
        let before = neighbours.pairs.clone();
        update_and_check(&mut neighbours, &longer, &now);
        assert_ne!(
            before, neighbours.pairs,
            "longer bodies have other neighbours"
        );
    }
}
