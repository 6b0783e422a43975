//! The sum over all the others, term by term.

use crate::model::lanes::{Lanes, Level, WIDTH, multiversion};

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
    pub fn sum(&mut self, level: Level, x: &[f64], y: &[f64]) -> [&[f64]; 2] {
        fill_lanes(&mut self.x, x.iter().copied());
        fill_lanes(&mut self.y, y.iter().copied());
        for sum in [&mut self.sum_x, &mut self.sum_y] {
            sum.clear();
            sum.resize(self.x.len(), [0.0; WIDTH]);
        }
        let (at, sums) = (
            [&self.x[..], &self.y],
            [&mut self.sum_x[..], &mut self.sum_y],
        );
        self.back.resize(TILE, NOTHING);
        each_pair_once(level, at, [x, y], sums, &mut self.back);
        [self.sum_x.as_flattened(), self.sum_y.as_flattened()]
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
    /// As [`pull_from`] with the targets as sources, but each pair of different lanes' groups
    /// is taken once: what pulls the one forth pulls the other back. A tile of sources gathers
    /// in `back`, by the lane of the target, and is folded into the sums before the next.
    fn each_pair_once(
        level,
        at: [&[Lanes]; 2],
        sources: [&[f64]; 2],
        sums: [&mut [Lanes]; 2],
        back: &mut [[Lanes; 2]],
    ) {
        let ([at_x, at_y], [sums_x, sums_y]) = (at, sums);
        let n = sources[0].len();
        for tile in (0..n).step_by(TILE) {
            let end = n.min(tile + TILE);
            back[..end - tile].fill(NOTHING);
            for group in 0..end.div_ceil(WIDTH) {
                let (at_x, at_y) = (at_x[group], at_y[group]);
                let (mut total_x, mut total_y) = (sums_x[group], sums_y[group]);
                let later = ((group + 1) * WIDTH).clamp(tile, end);
                let own = (group * WIDTH).clamp(tile, later)..later;
                for (&x, &y) in sources[0][own.clone()].iter().zip(&sources[1][own]) {
                    let [unit_x, unit_y] = unit_vectors(&at_x, &at_y, x, y);
                    add(&mut total_x, &unit_x);
                    add(&mut total_y, &unit_y);
                }
                let later_sources = sources[0][later..end].iter().zip(&sources[1][later..end]);
                for ((&x, &y), back) in later_sources.zip(&mut back[later - tile..]) {
                    let [unit_x, unit_y] = unit_vectors(&at_x, &at_y, x, y);
                    add(&mut total_x, &unit_x);
                    add(&mut total_y, &unit_y);
                    subtract(&mut back[0], &unit_x);
                    subtract(&mut back[1], &unit_y);
                }
                (sums_x[group], sums_y[group]) = (total_x, total_y);
            }
            let (tile_x, tile_y) = (sums_x.as_flattened_mut(), sums_y.as_flattened_mut());
            for (k, back) in (tile..end).zip(&*back) {
                tile_x[k] += folded(&back[0]);
                tile_y[k] += folded(&back[1]);
            }
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
