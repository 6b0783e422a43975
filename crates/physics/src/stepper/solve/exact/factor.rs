//! The factor of `K = 1 + Σ σ_k b_k b_kᵀ` over the active contacts, in 3×3 blocks.
//!
//! `K` has a row of blocks for each individual and is positive definite even if contacts depend on
//! each other. It is factored as `L D Lᵀ` by columns; each column subtracts the products of the
//! columns to its left.

use std::hint::black_box;
use std::ops::Range;

use super::rows::{Part, Row};
use super::structure::{NONE, Structure};

/// Three columns of three entries; the fourth lane is zero.
type Square = [Part; 3];

const ZERO: Square = [[0.0; 4]; 3];

const UNIT: Square = [
    [1.0, 0.0, 0.0, 0.0],
    [0.0, 1.0, 0.0, 0.0],
    [0.0, 0.0, 1.0, 0.0],
];

/// A block below the diagonal.
#[derive(Clone, Copy, Debug)]
struct Block {
    entries: Square,
    /// Row, as a place.
    row: u32,
}

/// A diagonal block. After the factorisation `entries` has three rows: the entries (1, 0), (2, 0)
/// and (2, 1) of `L`; `D`; `D⁻¹`.
#[derive(Clone, Copy, Debug)]
struct Corner {
    /// Range of the blocks below the diagonal in this column.
    begin: u32,
    end: u32,
    entries: Square,
}

impl Corner {
    /// A diagonal block of the unit matrix.
    const UNIT: Self = Self {
        begin: 0,
        end: 0,
        entries: UNIT,
    };

    /// The factor of the block of an individual without active contacts.
    const ALONE: Self = Self {
        begin: 0,
        end: 0,
        entries: [[0.0; 4], [1.0, 1.0, 1.0, 0.0], [1.0, 1.0, 1.0, 0.0]],
    };

    #[inline(always)]
    fn pivot(&self) -> &Part {
        &self.entries[1]
    }

    #[inline(always)]
    fn inverse(&self) -> &Part {
        &self.entries[2]
    }

    /// Returns the blocks below the diagonal in this column.
    #[inline(always)]
    fn of<'a>(&self, below: &'a [Block]) -> &'a [Block] {
        &below[self.begin as usize..self.end as usize]
    }

    #[inline(always)]
    fn forward(&self, part: Part) -> Part {
        let [a, b, c, _] = self.entries[0];
        let second = part[1] - a * part[0];
        [part[0], second, part[2] - b * part[0] - c * second, 0.0]
    }

    #[inline(always)]
    fn backward(&self, part: Part) -> Part {
        let [a, b, c, _] = self.entries[0];
        // As operations on all lanes, so that one store writes the result: the next column waits
        // for it.
        let part = less(part, [b, c, 0.0, 0.0], part[2]);
        less(part, [a, 0.0, 0.0, 0.0], part[1])
    }
}

/// The non-zero parts of vectors `L⁻¹ b_k`, one vector after the other.
#[derive(Clone, Debug, Default)]
pub struct Path {
    /// Places of the parts.
    pub nodes: Vec<u32>,
    /// `L⁻¹ b_k`.
    pub parts: Vec<Part>,
    /// `D⁻¹ L⁻¹ b_k`.
    pub scaled: Vec<Part>,
}

impl Path {
    /// Removes all vectors.
    pub fn clear(&mut self) {
        self.nodes.clear();
        self.parts.clear();
        self.scaled.clear();
    }

    /// Adds `factor D⁻¹ L⁻¹ b_k` of the vector at `range` to `vector`, the input of
    /// [`Factor::back`].
    #[inline(always)]
    pub fn descend(&self, range: Range<usize>, factor: f64, vector: &mut [Part]) {
        for (&node, part) in self.nodes[range.clone()].iter().zip(&self.scaled[range]) {
            let entry = &mut vector[node as usize];
            for lane in 0..4 {
                entry[lane] += factor * part[lane];
            }
        }
    }
}

/// The numeric factor.
#[derive(Clone, Debug, Default)]
pub struct Factor {
    /// The positions of the blocks.
    pub structure: Structure,
    below: Vec<Block>,
    corner: Vec<Corner>,
    slot: Vec<u32>,
}

