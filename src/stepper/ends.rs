//! Where the ends of two bodies are nearest to each other's axes, for many pairs side by side.

use super::contact::{cross, dot};

/// How many pairs are looked at side by side. The lanes are explicit so that the compiler may
/// use vector registers, and every lane counts for itself alone.
pub const LANES: usize = 8;

/// Pairs of axes, the second seen from the first.
#[derive(Default)]
pub struct Pairs {
    /// How near an end must be to the other axis.
    limit: [f64; LANES],
    offset: [[f64; LANES]; 2],
    first: [[f64; LANES]; 2],
    second: [[f64; LANES]; 2],
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

    /// Finds what holds for every pair's ends, axes being of half-length `h`.
    #[inline(always)]
    pub fn signs(&self, h: f64) -> [Signs; LANES] {
        let mut signs = [0; LANES];
        for (lane, signs) in signs.iter_mut().enumerate() {
            let [offset, u, v] = [&self.offset, &self.first, &self.second]
                .map(|column| [column[0][lane], column[1][lane]]);
            let limit = self.limit[lane] * self.limit[lane];
            *signs = if axes_cross(h, offset, u, v) {
                CROSSED
            } else {
                0
            };
            for k in 0..4 {
                let end = End::new(k, h, offset, u, v);
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
    /// Finds the point nearest to end `k` of a pair: head and tail of the first axis, then head
    /// and tail of the second.
    #[inline(always)]
    pub fn new(k: usize, h: f64, offset: [f64; 2], u: [f64; 2], v: [f64; 2]) -> Self {
        let end = if k % 2 == 0 { h } else { -h };
        let beside = if k < 2 {
            -dot(offset, v)
        } else {
            dot(offset, u)
        };
        let along = end * dot(u, v) + beside;
        let foot = if along >= h { h } else { along };
        let foot = if along <= -h { -h } else { foot };
        let arms = if k < 2 { [end, foot] } else { [foot, end] };
        Self { arms, along }
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
    signs & (CROSSED | NEAR * 0b1111) != 0
}

/// The codes of the contacts that a pair has, as bits; discs have one, of code 0.
#[must_use]
pub fn codes(h: f64, signs: Signs) -> u64 {
    let (head, tail, near) = (signs, signs >> 4, signs >> 8);
    if h == 0.0 {
        return near & 1;
    }
    let sides = near & !(head | tail) & 0b1111;
    // Ends of the first (bits 0, 1) with ends of the second (bits 2, 3), each nearest to the
    // other.
    let head_head = near & head & (head >> 2) & 1;
    let head_tail = near & tail & (head >> 3) & 1;
    let tail_head = (near & head) >> 1 & (tail >> 2) & 1;
    let tail_tail = (near & tail & (tail >> 2)) >> 1 & 1;
    sides | head_head << 4 | head_tail << 5 | tail_head << 6 | tail_tail << 7
}
