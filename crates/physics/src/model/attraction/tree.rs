//! The tree of groups of a configuration: a group is halved along its longer side down to leaves.

use crate::model::simd::{Lanes, WIDTH};
use crate::model::threads::{Pool, both, inside};

use super::direct::fill_lanes;

/// Maximum number of individuals in a leaf. Values between 24 and 64 hardly differ in speed;
/// larger leaves need less memory.
const MAX_LEAF: usize = 48;

/// Minimum number of individuals of a group whose halves are processed in parallel if a pool is
/// given: about 0.2 ms of work, to which the transfer to another thread adds little.
pub(super) const SHARED: usize = 250;

/// An individual and its position.
#[derive(Clone, Copy, Debug)]
struct Placed {
    x: f64,
    y: f64,
    index: u32,
}

/// A group of individuals: `first..last` in the tree's order.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Group {
    pub first: usize,
    pub last: usize,
    /// The middle of the members' bounding box.
    pub centre: [f64; 2],
    /// The largest distance of a member from the centre.
    pub radius: f64,
    /// Index of the second half; the first half follows the group itself. 0 for a leaf.
    pub second: usize,
}

impl Group {
    /// Returns the number of members.
    pub fn n(&self) -> usize {
        self.last - self.first
    }

    pub fn is_leaf(&self) -> bool {
        self.second == 0
    }

    /// Returns the lanes that hold the group; they hold no other individual.
    pub fn lanes(&self) -> std::ops::Range<usize> {
        self.first / WIDTH..self.last.div_ceil(WIDTH)
    }
}

/// All groups, each before its halves, and all individuals in the order of the leaves.
///
/// The tree depends on the configuration alone: halves are separated by (coordinate, index) and a
/// leaf is sorted by index. Sorting starts from the order of the last tree, which only saves time.
#[derive(Clone, Debug, Default)]
pub(super) struct Tree {
    pub groups: Vec<Group>,
    placed: Vec<Placed>,
    pub x: Vec<Lanes>,
    pub y: Vec<Lanes>,
}

impl Tree {
    /// Sorts all individuals into groups.
    pub fn build(&mut self, pool: Option<&Pool>, x: &[f64], y: &[f64]) {
        let n = x.len();
        if self.placed.len() != n {
            let n = u32::try_from(n).expect("ids are 32 bits wide");
            let indices = 0..n;
            self.placed.clear();
            self.placed.extend(indices.map(|index| Placed {
                x: 0.0,
                y: 0.0,
                index,
            }));
        }
        for placed in &mut self.placed {
            placed.x = x[placed.index as usize];
            placed.y = y[placed.index as usize];
        }
        self.groups.clear();
        self.groups.resize(groups_of(n), Group::default());
        let (groups, placed) = (&mut self.groups, &mut self.placed);
        inside(pool, || halve(pool.is_some(), groups, placed, [0, 0]));
        fill_lanes(&mut self.x, self.placed.iter().map(|placed| placed.x));
        fill_lanes(&mut self.y, self.placed.iter().map(|placed| placed.y));
    }

    /// Returns the number of individuals.
    pub fn n(&self) -> usize {
        self.placed.len()
    }

    /// Returns the coordinates of a group's members, x and y.
    pub fn places(&self, group: &Group) -> [&[f64]; 2] {
        let range = group.first..group.last;
        [
            &self.x.as_flattened()[range.clone()],
            &self.y.as_flattened()[range],
        ]
    }

    /// Returns the indices of the individuals in the tree's order.
    pub fn indices(&self) -> impl Iterator<Item = usize> {
        self.placed.iter().map(|placed| placed.index as usize)
    }
}

/// Returns the size of a group's first half: a multiple of [`WIDTH`], so that the halves share no
/// group of lanes.
fn half_of(n: usize) -> usize {
    n.div_ceil(2).next_multiple_of(WIDTH)
}

/// Returns the number of groups in a subtree of `n` individuals, itself included.
fn groups_of(n: usize) -> usize {
    if n <= MAX_LEAF {
        return 1;
    }
    let half = half_of(n);
    1 + groups_of(half) + groups_of(n - half)
}

/// Builds the subtree of a group: halves the group until its parts are leaves.
///
/// - Shapes: `groups` receives the group and all groups below it; `placed` holds its members and
///   is reordered. `places` is the index of the first of each in the tree.
fn halve(shared: bool, groups: &mut [Group], placed: &mut [Placed], places: [usize; 2]) {
    let mut low = [f64::INFINITY; 2];
    let mut high = [f64::NEG_INFINITY; 2];
    for &Placed { x, y, .. } in &*placed {
        low = [low[0].min(x), low[1].min(y)];
        high = [high[0].max(x), high[1].max(y)];
    }
    let centre = [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])];
    let square = placed.iter().fold(0.0, |largest: f64, placed| {
        let (dx, dy) = (placed.x - centre[0], placed.y - centre[1]);
        largest.max(dx * dx + dy * dy)
    });
    let [own, first] = places;
    let (group, halves) = groups.split_first_mut().expect("a group has an entry");
    *group = Group {
        first,
        last: first + placed.len(),
        centre,
        radius: square.sqrt(),
        second: 0,
    };
    if placed.len() <= MAX_LEAF {
        placed.sort_unstable_by_key(|placed| placed.index);
        return;
    }
    let half = half_of(placed.len());
    let by_index = |one: &Placed, other: &Placed| one.index.cmp(&other.index);
    if high[0] - low[0] > high[1] - low[1] {
        placed.select_nth_unstable_by(half, |one, other| {
            one.x.total_cmp(&other.x).then_with(|| by_index(one, other))
        });
    } else {
        placed.select_nth_unstable_by(half, |one, other| {
            one.y.total_cmp(&other.y).then_with(|| by_index(one, other))
        });
    }
    let shared = shared && placed.len() >= SHARED;
    let (one, other) = placed.split_at_mut(half);
    let (groups_one, groups_other) = halves.split_at_mut(groups_of(half));
    group.second = own + 1 + groups_one.len();
    let places_other = [group.second, first + half];
    both(
        shared,
        || halve(shared, groups_one, one, [own + 1, first]),
        || halve(shared, groups_other, other, places_other),
    );
}