impl Factor {
    /// Assembles and factors `K` of the active rows.
    #[inline(always)]
    pub fn factor(&mut self, rows: &[Row]) {
        self.assemble(rows);
        eliminate(self);
    }

    #[inline(always)]
    fn assemble(&mut self, rows: &[Row]) {
        let Self {
            structure,
            below,
            corner,
            ..
        } = self;
        below.clear();
        below.extend(
            structure
                .row
                .iter()
                .map(|&row| Block { entries: ZERO, row }),
        );
        corner.clear();
        corner.resize(structure.columns, Corner::UNIT);
        for row in rows.iter().filter(|row| row.active) {
            let [first, second] = &row.parts;
            let [i, j] = row.place.map(|place| place as usize);
            add_product(&mut corner[i].entries, first, first, row.penalty);
            add_product(&mut corner[j].entries, second, second, row.penalty);
            let (lower, upper) = if i > j {
                (first, second)
            } else {
                (second, first)
            };
            let block = &mut below[row.block as usize].entries;
            add_product(block, lower, upper, row.penalty);
        }
    }

    /// Replaces `vector` by `K⁻¹ vector`.
    #[inline(always)]
    pub fn solve(&self, vector: &mut [Part]) {
        let Self {
            structure,
            below,
            corner,
            ..
        } = self;
        for (column, corner) in corner[..structure.columns].iter().enumerate() {
            let part = corner.forward(vector[column]);
            for block in corner.of(below) {
                subtract(&mut vector[block.row as usize], &block.entries, &part);
            }
            vector[column] = [0, 1, 2, 3].map(|lane| part[lane] * corner.inverse()[lane]);
        }
        self.back(vector);
    }

    /// Replaces `vector` by `L⁻ᵀ vector`.
    #[inline(always)]
    pub fn back(&self, vector: &mut [Part]) {
        let Self {
            structure,
            below,
            corner,
            ..
        } = self;
        for (column, corner) in corner[..structure.columns].iter().enumerate().rev() {
            let mut sums = ZERO;
            for block in corner.of(below) {
                let part = &vector[block.row as usize];
                for (sum, entries) in sums.iter_mut().zip(&block.entries) {
                    for lane in 0..4 {
                        sum[lane] += entries[lane] * part[lane];
                    }
                }
            }
            // For speed: the compiler would otherwise sum in pairs of axes, not in lanes.
            let sums = black_box(sums);
            let [x, y, z] =
                [0, 1, 2].map(|lane| [sums[0][lane], sums[1][lane], sums[2][lane], 0.0]);
            let mut left = vector[column];
            for lane in 0..4 {
                left[lane] -= (x[lane] + y[lane]) + z[lane];
            }
            vector[column] = corner.backward(left);
        }
    }

    /// Appends the non-zero parts of `L⁻¹ b_k` to `path`: those on the paths from both individuals
    /// to the root of the elimination tree, in the order of places. Returns the index in `path`
    /// from which on each node is the parent of the last. `sparse` is zero before and after.
    #[inline(always)]
    pub fn climb(&self, row: &Row, path: &mut Path, sparse: &mut [Part]) -> usize {
        let Self {
            structure,
            below,
            corner,
            ..
        } = self;
        for (place, part) in row.place.iter().zip(row.parts) {
            sparse[*place as usize] = part;
        }
        // The paths from both individuals, which may meet.
        let [mut one, mut other] = row.place;
        let mut expected = one.min(other);
        let mut joined = path.nodes.len();
        while one != NONE || other != NONE {
            let node = one.min(other);
            if node != expected {
                joined = path.nodes.len();
            }
            let column = node as usize;
            expected = structure.parent[column];
            one = if one == node { expected } else { one };
            other = if other == node { expected } else { other };
            let corner = &corner[column];
            let part = corner.forward(std::mem::take(&mut sparse[column]));
            for block in corner.of(below) {
                subtract(&mut sparse[block.row as usize], &block.entries, &part);
            }
            path.nodes.push(node);
            path.parts.push(part);
            path.scaled
                .push([0, 1, 2, 3].map(|lane| part[lane] * corner.inverse()[lane]));
        }
        joined
    }
}

