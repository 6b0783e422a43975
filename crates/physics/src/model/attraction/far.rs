//! The sum over all others, with series for far groups: a fast multipole method.

use crate::model::simd::{Lanes, Level, WIDTH};
use crate::model::threads::{Pool, both, inside};

use super::direct::pull_from;
use super::expansion::{Series, evaluate, gather, lower, raise, transfer};
use super::tree::{Group, SHARED, Tree};

/// Groups whose centres are at most this far apart, in body sizes, are not summed by series, so
/// that no power of the distance leaves the range of doubles. The limit is about ten times the
/// resolution of positions at half a cell, 1e-13.
const NEAREST: f64 = 1e-12;

/// The ratio of the sum of two groups' radii to their distance below which series are used. The
/// series converge up to 1, but near 1 so slowly that the estimate of the truncation error fails.
const WIDEST: f64 = 0.7;

/// Above this share of all individuals the error estimate of a group is more than doubled. In a
/// swarm of a few flocks the errors of their series do not cancel as those of many groups do.
const FEW: f64 = 0.01;

/// Cost of `transfer` divided by `N²`, in hundredths of the cost of one source for eight targets.
/// Measured; values from 10 to 100 are as fast.
const TRANSFER_COST: usize = 30;

/// The buffers of a sum with series of order `N`.
#[derive(Clone, Debug)]
pub(super) struct Far<const N: usize> {
    moments: Vec<Series<N>>,
    sum_x: Vec<Lanes>,
    sum_y: Vec<Lanes>,
    lists: Lists,
}

/// The lists of one traversal.
#[derive(Clone, Debug, Default)]
struct Lists {
    /// Sources that are summed member by member.
    near: Vec<u32>,
    /// Sources not yet processed for the current target.
    waiting: Vec<u32>,
    /// Sources that each target on the path from the root leaves to its halves, in order of depth.
    candidates: Vec<u32>,
}

impl<const N: usize> Default for Far<N> {
    fn default() -> Self {
        Self {
            moments: Vec::new(),
            sum_x: Vec::new(),
            sum_y: Vec::new(),
            lists: Lists::default(),
        }
    }
}

impl<const N: usize> Far<N> {
    /// Sums, for every individual, the unit vectors to all others.
    ///
    /// The truncation error of one group's series is at most about `tolerance` of the whole sum,
    /// in order of magnitude.
    ///
    /// - Shapes: the sums of x and of y out, one of each per individual in the tree's order,
    ///   padded to whole lanes.
    pub fn sum(
        &mut self,
        level: Level,
        pool: Option<&Pool>,
        tree: &Tree,
        tolerance: f64,
    ) -> [&[f64]; 2] {
        let Self {
            moments,
            sum_x,
            sum_y,
            lists,
        } = self;
        for sum in [&mut *sum_x, &mut *sum_y] {
            sum.clear();
            sum.resize(tree.x.len(), [0.0; WIDTH]);
        }
        moments.clear();
        moments.resize(tree.groups.len(), Series::ZERO);
        lists.candidates.clear();
        lists.candidates.push(0);
        inside(pool, || {
            gather_all(level, pool.is_some(), tree, 0, moments);
            let mut descent = Descent {
                level,
                shared: pool.is_some(),
                tree,
                tolerance,
                moments,
                lists,
                halfway: Series::ZERO,
            };
            descent.visit(0, &Series::ZERO, 0, [sum_x, sum_y]);
        });
        [self.sum_x.as_flattened(), self.sum_y.as_flattened()]
    }
}

/// Computes the moments of a group, of its halves and of theirs.
///
/// - Shapes: one entry of `moments` for each of these groups, in the tree's order.
fn gather_all<const N: usize>(
    level: Level,
    shared: bool,
    tree: &Tree,
    own: usize,
    moments: &mut [Series<N>],
) {
    let group = &tree.groups[own];
    let (whole, halves) = moments.split_first_mut().expect("a group has an entry");
    if group.is_leaf() {
        *whole = gather(level, group.centre, tree.places(group));
        return;
    }
    let shared = shared && group.n() >= SHARED;
    let (one, other) = halves.split_at_mut(group.second - own - 1);
    both(
        shared,
        || gather_all(level, shared, tree, own + 1, one),
        || gather_all(level, shared, tree, group.second, other),
    );
    for (half, moments) in [(own + 1, &one[0]), (group.second, &other[0])] {
        raise(level, whole, moments, from_to(group, &tree.groups[half]));
    }
}

/// Returns whether adding a source of `n` individuals member by member to `blocks` blocks of eight
/// targets costs at most as much as adding its series.
const fn is_cheaper_directly<const N: usize>(blocks: usize, n: usize) -> bool {
    blocks * n * 100 <= N * N * TRANSFER_COST
}

fn from_to(one: &Group, other: &Group) -> [f64; 2] {
    [
        other.centre[0] - one.centre[0],
        other.centre[1] - one.centre[1],
    ]
}

/// A traversal of all target groups, each before its halves.
struct Descent<'a, const N: usize> {
    level: Level,
    /// Whether the halves of a group may be processed in parallel.
    shared: bool,
    tree: &'a Tree,
    tolerance: f64,
    moments: &'a [Series<N>],
    lists: &'a mut Lists,
    halfway: Series<N>,
}

