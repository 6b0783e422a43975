//! A state with what several measures need.

use std::borrow::Cow;
use std::cell::{Cell, OnceCell};

use jostle_physics::model::body::Body;
use jostle_physics::model::heading::unit_vectors;
use jostle_physics::model::{State, simd};
use jostle_physics::observables::{Order, common_direction, order_of};

use crate::gaps::{TOUCHING, pairs_within_gap, sizes, smallest_gaps};
use crate::past::{Frame, Past};
use crate::positions::Positions;

/// A state with what its measures share, computed at first use.
pub struct View<'a> {
    state: &'a State,
    past: &'a Past,
    first: Cell<u64>,
    headings: OnceCell<Vec<[f64; 2]>>,
    order: OnceCell<Order>,
    centred: OnceCell<Vec<[f64; 2]>>,
    touching: OnceCell<Vec<(u32, u32)>>,
    clusters: OnceCell<Vec<usize>>,
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
            past,
            first: Cell::new(0),
            headings: OnceCell::new(),
            order: OnceCell::new(),
            centred: OnceCell::new(),
            touching: OnceCell::new(),
            clusters: OnceCell::new(),
            positions: OnceCell::new(),
            distances: OnceCell::new(),
            gaps: OnceCell::new(),
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

    /// Returns the positions and headings `steps` steps before the state.
    pub(crate) fn frame_before(&self, steps: u64) -> Option<&'a Frame> {
        let step = self.state.step.checked_sub(steps)?;
        (step >= self.first.get()).then(|| self.past.at(step))?
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
            let common = common_direction(&self.state.configuration);
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

    /// Returns the pairs of individuals with a gap of at most `gap`, by index.
    pub(crate) fn pairs(&self, gap: f64) -> Cow<'_, [(u32, u32)]> {
        let compute = || pairs_within_gap(&self.state.parameters, &self.state.configuration, gap);
        match gap == TOUCHING {
            true => Cow::Borrowed(self.touching.get_or_init(compute)),
            false => Cow::Owned(compute()),
        }
    }

    /// Returns the sizes of the clusters of individuals connected by gaps of at most `gap`, the
    /// largest first.
    pub(crate) fn clusters(&self, gap: f64) -> Cow<'_, [usize]> {
        let compute = || sizes(self.state.configuration.n(), &self.pairs(gap));
        match gap == TOUCHING {
            true => Cow::Borrowed(self.clusters.get_or_init(compute)),
            false => Cow::Owned(compute()),
        }
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