/// Replaces the matrix by its factor.
#[expect(
    clippy::needless_range_loop,
    reason = "lanes of several arrays side by side"
)]
#[inline(always)]
fn eliminate(factor: &mut Factor) {
    let Factor {
        structure,
        below,
        corner,
        slot,
        ..
    } = factor;
    slot.resize(structure.columns, 0);
    let bounds = structure.start.iter().zip(&structure.start[1..]);
    let lefts = structure.left_start.windows(2);
    for (column, ((&begin, &end), lefts)) in bounds.zip(lefts).enumerate() {
        let (corners, rest) = corner.split_at_mut(column);
        let target = &mut rest[0];
        let (done, own) = below.split_at_mut(begin as usize);
        let own = &mut own[..(end - begin) as usize];
        for (at, block) in (0..).zip(own.iter()) {
            slot[block.row as usize] = at;
        }
        for &[other, at] in &structure.left[lefts[0] as usize..lefts[1] as usize] {
            let left = &corners[other as usize];
            let [joint, later @ ..] = &done[at as usize..left.end as usize] else {
                unreachable!("an entry of a row is a block of its column");
            };
            let mut scaled = ZERO;
            for axis in 0..3 {
                for lane in 0..3 {
                    scaled[lane][axis] = joint.entries[axis][lane] * left.pivot()[axis];
                }
            }
            multiply_subtract(&mut target.entries, &joint.entries, &scaled);
            for block in later {
                let own = &mut own[slot[block.row as usize] as usize];
                multiply_subtract(&mut own.entries, &block.entries, &scaled);
            }
        }
        let finished = pivot(&target.entries);
        for block in own {
            let [[a, b, c, _], _, inverse] = finished;
            let mut columns = block.entries;
            for lane in 0..4 {
                columns[1][lane] -= a * columns[0][lane];
                columns[2][lane] -= b * columns[0][lane] + c * columns[1][lane];
            }
            for (axis, entries) in columns.iter().enumerate() {
                for lane in 0..4 {
                    block.entries[axis][lane] = entries[lane] * inverse[axis];
                }
            }
        }
        *target = Corner {
            begin,
            end,
            entries: finished,
        };
    }
    corner.resize(structure.place.len(), Corner::ALONE);
}

/// `part - factor · column`.
#[inline(always)]
fn less(mut part: Part, column: Part, factor: f64) -> Part {
    for lane in 0..4 {
        part[lane] -= column[lane] * factor;
    }
    part
}

/// Raises a pivot to at least 1: `K` is at least the unit matrix, so a smaller one is a rounding
/// error.
#[inline(always)]
fn at_least_one(pivot: f64) -> f64 {
    if pivot > 1.0 { pivot } else { 1.0 }
}

/// Factors a diagonal block; returns the entries of a factored [`Corner`].
#[inline(always)]
fn pivot(block: &Square) -> Square {
    let first = at_least_one(block[0][0]);
    let i = 1.0 / first;
    let (a, b) = (block[0][1] * i, block[0][2] * i);
    let second = at_least_one(block[1][1] - a * block[0][1]);
    let j = 1.0 / second;
    let cross = block[1][2] - a * block[0][2];
    let c = cross * j;
    let third = at_least_one(block[2][2] - b * block[0][2] - c * cross);
    [
        [a, b, c, 0.0],
        [first, second, third, 0.0],
        [i, j, 1.0 / third, 0.0],
    ]
}

/// `target += factor · one otherᵀ`, `one` along the lanes.
#[inline(always)]
fn add_product(target: &mut Square, one: &Part, other: &Part, factor: f64) {
    for (axis, entries) in target.iter_mut().enumerate() {
        let scale = factor * other[axis];
        for lane in 0..4 {
            entries[lane] += scale * one[lane];
        }
    }
}

/// `target -= block · scaledᵀ`.
#[inline(always)]
fn multiply_subtract(target: &mut Square, block: &Square, scaled: &Square) {
    for (axis, entries) in target.iter_mut().enumerate() {
        let [x, y, z, _] = scaled[axis];
        for lane in 0..4 {
            entries[lane] -= block[0][lane] * x + block[1][lane] * y + block[2][lane] * z;
        }
    }
}

