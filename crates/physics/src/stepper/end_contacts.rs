//! Where the ends of two bodies are nearest to each other's axes, for many pairs side by side.

use crate::model::simd::{self, Lanes, Level, multiversion};

/// How many pairs are looked at side by side.
pub const LANES: usize = simd::WIDTH;

/// Pairs of axes, the second seen from the first.
#[derive(Default)]
pub struct Pairs {
    /// How near an end must be to the other axis.
    limit: Lanes,
    offset: [Lanes; 2],
    first: [Lanes; 2],
    second: [Lanes; 2],
}

/// What holds for the ends of a pair: head and tail of the first, then head and tail of the
/// second. For end k there is a bit at `AT_HEAD << k`, `AT_TAIL << k` and `NEAR << k`.
pub type Signs = u64;

/// The point of the other axis nearest to the end is the other's head.
const AT_HEAD: Signs = 1;
/// It is the other's tail.
const AT_TAIL: Signs = 1 << 4;
/// It is within the limit.
const NEAR: Signs = 1 << 8;
/// The axes cross.
const CROSSED: Signs = 1 << 12;

impl Pairs {
    /// Puts pair (i, j) into a lane.
    #[inline(always)]
    pub fn set(&mut self, lane: usize, axis_i: &Axis, axis_j: &Axis, limit: f64) {
        self.limit[lane] = limit;
        for k in 0..2 {
            self.offset[k][lane] = axis_j.centre[k] - axis_i.centre[k];
            self.first[k][lane] = axis_i.heading[k];
            self.second[k][lane] = axis_j.heading[k];
        }
    }

    /// The offset and both headings of a lane.
    #[inline(always)]
    fn axes(&self, lane: usize) -> [[f64; 2]; 3] {
        let columns = [&self.offset, &self.first, &self.second];
        columns.map(|column| [column[0][lane], column[1][lane]])
    }

    /// Finds what holds for every pair's ends, axes being of half-length `h`.
    pub fn signs(&self, level: Level, h: f64) -> [Signs; LANES] {
        signs(level, h, self)
    }
}

multiversion! {
    fn signs(level, h: f64, pairs: &Pairs) -> [Signs; LANES] {
        let mut signs = [0; LANES];
        for (lane, signs) in signs.iter_mut().enumerate() {
            let [offset, u, v] = pairs.axes(lane);
            let limit = pairs.limit[lane] * pairs.limit[lane];
            *signs = if axes_cross(h, offset, u, v) { CROSSED } else { 0 };
            for k in 0..4 {
                let end = End::new(k & 1 != 0, k & 2 != 0, h, offset, u, v);
                *signs |= if end.along >= h { AT_HEAD << k } else { 0 };
                *signs |= if end.along <= -h { AT_TAIL << k } else { 0 };
                let separation = end.separation(offset, u, v);
                let near = dot(separation, separation) <= limit;
                *signs |= if near { NEAR << k } else { 0 };
            }
        }
        signs
    }
}

/// The axis of one body.
#[derive(Clone, Copy)]
pub struct Axis {
    /// Its centre.
    pub centre: [f64; 2],
    /// A unit vector along it.
    pub heading: [f64; 2],
}

/// One end of a pair with the point nearest to it on the other's axis.
pub struct End {
    /// Where on the first and on the second axis they are.
    pub arms: [f64; 2],
    /// Where the end's projection falls on the other's line.
    along: f64,
}

impl End {
    /// Finds the point nearest to head or tail of the first or of the second axis.
    #[inline(always)]
    pub fn new(
        is_tail: bool,
        of_second: bool,
        h: f64,
        offset: [f64; 2],
        u: [f64; 2],
        v: [f64; 2],
    ) -> Self {
        let end = if is_tail { -h } else { h };
        let (along_u, along_v) = (dot(offset, u), dot(offset, v));
        let beside = if of_second { along_u } else { -along_v };
        let along = end * dot(u, v) + beside;
        let foot = if along >= h { h } else { along };
        let foot = if along <= -h { -h } else { foot };
        let (first, second) = if of_second { (foot, end) } else { (end, foot) };
        let arms = [first, second];
        Self { arms, along }
    }

