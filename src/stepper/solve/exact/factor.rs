//! The factor of `K = 1 + Σ σ_k b_k b_kᵀ` over the active contacts, in 3×3 blocks.
//!
//! `K` lives on the individuals and is positive definite whatever contacts depend on each other.
//! It is factored as `L D Lᵀ`, column by column, each gathering from the columns to its left.

use super::rows::{Part, Row};
use super::structure::{NONE, Structure};

/// Three columns of three entries; the fourth lane is zero.
type Block = [Part; 3];

const ZERO: Block = [[0.0; 4]; 3];

/// A diagonal block's share of the factor.
#[derive(Clone, Copy, Debug, Default)]
struct Corner {
    /// Entries (1, 0), (2, 0), (2, 1) of `L`.
    lower: [f64; 3],
    /// `D`.
    pivot: Part,
    /// Its inverse.
    inverse: Part,
}

impl Corner {
    #[inline(always)]
    fn forward(&self, part: Part) -> Part {
        let [a, b, c] = self.lower;
        let second = part[1] - a * part[0];
        [part[0], second, part[2] - b * part[0] - c * second, 0.0]
    }

    #[inline(always)]
    fn backward(&self, part: Part) -> Part {
        let [a, b, c] = self.lower;
        let second = part[1] - c * part[2];
        [part[0] - a * second - b * part[2], second, part[2], 0.0]
    }
}

/// The factor's numbers.
#[derive(Clone, Debug, Default)]
pub struct Factor {
    /// Where they are.
    pub structure: Structure,
    below: Vec<Block>,
    diagonal: Vec<Block>,
    corner: Vec<Corner>,
    /// The root of the inverse of `D`; filled by [`Factor::take_roots`].
    root: Vec<Part>,
    slot: Vec<u32>,
    sparse: Vec<Part>,
}

impl Factor {
    /// Factors `K` of the rows that `active` tells.
    pub fn factor(&mut self, rows: &[Row], active: &[bool]) {
        self.assemble(rows, active);
        eliminate(self);
    }

    fn assemble(&mut self, rows: &[Row], active: &[bool]) {
        let Self {
            structure,
            below,
            diagonal,
            ..
        } = self;
        below.clear();
        below.resize(structure.row.len(), ZERO);
        diagonal.clear();
        diagonal.resize(
            structure.columns,
            [
                [1.0, 0.0, 0.0, 0.0],
                [0.0, 1.0, 0.0, 0.0],
                [0.0, 0.0, 1.0, 0.0],
            ],
        );
        for row in rows.iter().zip(active).filter(|(_, active)| **active) {
            let row = row.0;
            let [first, second] = &row.parts;
            let [i, j] = row.place.map(|place| place as usize);
            add_product(&mut diagonal[i], first, first, row.penalty);
            add_product(&mut diagonal[j], second, second, row.penalty);
            let (lower, upper) = if i > j {
                (first, second)
            } else {
                (second, first)
            };
            add_product(&mut below[row.block as usize], lower, upper, row.penalty);
        }
    }

    /// Replaces `vector` by `K⁻¹ vector`.
    pub fn solve(&self, vector: &mut [Part]) {
        let Self {
            structure,
            below,
            corner,
            ..
        } = self;
        for column in 0..structure.columns {
            let part = corner[column].forward(vector[column]);
            let blocks = structure.start[column] as usize..structure.start[column + 1] as usize;
            for (block, &row) in below[blocks.clone()].iter().zip(&structure.row[blocks]) {
                subtract(&mut vector[row as usize], block, &part);
            }
            let inverse = &corner[column].inverse;
            vector[column] = [0, 1, 2, 3].map(|lane| part[lane] * inverse[lane]);
        }
        self.back(vector);
    }

    /// Replaces `vector` by `L⁻ᵀ vector`.
    pub fn back(&self, vector: &mut [Part]) {
        let Self {
            structure,
            below,
            corner,
            ..
        } = self;
        for column in (0..structure.columns).rev() {
            let blocks = structure.start[column] as usize..structure.start[column + 1] as usize;
            let mut sums = ZERO;
            for (block, &row) in below[blocks.clone()].iter().zip(&structure.row[blocks]) {
                let part = &vector[row as usize];
                for (sum, entries) in sums.iter_mut().zip(block) {
                    for lane in 0..4 {
                        sum[lane] += entries[lane] * part[lane];
                    }
                }
            }
            let left = |axis: usize| {
                vector[column][axis] - ((sums[axis][0] + sums[axis][1]) + sums[axis][2])
            };
            vector[column] = corner[column].backward([left(0), left(1), left(2), 0.0]);
        }
    }

    /// Prepares [`Factor::climb`].
    pub fn take_roots(&mut self) {
        self.root.clear();
        self.root
            .extend(self.corner.iter().map(|corner| corner.inverse.map(f64::sqrt)));
        self.sparse.clear();
        self.sparse.resize(self.structure.columns, [0.0; 4]);
    }