/// `target -= block · part`.
#[inline(always)]
fn subtract(target: &mut Part, block: &Square, part: &Part) {
    for lane in 0..4 {
        target[lane] -=
            block[0][lane] * part[0] + block[1][lane] * part[1] + block[2][lane] * part[2];
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::super::rows::{self, NONE};
    use super::*;
    use crate::model::random::{Purpose, Stream};
    use crate::stepper::contact::Contact;
    use crate::stepper::qp::Qp;

    /// Two rings that share an individual, a separate pair, and a contact that is not active.
    fn rows(factor: &mut Factor) -> Vec<Row> {
        let mut stream = Stream::new(5, 0, 0, Purpose::Start);
        let mut pairs = [
            (0, 3),
            (3, 7),
            (5, 7),
            (0, 5),
            (1, 7),
            (1, 2),
            (2, 7),
            (2, 7),
            (4, 6),
            (4, 7),
        ];
        pairs.sort_unstable();
        let contact = |(i, j): (u32, u32)| {
            let angle = 7.0 * stream.uniform();
            Contact {
                i,
                j,
                code: 0,
                gap: 0.0,
                normal: [libm::cos(angle), libm::sin(angle)],
                lever: [stream.uniform() - 0.5, stream.uniform() - 0.5],
            }
        };
        let qp = Qp {
            weights: [1.0, 1.0, 0.1],
            free: vec![[0.0; 3]; 9],
            contacts: pairs.into_iter().map(contact).collect(),
        };
        let mut rows = Vec::new();
        rows::fill(&qp, &mut rows);
        for (row, pair) in rows.iter_mut().zip(pairs) {
            row.active = pair != (4, 7);
            row.penalty = 50.0;
        }
        let order = [8, 0, 3, 5, 7, 6, 1, 2, 4];
        factor.structure.update(&order, &qp.contacts, &rows);
        let structure = &factor.structure;
        for ((row, contact), &block) in rows.iter_mut().zip(&qp.contacts).zip(&structure.block) {
            row.place = [contact.i, contact.j].map(|k| structure.place[k as usize]);
            row.block = block;
        }
        factor.factor(&rows);
        rows
    }

    fn dense(row: &Row) -> DVector<f64> {
        let mut vector = DVector::zeros(27);
        for (place, part) in row.place.iter().zip(row.parts) {
            for axis in 0..3 {
                vector[3 * *place as usize + axis] += part[axis];
            }
        }
        vector
    }

    #[test]
    fn the_factor_solves_like_a_dense_factor() {
        let mut factor = Factor::default();
        let rows = rows(&mut factor);
        assert_eq!(factor.structure.columns, 8, "one individual has no contact");
        let mut matrix = DMatrix::<f64>::identity(27, 27);
        for row in rows.iter().filter(|row| row.active) {
            matrix += row.penalty * dense(row) * dense(row).transpose();
        }
        let inverse = matrix.clone().cholesky().unwrap().inverse();
        let right: Vec<f64> = (0..27).map(|k| libm::sin(f64::from(k))).collect();
        let expected = &inverse * DVector::from_vec(right.clone());
        let mut vector: Vec<Part> = right
            .chunks(3)
            .map(|part| [part[0], part[1], part[2], 0.0])
            .collect();
        factor.solve(&mut vector);
        for (k, expected) in expected.iter().enumerate() {
            assert!((vector[k / 3][k % 3] - expected).abs() < 1e-12, "{k}");
        }
        // The paths give the same products as the dense matrix, also for the inactive contact,
        // which connects two trees.
        let mut forked = 0;
        for one in &rows {
            for other in &rows {
                let (mut up, mut down) = (Path::default(), vec![[0.0; 4]; 9]);
                forked += usize::from(factor.climb(other, &mut up, &mut down) > 0);
                assert_eq!(down, vec![[0.0; 4]; 9]);
                up.descend(0..up.nodes.len(), 1.0, &mut down);
                factor.back(&mut down);
                let expected = (dense(one).transpose() * &inverse * dense(other))[0];
                assert!((one.along(&down) - expected).abs() < 1e-12);
            }
        }
        assert!(forked > 0, "no path has two branches");
        assert_eq!(rows.iter().filter(|row| row.block == NONE).count(), 1);
    }
}
