//! The sum over all others, term by term.

use std::ops::Range;

use crate::model::simd::{Lanes, Level, WIDTH, multiversion};
use crate::model::threads::Pool;

/// Coordinate of a lane without an individual. The square of its distance from any individual
/// rounds to an infinite `f32`, so its unit vectors are exactly 0.
const PADDING: f64 = 1e30;

/// Added to the square of a distance, so that an individual itself, and any other at the same
/// point, contributes exactly 0 without a branch. Its inverse root is a normal `f32`. For
/// distances from 2e-10 on it is below rounding; at 1e-13, the resolution of doubles at half a
/// cell, it shortens the unit vector by 5e-11.
const SAME_PLACE: f64 = 1e-36;

/// Number of sources per tile. The lanes that accumulate the opposite vectors of the sources, 128 B
/// per source, then stay in the L1 cache.
const TILE: usize = 256;

/// Number of groups of lanes that hold a tile.
const GROUPS: usize = TILE / WIDTH;

const NOTHING: [Lanes; 2] = [[0.0; WIDTH]; 2];

/// The buffers of a direct sum.
#[derive(Clone, Debug, Default)]
pub(super) struct Direct {
    x: Vec<Lanes>,
    y: Vec<Lanes>,
    sum_x: Vec<Lanes>,
    sum_y: Vec<Lanes>,
    back: Vec<[Lanes; 2]>,
}

impl Direct {
    /// Sums, for every individual, the unit vectors to all others.
    ///
    /// - Shapes: n coordinates each in; the sums of x and of y out, n of each, padded to whole
    ///   lanes.
    pub fn sum(&mut self, level: Level, pool: Option<&Pool>, x: &[f64], y: &[f64]) -> [&[f64]; 2] {
        fill_lanes(&mut self.x, x.iter().copied());
        fill_lanes(&mut self.y, y.iter().copied());
        for sum in [&mut self.sum_x, &mut self.sum_y] {
            sum.clear();
            sum.resize(self.x.len(), [0.0; WIDTH]);
        }
        let pairs = AllPairs {
            level,
            at: [&self.x, &self.y],
            sources: [x, y],
        };
        let sums = [&mut self.sum_x[..], &mut self.sum_y];
        if let Some(pool) = pool {
            pairs.sum_parallel(pool, sums);
        } else {
            pairs.sum_serial(sums, &mut self.back);
        }
        [self.sum_x.as_flattened(), self.sum_y.as_flattened()]
    }
}

/// All individuals, as targets in lanes and as sources.
struct AllPairs<'a> {
    level: Level,
    at: [&'a [Lanes]; 2],
    sources: [&'a [f64]; 2],
}

impl AllPairs<'_> {
    fn n(&self) -> usize {
        self.sources[0].len()
    }

    fn tile(&self, tile: usize) -> Range<usize> {
        tile * TILE..self.n().min((tile + 1) * TILE)
    }

    /// Sums all pairs, one tile of sources after the other.
    fn sum_serial(&self, [sum_x, sum_y]: [&mut [Lanes]; 2], back: &mut Vec<[Lanes; 2]>) {
        back.resize(TILE, NOTHING);
        for tile in (0..self.n().div_ceil(TILE)).map(|tile| self.tile(tile)) {
            back[..tile.len()].fill(NOTHING);
            let groups = 0..tile.end.div_ceil(WIDTH);
            let sums = [&mut sum_x[groups.clone()], &mut sum_y[groups.clone()]];
            each_pair_once(self.level, self.at, self.sources, groups, tile, sums, back);
        }
    }

    /// Sums all pairs. The threads of `pool` share the tiles of sources; each processes the tiles
    /// of targets in order, so every sum has the order of [`Self::sum_serial`].
    fn sum_parallel(&self, pool: &Pool, [sum_x, sum_y]: [&mut [Lanes]; 2]) {
        let targets = sum_x.chunks_mut(GROUPS).zip(sum_y.chunks_mut(GROUPS));
        let nothing = || [NOTHING; TILE];
        pool.rounds(targets, nothing, |back, tile, targets, (sum_x, sum_y)| {
            let start = targets * GROUPS;
            let (groups, tile) = (start..start + sum_x.len(), self.tile(tile));
            let sums = [&mut **sum_x, sum_y];
            each_pair_once(self.level, self.at, self.sources, groups, tile, sums, back);
        });
    }
}

/// Fills lanes with `values`, and the rest of the last ones with padding.
pub(super) fn fill_lanes(lanes: &mut Vec<Lanes>, values: impl ExactSizeIterator<Item = f64>) {
    lanes.clear();
    lanes.resize(values.len().div_ceil(WIDTH), [PADDING; WIDTH]);
    for (place, value) in lanes.as_flattened_mut().iter_mut().zip(values) {
        *place = value;
    }
}