    /// An end of the first axis with one of the second.
    #[inline(always)]
    pub fn both(is_tail: bool, other_is_tail: bool, h: f64) -> Self {
        let arms = [is_tail, other_is_tail].map(|is_tail| if is_tail { -h } else { h });
        Self {
            arms,
            along: arms[1],
        }
    }

    /// From the place on the first axis to that on the second.
    #[inline(always)]
    pub fn separation(&self, offset: [f64; 2], u: [f64; 2], v: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| offset[axis] + self.arms[1] * v[axis] - self.arms[0] * u[axis])
    }
}

/// Whether two axes of half-length `h` meet, the second's centre at `offset` from the first's.
/// Discs meet when their centres coincide.
#[inline(always)]
#[must_use]
pub fn axes_cross(h: f64, offset: [f64; 2], heading_i: [f64; 2], heading_j: [f64; 2]) -> bool {
    // Each axis must meet the other's line: the ends of one lie on both sides of it. Parallel
    // axes on one line meet where they are nearer than two half-lengths. All is asked at once,
    // as nobody can foretell the answers.
    let spread = h * cross(heading_i, heading_j).abs();
    let apart = (dot(offset, offset) > 4.0 * h * h)
        | (cross(heading_i, offset).abs() > spread)
        | (cross(heading_j, offset).abs() > spread);
    !apart
}

/// Whether the axes cross.
#[must_use]
pub fn crossed(signs: Signs) -> bool {
    signs & CROSSED != 0
}

/// Whether the axes cross or any end is within the limit.
#[must_use]
pub fn within(signs: Signs) -> bool {
    signs & (CROSSED | (NEAR * 0b1111)) != 0
}

/// The codes of the contacts that a pair has, as bits; discs have one, of code 0. Two ends count
/// where each is nearest to the other, or, with the implied ones, where either is.
#[must_use]
pub fn codes(h: f64, signs: Signs, with_implied: bool) -> u64 {
    let near = signs >> 8;
    if h == 0.0 {
        return near & 1;
    }
    let (head, tail) = (near & signs, near & signs >> 4);
    let sides = near & !(head | tail) & 0b1111;
    // Ends of the first (bits 0, 1) with ends of the second (bits 2, 3).
    let ends = [
        [head, head >> 2],
        [tail, head >> 3],
        [head >> 1, tail >> 2],
        [tail >> 1, tail >> 3],
    ];
    let [head_head, head_tail, tail_head, tail_tail] = ends.map(|[first, second]| {
        if with_implied {
            (first | second) & 1
        } else {
            first & second & 1
        }
    });
    sides | head_head << 4 | head_tail << 5 | tail_head << 6 | tail_tail << 7
}

#[inline(always)]
pub(super) fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

#[inline(always)]
pub(super) fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::random::{Purpose, Stream};

    #[test]
    fn every_level_sees_the_same() {
        let mut stream = Stream::new(1, 0, 0, Purpose::Start);
        let mut seen = 0;
        for _ in 0..5000 {
            let mut pairs = Pairs::default();
            for lane in 0..LANES {
                let mut axis = || {
                    let (sin, cos) = libm::sincos(7.0 * stream.uniform());
                    Axis {
                        centre: [2.0 * stream.uniform(), 2.0 * stream.uniform()],
                        heading: [cos, sin],
                    }
                };
                pairs.set(lane, &axis(), &axis(), 0.5);
            }
            let signs = pairs.signs(Level::BASELINE, 0.6);
            seen |= signs.into_iter().fold(0, |all, signs| all | signs);
            for level in Level::available() {
                assert_eq!(pairs.signs(level, 0.6), signs, "{level:?}");
            }
        }
        assert_eq!(seen, 0x1FFF, "every sign occurs");
    }
}
