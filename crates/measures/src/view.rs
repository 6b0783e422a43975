//! A state with what several measures need.

use std::cell::{Cell, OnceCell, RefCell};
use std::rc::Rc;

use jostle_physics::model::body::Body;
use jostle_physics::model::heading::unit_vectors;
use jostle_physics::model::{State, simd};
use jostle_physics::observables::{Definitions, Order, common_direction, order_of};

use crate::gaps::{NearPair, near_pairs_within, sizes, smallest_gaps};
use crate::past::{Frame, Past};
use crate::positions::Positions;

/// A measure, as its index in the definitions and its argument.
type Key = (usize, Option<f64>);

/// Measures and their values.
type Values = Vec<(Key, Option<f64>)>;

/// A state with what its measures share, computed at first use.
pub struct View<'a> {
    state: &'a State,
    definitions: Definitions,
    past: Cell<&'a Past>,
    first: Cell<u64>,
    /// The values of measures without a past, and of those with the present one.
    values: RefCell<[Values; 2]>,
    headings: OnceCell<Vec<[f64; 2]>>,
    order: OnceCell<Order>,
    centred: OnceCell<Vec<[f64; 2]>>,
    /// The largest gap that a measure is expected to need.
    largest_gap: Cell<f64>,
    /// The pairs of individuals within a gap, and that gap.
    near: RefCell<Option<(f64, Rc<Vec<NearPair>>)>>,
    /// The sizes of clusters, by gap.
    clusters: RefCell<Vec<(f64, Rc<Vec<usize>>)>>,
    positions: OnceCell<Option<Positions>>,
    distances: OnceCell<Option<Vec<f64>>>,
    gaps: OnceCell<Option<Vec<f64>>>,
}

impl<'a> View<'a> {
    /// Creates the view of a state. Whether `past` also has the step of `state` does not matter.
    #[must_use]
    pub fn new(state: &'a State, past: &'a Past) -> Self {
        Self {
            state,
            definitions: Definitions::default(),
            past: Cell::new(past),
            first: Cell::new(0),
            values: RefCell::default(),
            headings: OnceCell::new(),
            order: OnceCell::new(),
            centred: OnceCell::new(),
            largest_gap: Cell::new(0.0),
            near: RefCell::default(),
            clusters: RefCell::default(),
            positions: OnceCell::new(),
            distances: OnceCell::new(),
            gaps: OnceCell::new(),
        }
    }

    /// Returns the view under other definitions than the present ones.
    #[must_use]
    pub fn under(self, definitions: Definitions) -> Self {
        Self {
            definitions,
            ..self
        }
    }

