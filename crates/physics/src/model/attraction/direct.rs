//! The sum over all the others, term by term.

use std::ops::Range;

use crate::model::simd::{Lanes, Level, WIDTH, multiversion};
use crate::model::threads::Pool;

/// What a lane without an individual holds. The square of its distance to anybody rounds to an
/// infinite `f32`, so it pulls with exactly 0.
const NOWHERE: f64 = 1e30;

/// Added to the square of a distance: an individual itself, and any at the same place, is then
/// at exactly zero without a branch. Beside the square of any distance that doubles resolve
/// within a cell it vanishes; its inverse root is a normal `f32`.
const SAME_PLACE: f64 = 1e-36;

/// How many sources are pushed back at a time: what they gather, 128 B each, then stays in the
/// processor's nearest cache.
const TILE: usize = 256;

/// The groups of lanes that hold a tile.
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
    /// Sums the unit vectors from everyone to everyone else.
    ///
    /// - Shapes: n coordinates each in; the sums of x and of y, n of each and some more, out.
    pub fn sum(&mut self, level: Level, pool: Option<&Pool>, x: &[f64], y: &[f64]) -> [&[f64]; 2] {
        fill_lanes(&mut self.x, x.iter().copied());
        fill_lanes(&mut self.y, y.iter().copied());
        for sum in [&mut self.sum_x, &mut self.sum_y] {
            sum.clear();
            sum.resize(self.x.len(), [0.0; WIDTH]);
        }
        let everybody = Everybody {
            level,
            at: [&self.x, &self.y],
            sources: [x, y],
        };
        let sums = [&mut self.sum_x[..], &mut self.sum_y];
        if let Some(pool) = pool {
            everybody.meet_at_once(pool, sums);
        } else {
            everybody.meet_in_turn(sums, &mut self.back);
        }
        [self.sum_x.as_flattened(), self.sum_y.as_flattened()]
    }
}

/// Everybody as targets, in lanes, and as sources.
struct Everybody<'a> {
    level: Level,
    at: [&'a [Lanes]; 2],
    sources: [&'a [f64]; 2],
}

impl Everybody<'_> {
    fn n(&self) -> usize {
        self.sources[0].len()
    }

    fn tile(&self, tile: usize) -> Range<usize> {
        tile * TILE..self.n().min((tile + 1) * TILE)
    }

    /// All pairs, tile by tile of the sources.
    fn meet_in_turn(&self, [sum_x, sum_y]: [&mut [Lanes]; 2], back: &mut Vec<[Lanes; 2]>) {
        back.resize(TILE, NOTHING);
        for tile in (0..self.n().div_ceil(TILE)).map(|tile| self.tile(tile)) {
            back[..tile.len()].fill(NOTHING);
            let groups = 0..tile.end.div_ceil(WIDTH);
            let sums = [&mut sum_x[groups.clone()], &mut sum_y[groups.clone()]];
            each_pair_once(self.level, self.at, self.sources, groups, tile, sums, back);
        }
    }

    /// All pairs, the tiles of sources being taken by the threads of `pool` and those of targets
    /// in their order: every sum is added up as in [`Self::meet_in_turn`], whoever adds.
    fn meet_at_once(&self, pool: &Pool, [sum_x, sum_y]: [&mut [Lanes]; 2]) {
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

/// Fills whole lanes with `values`, and the rest of the last ones with nobody.
pub(super) fn fill_lanes(lanes: &mut Vec<Lanes>, values: impl ExactSizeIterator<Item = f64>) {
    lanes.clear();
    lanes.resize(values.len().div_ceil(WIDTH), [NOWHERE; WIDTH]);
    for (place, value) in lanes.as_flattened_mut().iter_mut().zip(values) {
        *place = value;
    }
}

multiversion! {
    /// Adds to `sums` the unit vectors from the targets `at` to every one of `sources`, in
    /// their order.
    ///
    /// - Shapes: targets and sums in lanes; any number of sources; axes x and y.
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
    /// As [`pull_from`] with targets as sources, those of `groups` and those of one `tile`, but
    /// each pair of different lanes' groups is taken once: what pulls the one forth pulls the
    /// other back. That gathers in `back`, by the lane of the target, and is folded into the
    /// sums with the tile's last group.
    ///
    /// - Shapes: all the targets, all the sources; the sums of `groups` alone.
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
            *x += folded(&back[0]);
            *y += folded(&back[1]);
        }
    }
}

/// The sum of all lanes, by halves.
#[inline(always)]
fn folded(lanes: &Lanes) -> f64 {
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

/// The unit vectors from every lane to one place, to the last digit or two.
#[inline(always)]
fn unit_vectors(at_x: &Lanes, at_y: &Lanes, x: f64, y: f64) -> [Lanes; 2] {
    let (mut unit_x, mut unit_y) = ([0.0; WIDTH], [0.0; WIDTH]);
    for lane in 0..WIDTH {
        let (dx, dy) = (x - at_x[lane], y - at_y[lane]);
        let square = dx * dx + (dy * dy + SAME_PLACE);
        // A root in single precision takes a third of the time and is as exact everywhere. Its
        // error e < 4e-7 is then taken out up to 5/16 e^3, which is below the last place.
        #[expect(clippy::cast_possible_truncation, reason = "a first guess")]
        let guess = f64::from(1.0 / (square as f32).sqrt());
        let error = 1.0 - square * (guess * guess);
        let inverse = guess + guess * (error * (0.5 + 0.375 * error));
        unit_x[lane] = dx * inverse;
        unit_y[lane] = dy * inverse;
    }
    [unit_x, unit_y]
}