multiversion! {
    /// Adds to `sums` the unit vectors from the targets `at` to each of `sources`, in order.
    ///
    /// - Shapes: targets and sums in lanes; any number of sources; two axes, x and y.
    pub(super) fn pull_from(
        level,
        at: [&[Lanes]; 2],
        sources: [&[f64]; 2],
        sums: [&mut [Lanes]; 2],
    ) {
        let ([at_x, at_y], [sums_x, sums_y]) = (at, sums);
        for (((at_x, at_y), sum_x), sum_y) in at_x.iter().zip(at_y).zip(sums_x).zip(sums_y) {
            let (mut total_x, mut total_y) = (*sum_x, *sum_y);
            for (&x, &y) in sources[0].iter().zip(sources[1]) {
                let [unit_x, unit_y] = unit_vectors(at_x, at_y, x, y);
                add(&mut total_x, &unit_x);
                add(&mut total_y, &unit_y);
            }
            (*sum_x, *sum_y) = (total_x, total_y);
        }
    }
}

multiversion! {
    /// Adds the unit vectors between the targets in `groups` and the sources in one `tile`.
    ///
    /// Pairs within one group of lanes are computed in both directions. A pair in two different
    /// groups is computed once, and the opposite vector is added to the sums of the source. The
    /// opposite vectors accumulate in `back`, one entry per source and one lane per lane of the
    /// targets, and are added to the sums after the last group that holds a part of the tile.
    ///
    /// - Shapes: `at` and `sources` hold all individuals; `sums` only those of `groups`.
    fn each_pair_once(
        level,
        at: [&[Lanes]; 2],
        sources: [&[f64]; 2],
        groups: Range<usize>,
        tile: Range<usize>,
        sums: [&mut [Lanes]; 2],
        back: &mut [[Lanes; 2]],
    ) {
        let (Range { start: tile, end }, first) = (tile, groups.start);
        let [sums_x, sums_y] = sums;
        let at = at[0][groups.clone()].iter().zip(&at[1][groups.clone()]);
        let targets = at.zip(sums_x.iter_mut().zip(sums_y.iter_mut()));
        for (group, ((at_x, at_y), (sum_x, sum_y))) in groups.clone().zip(targets) {
            let (mut total_x, mut total_y) = (*sum_x, *sum_y);
            let later = ((group + 1) * WIDTH).clamp(tile, end);
            let own = (group * WIDTH).clamp(tile, later)..later;
            for (&x, &y) in sources[0][own.clone()].iter().zip(&sources[1][own]) {
                let [unit_x, unit_y] = unit_vectors(at_x, at_y, x, y);
                add(&mut total_x, &unit_x);
                add(&mut total_y, &unit_y);
            }
            let later_sources = sources[0][later..end].iter().zip(&sources[1][later..end]);
            for ((&x, &y), back) in later_sources.zip(&mut back[later - tile..]) {
                let [unit_x, unit_y] = unit_vectors(at_x, at_y, x, y);
                add(&mut total_x, &unit_x);
                add(&mut total_y, &unit_y);
                subtract(&mut back[0], &unit_x);
                subtract(&mut back[1], &unit_y);
            }
            (*sum_x, *sum_y) = (total_x, total_y);
        }
        if groups.end * WIDTH < end {
            return;
        }
        let own = tile - first * WIDTH..end - first * WIDTH;
        let tile_x = &mut sums_x.as_flattened_mut()[own.clone()];
        let tile_y = &mut sums_y.as_flattened_mut()[own];
        for ((x, y), back) in tile_x.iter_mut().zip(tile_y).zip(&*back) {
            *x += sum_of(&back[0]);
            *y += sum_of(&back[1]);
        }
    }
}

/// Returns the sum of all lanes, by halves.
#[inline(always)]
fn sum_of(lanes: &Lanes) -> f64 {
    let [a, b, c, d, e, f, g, h] = *lanes;
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}

#[inline(always)]
fn add(to: &mut Lanes, terms: &Lanes) {
    for lane in 0..WIDTH {
        to[lane] += terms[lane];
    }
}

#[inline(always)]
fn subtract(from: &mut Lanes, terms: &Lanes) {
    for lane in 0..WIDTH {
        from[lane] -= terms[lane];
    }
}

/// Returns the unit vectors from every lane to one point, up to one or two units in the last
/// place.
#[inline(always)]
fn unit_vectors(at_x: &Lanes, at_y: &Lanes, x: f64, y: f64) -> [Lanes; 2] {
    let (mut unit_x, mut unit_y) = ([0.0; WIDTH], [0.0; WIDTH]);
    for lane in 0..WIDTH {
        let (dx, dy) = (x - at_x[lane], y - at_y[lane]);
        let square = dx * dx + (dy * dy + SAME_PLACE);
        // A root in single precision takes a third of the time and gives the same bits on every
        // processor. The correction then removes its error e < 4e-7 up to 5/16 e^3, which is
        // below the last place.
        #[expect(clippy::cast_possible_truncation, reason = "a first guess")]
        let guess = f64::from(1.0 / (square as f32).sqrt());
        let error = 1.0 - square * (guess * guess);
        let inverse = guess + guess * (error * (0.5 + 0.375 * error));
        unit_x[lane] = dx * inverse;
        unit_y[lane] = dy * inverse;
    }
    [unit_x, unit_y]
}