    /// Returns the state.
    #[must_use]
    pub fn state(&self) -> &'a State {
        self.state
    }

    /// Ignores the past before step `first` from now on, as if it had been recorded since then.
    pub fn ignore_before(&self, first: u64) {
        self.first.set(first);
    }

    /// Uses another past from now on.
    pub fn use_past(&self, past: &'a Past) {
        self.past.set(past);
        self.values.borrow_mut()[1].clear();
    }

    /// The first step of the past that is not ignored.
    pub(crate) fn first(&self) -> u64 {
        self.first.get()
    }

    /// The largest gap of measures that follow is at least this one.
    pub(crate) fn expect_gap(&self, gap: f64) {
        self.largest_gap.set(self.largest_gap.get().max(gap));
    }

    /// Returns the value of a measure, with or without a past, which `evaluate` computes the first time.
    pub(crate) fn value(
        &self,
        key: Key,
        needs_past: bool,
        evaluate: impl FnOnce(&Self) -> Option<f64>,
    ) -> Option<f64> {
        let kind = usize::from(needs_past);
        let known = |values: &Values| values.iter().find(|(it, _)| *it == key).copied();
        if let Some((_, value)) = known(&self.values.borrow()[kind]) {
            return value;
        }
        let value = evaluate(self);
        self.values.borrow_mut()[kind].push((key, value));
        value
    }

    /// Returns the positions and headings `steps` steps before the state.
    pub(crate) fn frame_before(&self, steps: u64) -> Option<&'a Frame> {
        let step = self.state.step.checked_sub(steps)?;
        (step >= self.first.get()).then(|| self.past.get().at(step))?
    }

    /// Returns the number of individuals as a divisor; 1 for an empty group.
    pub(crate) fn count(&self) -> f64 {
        self.state.configuration.n().max(1) as f64
    }

    /// Returns the headings of the n individuals, as unit vectors.
    #[must_use]
    pub fn headings(&self) -> &[[f64; 2]] {
        self.headings.get_or_init(|| {
            let mut headings = Vec::new();
            let alpha = &self.state.configuration.alpha;
            unit_vectors(simd::level(), alpha, &mut headings);
            headings
        })
    }

    /// Returns order, drift and the common direction of the informed individuals.
    #[must_use]
    pub fn order(&self) -> &Order {
        self.order.get_or_init(|| {
            let common = common_direction(&self.state.configuration, self.definitions);
            order_of(self.headings().iter().copied(), common)
        })
    }

    /// Returns the n positions relative to the centroid, in body sizes. The centroid is computed
    /// twice, the second time relative to the first result: so it has the rounding error of the
    /// group's extent, not that of its distance from the origin.
    pub(crate) fn centred(&self) -> &[[f64; 2]] {
        self.centred.get_or_init(|| {
            let configuration = &self.state.configuration;
            let [x, y] = configuration.centroid();
            let places = configuration.x.iter().zip(&configuration.y);
            let mut centred: Vec<[f64; 2]> = places.map(|(&xi, &yi)| [xi - x, yi - y]).collect();
            let mut rest = [0.0; 2];
            for place in &centred {
                rest = [rest[0] + place[0], rest[1] + place[1]];
            }
            let rest = rest.map(|sum| sum / self.count());
            for place in &mut centred {
                *place = [place[0] - rest[0], place[1] - rest[1]];
            }
            centred
        })
    }

    /// Returns the pairs of individuals within `gap`, or within a larger one.
    fn near(&self, gap: f64) -> Rc<Vec<NearPair>> {
        let mut near = self.near.borrow_mut();
        if let Some((_, pairs)) = near.as_ref().filter(|(searched, _)| *searched >= gap) {
            return pairs.clone();
        }
        let gap = gap.max(self.largest_gap.get());
        let (parameters, configuration) = (&self.state.parameters, &self.state.configuration);
        let pairs = Rc::new(near_pairs_within(parameters, configuration, gap));
        *near = Some((gap, pairs.clone()));
        pairs
    }

    /// Returns the number of pairs of individuals with a gap of at most `gap`.
    pub(crate) fn count_pairs(&self, gap: f64) -> usize {
        self.near(gap).iter().filter(|it| it.gap <= gap).count()
    }

    /// Returns the sizes of the clusters of individuals connected by gaps of at most `gap`, the
    /// largest first.
    pub(crate) fn clusters(&self, gap: f64) -> Rc<Vec<usize>> {
        let mut clusters = self.clusters.borrow_mut();
        if let Some((_, sizes)) = clusters.iter().find(|(of, _)| *of == gap) {
            return sizes.clone();
        }
        let near = self.near(gap);
        let within = near.iter().filter(|it| it.gap <= gap);
        let n = self.state.configuration.n();
        let sizes = Rc::new(sizes(n, within.map(|it| it.pair)));
        clusters.push((gap, sizes.clone()));
        sizes
    }

    /// Returns the triangulation of the positions; `None` if they are not finite.
    pub(crate) fn positions(&self) -> Option<&Positions> {
        let configuration = &self.state.configuration;
        let positions = self.positions.get_or_init(|| Positions::new(configuration));
        positions.as_ref()
    }

    /// Returns the distances of the individuals to the nearest other one, ascending; `None` if there
    /// are fewer than two.
    pub(crate) fn nearest_distances(&self) -> Option<&[f64]> {
        let distances = self.distances.get_or_init(|| {
            let positions = self.positions_of_several()?;
            Some(ascending(positions.nearest_distances()))
        });
        distances.as_deref()
    }

    /// Returns the gaps of the individuals to the one with the smallest gap, ascending; `None` if
    /// there are fewer than two individuals.
    pub(crate) fn smallest_gaps(&self) -> Option<&[f64]> {
        let gaps = self.gaps.get_or_init(|| {
            let positions = self.positions_of_several()?;
            let body = Body::new(&self.state.parameters);
            let gaps = smallest_gaps(body, &self.state.configuration, positions);
            Some(ascending(gaps))
        });
        gaps.as_deref()
    }

    fn positions_of_several(&self) -> Option<&Positions> {
        match self.state.configuration.n() {
            0 | 1 => None,
            _ => self.positions(),
        }
    }
}

fn ascending(mut values: Vec<f64>) -> Vec<f64> {
    values.sort_unstable_by(f64::total_cmp);
    values
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::Measure;
    use crate::testing::discs;

    #[test]
    fn equal_measures_are_evaluated_once_and_gaps_share_one_search() {
        let state = discs(&[[0.0, 0.0], [1.2, 0.0], [4.0, 0.0]]);
        let (past, other) = (Past::default(), Past::default());
        let view = View::new(&state, &past);
        let mut count = 0;
        for (key, needs_past) in [((0, None), false), ((1, Some(0.5)), true)] {
            for _ in 0..3 {
                view.value(key, needs_past, |_| {
                    count += 1;
                    None
                });
            }
        }
        assert_eq!(count, 2);
        // Another past has values of its own, and those without one stay.
        view.use_past(&other);
        for (key, needs_past) in [((0, None), false), ((1, Some(0.5)), true)] {
            view.value(key, needs_past, |_| {
                count += 1;
                None
            });
        }
        assert_eq!(count, 3);

        let measures = [
            "clusters.count(0.1)",
            "contacts_per_body(2)",
            "clusters.largest(0.5)",
        ];
        let measures = measures.map(|it| it.parse::<Measure>().unwrap());
        measures.iter().for_each(|it| it.announce(&view));
        let values = measures.map(|it| it.value(&view));
        assert_eq!(values, [Some(3.0), Some(4.0 / 3.0), Some(2.0)]);
        assert!(Rc::ptr_eq(&view.near(0.1), &view.near(2.0)));
        assert!(Rc::ptr_eq(&view.clusters(0.5), &view.clusters(0.5)));
    }
}