impl<const N: usize> Descent<'_, N> {
    /// Adds to the sums of a target group's members its local series and the pull of the
    /// candidates from `start` on. `sums` holds the lanes of the target.
    fn visit(&mut self, target: usize, local: &Series<N>, start: usize, sums: [&mut [Lanes]; 2]) {
        let group = &self.tree.groups[target];
        let mut local = *local;
        let end = self.lists.candidates.len();
        self.lists.near.clear();
        for k in (start..end).rev() {
            self.lists.waiting.clear();
            self.lists.waiting.push(self.lists.candidates[k]);
            while let Some(source) = self.lists.waiting.pop() {
                self.add_source(group, source, &mut local);
            }
        }
        let [sum_x, sum_y] = sums;
        let at = [&self.tree.x[group.lanes()], &self.tree.y[group.lanes()]];
        for &source in &self.lists.near {
            let source = &self.tree.groups[source as usize];
            let places = self.tree.places(source);
            pull_from(self.level, at, places, [sum_x, sum_y]);
        }
        if group.is_leaf() {
            evaluate(self.level, &local, group.centre, at, [sum_x, sum_y]);
        } else {
            self.visit_halves(target, &local, end, [sum_x, sum_y]);
        }
        self.lists.candidates.truncate(end);
    }

    /// Visits both halves of a target group, each with the candidates from `start` on.
    fn visit_halves(
        &mut self,
        target: usize,
        local: &Series<N>,
        start: usize,
        [sum_x, sum_y]: [&mut [Lanes]; 2],
    ) {
        let (level, groups) = (self.level, &self.tree.groups);
        let group = &groups[target];
        let [one, other] = [target + 1, group.second];
        let lowered = |half: usize| lower(level, local, from_to(group, &groups[half]));
        let [one_x, other_x] = split(sum_x, group, &groups[other]);
        let [one_y, other_y] = split(sum_y, group, &groups[other]);
        if !self.shared || group.n() < SHARED {
            self.visit(one, &lowered(one), start, [one_x, one_y]);
            self.visit(other, &lowered(other), start, [other_x, other_y]);
            return;
        }
        let mut lists = Lists {
            candidates: self.lists.candidates[start..].to_vec(),
            ..Lists::default()
        };
        let mut second = Descent {
            lists: &mut lists,
            halfway: Series::ZERO,
            ..*self
        };
        both(
            true,
            || self.visit(one, &lowered(one), start, [one_x, one_y]),
            || second.visit(other, &lowered(other), 0, [other_x, other_y]),
        );
    }

    /// Returns whether the series of a source are accurate enough for a target. Their truncation
    /// error is of order `N` in the ratio of the radii to the distance, and is weighted by the
    /// source's share of all individuals.
    fn are_apart(&self, target: &Group, source: &Group, apart: [f64; 2]) -> bool {
        let distance = (apart[0] * apart[0] + apart[1] * apart[1]).sqrt();
        let ratio = (target.radius + source.radius) / distance;
        let square = ratio * ratio;
        let left_out = (1..N / 2).fold(square, |power, _| power * square);
        let share = source.n() as f64 / self.tree.n() as f64;
        distance > NEAREST
            && ratio < WIDEST
            && left_out * share * (1.0 + share / FEW) < self.tolerance
    }

    /// Adds a source to a target: by its series or member by member. If neither is possible yet,
    /// splits the source or leaves it to the target's halves.
    fn add_source(&mut self, target: &Group, source: u32, local: &mut Series<N>) {
        let group = &self.tree.groups[source as usize];
        let apart = from_to(target, group);
        if self.are_apart(target, group, apart) {
            if is_cheaper_directly::<N>(target.lanes().len(), group.n()) {
                self.lists.near.push(source);
            } else {
                let moments = &self.moments[source as usize];
                transfer(self.level, local, &mut self.halfway, moments, apart);
            }
        } else if group.radius > target.radius && !group.is_leaf() {
            #[expect(clippy::cast_possible_truncation, reason = "fewer groups than ids")]
            let second = group.second as u32;
            self.lists.waiting.extend([second, source + 1]);
        } else if target.is_leaf() {
            // The halves of the source would have a similar ratio and the same error together.
            self.lists.near.push(source);
        } else {
            self.lists.candidates.push(source);
        }
    }
}

fn split<'a>(lanes: &'a mut [Lanes], whole: &Group, second: &Group) -> [&'a mut [Lanes]; 2] {
    let (one, two) = lanes.split_at_mut(second.lanes().start - whole.lanes().start);
    [one, two]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_targets_or_sources_are_added_directly() {
        // At order 10 a series costs as much as 0.3 · 10² sources for eight targets.
        for (blocks, n, expected) in [
            (1, 30, true),
            (30, 1, true),
            (5, 6, true),
            (1, 31, false),
            (31, 1, false),
            (4, 8, false),
        ] {
            assert_eq!(
                is_cheaper_directly::<10>(blocks, n),
                expected,
                "{blocks} {n}"
            );
        }
    }
}
