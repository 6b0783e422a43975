//! The points of two axes nearest to each other's ends, for several pairs at a time, one in each
//! lane.

use crate::model::simd::{self, Lanes, Level, multiversion};

/// Number of pairs that a kernel examines at a time.
pub const LANES: usize = simd::WIDTH;

/// Pairs of axes, one in each lane; the second is stored relative to the first.
#[derive(Default)]
pub struct Pairs {
    /// Largest distance at which an end counts as near the other axis.
    limit: Lanes,
    offset: [Lanes; 2],
    first: [Lanes; 2],
    second: [Lanes; 2],
}

/// Bits that classify the four ends of a pair. End k is 0 and 1 for head and tail of the first
/// axis, 2 and 3 for head and tail of the second; its bits are `AT_HEAD << k`, `AT_TAIL << k` and
/// `NEAR << k`.
pub type Signs = u64;

/// The point of the other axis nearest to the end is that axis's head.
const AT_HEAD: Signs = 1;
/// The point of the other axis nearest to the end is that axis's tail.
const AT_TAIL: Signs = 1 << 4;
/// The end is within the limit of the other axis.
const NEAR: Signs = 1 << 8;
/// The axes cross.
const CROSSED: Signs = 1 << 12;

impl Pairs {
    /// Stores pair (i, j) in a lane.
    #[inline(always)]
    pub fn set(&mut self, lane: usize, axis_i: &Axis, axis_j: &Axis, limit: f64) {
        self.limit[lane] = limit;
        for k in 0..2 {
            self.offset[k][lane] = axis_j.centre[k] - axis_i.centre[k];
            self.first[k][lane] = axis_i.heading[k];
            self.second[k][lane] = axis_j.heading[k];
        }
    }

    /// Returns the offset and both headings of a lane.
    #[inline(always)]
    fn axes(&self, lane: usize) -> [[f64; 2]; 3] {
        let columns = [&self.offset, &self.first, &self.second];
        columns.map(|column| [column[0][lane], column[1][lane]])
    }

    /// Computes the signs of every lane's pair, for axes of half-length `h`.
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
    /// Centre, in body sizes.
    pub centre: [f64; 2],
    /// Unit vector along the axis.
    pub heading: [f64; 2],
}

/// An end of one axis and a point of the other axis: the nearest one, or an end.
pub struct End {
    /// Positions of the two points along the first and the second axis, from the centres.
    pub arms: [f64; 2],
    /// Position of the end's projection along the line of the other axis.
    along: f64,
}

impl End {
    /// Finds the point of the other axis nearest to head or tail of the first or second axis.
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

    /// Pairs an end of the first axis with an end of the second.
    #[inline(always)]
    pub fn both(is_tail: bool, other_is_tail: bool, h: f64) -> Self {
        let arms = [is_tail, other_is_tail].map(|is_tail| if is_tail { -h } else { h });
        Self {
            arms,
            along: arms[1],
        }
    }

    /// Returns the vector from the point on the first axis to the point on the second.
    #[inline(always)]
    pub fn separation(&self, offset: [f64; 2], u: [f64; 2], v: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| offset[axis] + self.arms[1] * v[axis] - self.arms[0] * u[axis])
    }
}

/// Returns whether two axes of half-length `h` meet. The centre of the second is at `offset` from
/// the centre of the first. Discs meet if their centres coincide.
#[inline(always)]
#[must_use]
pub fn axes_cross(h: f64, offset: [f64; 2], heading_i: [f64; 2], heading_j: [f64; 2]) -> bool {
    // Each axis must meet the line of the other: its ends are on opposite sides of that line.
    // Parallel axes on one line meet if their centres are within two half-lengths. The three
    // conditions are combined without branches, which would be mispredicted.
    let spread = h * cross(heading_i, heading_j).abs();
    let apart = (dot(offset, offset) > 4.0 * h * h)
        | (cross(heading_i, offset).abs() > spread)
        | (cross(heading_j, offset).abs() > spread);
    !apart
}

/// Returns whether the axes cross.
#[must_use]
pub fn crossed(signs: Signs) -> bool {
    signs & CROSSED != 0
}

/// Returns whether the axes cross or any end is within the limit.
#[must_use]
pub fn within(signs: Signs) -> bool {
    signs & (CROSSED | (NEAR * 0b1111)) != 0
}

/// Returns the codes of a pair's contacts, one bit each; discs have the one code 0. Two ends are a
/// contact if each is nearest to the other; `with_implied`, if either is nearest to the other.
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
    fn every_level_computes_the_same_signs() {
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