    /// Appends `√D⁻¹ L⁻¹ b_k` where it is not zero, with the places: a path in the elimination
    /// tree, from the earlier of the two individuals to a root.
    pub fn climb(&mut self, row: &Row, nodes: &mut Vec<u32>, parts: &mut Vec<Part>) {
        let Self {
            structure,
            below,
            corner,
            root,
            sparse,
            ..
        } = self;
        for (place, part) in row.place.iter().zip(row.parts) {
            sparse[*place as usize] = part;
        }
        let mut node = row.place[0].min(row.place[1]);
        while node != NONE {
            let column = node as usize;
            let part = corner[column].forward(std::mem::take(&mut sparse[column]));
            let blocks = structure.start[column] as usize..structure.start[column + 1] as usize;
            for (block, &row) in below[blocks.clone()].iter().zip(&structure.row[blocks]) {
                subtract(&mut sparse[row as usize], block, &part);
            }
            nodes.push(node);
            parts.push([0, 1, 2, 3].map(|lane| part[lane] * root[column][lane]));
            node = structure.parent[column];
        }
    }

    /// Adds `factor D⁻¹ L⁻¹ b_k` from a climbed path to a vector for [`Factor::back`].
    pub fn descend(&self, nodes: &[u32], parts: &[Part], factor: f64, vector: &mut [Part]) {
        for (&node, part) in nodes.iter().zip(parts) {
            let (entry, root) = (&mut vector[node as usize], &self.root[node as usize]);
            for lane in 0..4 {
                entry[lane] += factor * part[lane] * root[lane];
            }
        }
    }
}

/// Replaces the matrix by its factor.
fn eliminate(factor: &mut Factor) {
    let Factor {
        structure,
        below,
        diagonal,
        corner,
        slot,
        ..
    } = factor;
    corner.clear();
    slot.resize(structure.columns, 0);
    for column in 0..structure.columns {
        let begin = structure.start[column] as usize;
        let end = structure.start[column + 1] as usize;
        for (block, &row) in (begin..end).zip(&structure.row[begin..end]) {
            #[expect(clippy::cast_possible_truncation, reason = "blocks are named by 32 bits")]
            let block = (block - begin) as u32;
            slot[row as usize] = block;
        }
        let (done, rest) = below.split_at_mut(begin);
        let own = &mut rest[..end - begin];
        let target = &mut diagonal[column];
        let lefts = structure.left_start[column] as usize..structure.left_start[column + 1] as usize;
        for &[other, at] in &structure.left[lefts] {
            let at = at as usize;
            let joint = &done[at];
            // A pair that is listed but not active joins nothing.
            if joint.iter().flatten().all(|&entry| entry == 0.0) {
                continue;
            }
            let pivot = &corner[other as usize].pivot;
            let mut scaled = ZERO;
            for axis in 0..3 {
                for lane in 0..3 {
                    scaled[lane][axis] = joint[axis][lane] * pivot[axis];
                }
            }
            multiply_subtract(target, joint, &scaled);
            let last = structure.start[other as usize + 1] as usize;
            for (block, &row) in done[at + 1..last].iter().zip(&structure.row[at + 1..last]) {
                multiply_subtract(&mut own[slot[row as usize] as usize], block, &scaled);
            }
        }
        let finished = pivot(target);
        for block in own {
            let [a, b, c] = finished.lower;
            let mut columns = *block;
            for lane in 0..4 {
                columns[1][lane] -= a * columns[0][lane];
                columns[2][lane] -= b * columns[0][lane] + c * columns[1][lane];
            }
            for (axis, entries) in columns.iter().enumerate() {
                for lane in 0..4 {
                    block[axis][lane] = entries[lane] * finished.inverse[axis];
                }
            }
        }
        corner.push(finished);
    }
}

/// Factors a diagonal block.
#[inline(always)]
fn pivot(block: &Block) -> Corner {
    // Never below the unit matrix it began as, but for rounding.
    let first = block[0][0].max(1.0);
    let i = 1.0 / first;
    let (a, b) = (block[0][1] * i, block[0][2] * i);
    let second = (block[1][1] - a * block[0][1]).max(1.0);
    let j = 1.0 / second;
    let cross = block[1][2] - a * block[0][2];
    let c = cross * j;
    let third = (block[2][2] - b * block[0][2] - c * cross).max(1.0);
    Corner {
        lower: [a, b, c],
        pivot: [first, second, third, 0.0],
        inverse: [i, j, 1.0 / third, 0.0],
    }
}

/// `target += factor · one otherᵀ`, `one` along the lanes.
#[inline(always)]
fn add_product(target: &mut Block, one: &Part, other: &Part, factor: f64) {
    for (axis, entries) in target.iter_mut().enumerate() {
        let scale = factor * other[axis];
        for lane in 0..4 {
            entries[lane] += scale * one[lane];
        }
    }
}

/// `target -= block · scaledᵀ`.
#[inline(always)]
fn multiply_subtract(target: &mut Block, block: &Block, scaled: &Block) {
    for (axis, entries) in target.iter_mut().enumerate() {
        let [x, y, z, _] = scaled[axis];
        for lane in 0..4 {
            entries[lane] -=
                block[0][lane] * x + block[1][lane] * y + block[2][lane] * z;
        }
    }
}

/// `target -= block · part`.
#[inline(always)]
fn subtract(target: &mut Part, block: &Block, part: &Part) {
    for lane in 0..4 {
        target[lane] -=
            block[0][lane] * part[0] + block[1][lane] * part[1] + block[2][lane] * part[2];
    }
}
