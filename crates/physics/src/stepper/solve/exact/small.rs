//! The solver for few pushing contacts: a small dense factor.
//!
//! For a fixed active set with gradients `A`, the multipliers that close its gaps solve a linear
//! system with the dual matrix `A W⁻¹ Aᵀ`, its diagonal slightly enlarged. It has one unknown for
//! each active contact, whereas the sparse factor has three for each individual. All contacts on
//! the wrong side are exchanged, until there are none. This may cycle; the sparse factor is then
//! used.

use super::rows::{Part, Row};
use super::{DONE, WRONG};
use crate::stepper::qp::Qp;
use crate::stepper::solve::Solution;

/// Largest active set that this solver takes: three blocks of lanes.
pub const MAX_ACTIVE: usize = 3 * LANES;

/// Rounds at most: each factors once, then exchanges the contacts on the wrong side. One is usual.
const MAX_ROUNDS: usize = 5;

/// Passes with one factor. If contacts depend on each other, the first is not exact.
const MAX_PASSES: usize = 2;

/// Share of the diagonal that is added to it, so that the matrix has a factor even if contacts
/// depend on each other.
const SHIFT: f64 = 1e-10;

/// Lanes of a block of a column.
const LANES: usize = 8;

/// The end of a list of contacts.
const NONE: u32 = u32::MAX;

type Lanes = [f64; LANES];

/// Buffers of one solution.
#[derive(Clone, Debug, Default)]
pub struct Small {
    /// The active set: row indices, ascending.
    members: Vec<u32>,
    /// Lists of the members at each individual: the last member at each individual, and for each
    /// member and side the previous member at the same individual.
    head: Vec<u32>,
    before: Vec<[u32; 2]>,
    /// The factor `L D Lᵀ`: `L` by columns and by rows, in blocks of lanes, and `D⁻¹`.
    columns: Vec<Lanes>,
    rows: Vec<Lanes>,
    inverse: Vec<f64>,
    right: Vec<Lanes>,
    multipliers: Vec<f64>,
    slacks: Vec<f64>,
    vector: Vec<Part>,
    change: Vec<Part>,
    scratch: Vec<u32>,
}

impl Small {
    /// Solves from `guess`; `solution` keeps the result if it is the best. Returns whether its
    /// residual is at most [`DONE`]. The places of rows must be the indices of individuals.
    ///
    /// - Shapes: m rows, m multipliers in `guess`.
    #[inline(always)]
    pub fn solve(&mut self, qp: &Qp, rows: &[Row], guess: &[f64], solution: &mut Solution) -> bool {
        self.multipliers.clear();
        self.multipliers.extend_from_slice(guess);
        self.members.clear();
        for (k, &value) in guess.iter().enumerate() {
            if value > 0.0 {
                self.members.push(to_u32(k));
            }
        }
        for _ in 0..MAX_ROUNDS {
            // An empty set has nothing to factor, and a larger one is too expensive here. The
            // sparse solver then starts from the guess.
            if !(1..=MAX_ACTIVE).contains(&self.members.len()) {
                return false;
            }
            solution.iterations += 1;
            self.assemble(rows, qp.free.len());
            self.eliminate();
            for _ in 0..MAX_PASSES {
                self.displace(rows, qp.free.len());
                self.pass(rows);
                if self.exchange(rows) {
                    break;
                }
                solution.offer(qp, self.multipliers.iter().copied());
                if solution.residual <= DONE {
                    return true;
                }
            }
        }
        false
    }

    /// Returns the number of blocks of lanes in a column.
    fn blocks(&self) -> usize {
        self.members.len().div_ceil(LANES)
    }

    /// Fills the lower half of `A W⁻¹ Aᵀ`; entries are non-zero if two members share an individual.
    #[expect(clippy::needless_range_loop, reason = "sides of several arrays")]
    #[inline(always)]
    fn assemble(&mut self, rows: &[Row], n: usize) {
        let blocks = self.blocks();
        self.columns.clear();
        self.columns
            .resize(self.members.len() * blocks, [0.0; LANES]);
        self.head.clear();
        self.head.resize(n, NONE);
        self.before.clear();
        for (a, &member) in self.members.iter().enumerate() {
            let row = &rows[member as usize];
            let mut squares = 0.0;
            let mut before = [NONE; 2];
            for side in 0..2 {
                let part = &row.parts[side];
                squares += product(part, part);
                let head = &mut self.head[row.place[side] as usize];
                before[side] = *head;
                let mut other = *head;
                while other != NONE {
                    let b = other as usize;
                    let there = &rows[self.members[b] as usize];
                    let its = usize::from(there.place[1] == row.place[side]);
                    self.columns[b * blocks + a / LANES][a % LANES] +=
                        product(part, &there.parts[its]);
                    other = self.before[b][its];
                }
                *head = to_u32(a);
            }
            self.before.push(before);
            self.columns[a * blocks + a / LANES][a % LANES] = squares * (1.0 + SHIFT);
        }
    }

    /// Replaces the matrix by its factor.
    #[inline(always)]
    fn eliminate(&mut self) {
        self.rows.clear();
        self.rows.resize(self.columns.len(), [0.0; LANES]);
        self.inverse.clear();
        match self.blocks() {
            1 => self.eliminate_in::<1>(),
            2 => self.eliminate_in::<2>(),
            _ => self.eliminate_in::<3>(),
        }
    }

    /// Replaces the matrix by its factor, in columns of `B` blocks. Each column is eliminated from
    /// all columns to its right.
    #[inline(always)]
    fn eliminate_in<const B: usize>(&mut self) {
        let (columns, _) = self.columns.as_chunks_mut::<B>();
        let (rows, _) = self.rows.as_chunks_mut::<B>();
        for column in 0..columns.len() {
            let own = columns[column];
            let pivot = own.as_flattened()[column];
            // A pivot below the shift is a rounding error.
            let inverse = 1.0 / if pivot > SHIFT { pivot } else { SHIFT };
            self.inverse.push(inverse);
            let mut scaled = own;
            for entries in &mut scaled {
                for entry in entries {
                    *entry *= inverse;
                }
            }
            for later in column + 1..columns.len() {
                let factor = own.as_flattened()[later];
                rows[later].as_flattened_mut()[column] = scaled.as_flattened()[later];
                for (target, entries) in columns[later].iter_mut().zip(&scaled) {
                    for lane in 0..LANES {
                        target[lane] -= entries[lane] * factor;
                    }
                }
            }
            // The diagonal of `L` is 1, and the entries above it are 0.
            scaled.as_flattened_mut()[..=column].fill(0.0);
            columns[column] = scaled;
        }
    }

    /// Replaces the right-hand side by the solution.
    #[inline(always)]
    fn substitute(&mut self) {
        match self.blocks() {
            1 => self.substitute_in::<1>(),
            2 => self.substitute_in::<2>(),
            _ => self.substitute_in::<3>(),
        }
    }

    #[inline(always)]
    fn substitute_in<const B: usize>(&mut self) {
        let Some(right) = self.right.first_chunk_mut::<B>() else {
            unreachable!("the right-hand side has as many blocks as a column");
        };
        for (k, entries) in self.columns.as_chunks::<B>().0.iter().enumerate() {
            subtract(right, k, entries);
        }
        let mut entries = right.as_flattened_mut().iter_mut();
        for inverse in &self.inverse {
            *entries.next().expect("one for each column") *= inverse;
        }
        for (k, entries) in self.rows.as_chunks::<B>().0.iter().enumerate().rev() {
            subtract(right, k, entries);
        }
    }

    /// Computes `w` and all slacks from the multipliers.
    #[inline(always)]
    fn displace(&mut self, rows: &[Row], n: usize) {
        self.vector.clear();
        self.vector.resize(n, [0.0; 4]);
        for &member in &self.members {
            let k = member as usize;
            rows[k].add(self.multipliers[k], &mut self.vector);
        }
        self.slacks.clear();
        for row in rows {
            self.slacks.push(row.slack_at(&self.vector));
        }
    }

    /// Changes the multipliers so that the gaps of the members close.
    #[inline(always)]
    fn pass(&mut self, rows: &[Row]) {
        self.right.clear();
        self.right.resize(self.blocks(), [0.0; LANES]);
        for (a, &member) in self.members.iter().enumerate() {
            self.right[a / LANES][a % LANES] = -self.slacks[member as usize];
        }
        self.substitute();
        self.change.clear();
        self.change.resize(self.vector.len(), [0.0; 4]);
        for (a, &member) in self.members.iter().enumerate() {
            let (k, more) = (member as usize, self.right[a / LANES][a % LANES]);
            self.multipliers[k] += more;
            rows[k].add(more, &mut self.change);
        }
    }

    /// Exchanges all contacts on the wrong side; returns whether any was.
    #[inline(always)]
    fn exchange(&mut self, rows: &[Row]) -> bool {
        let (mut next, mut exchanged) = (0, false);
        let mut members = std::mem::take(&mut self.scratch);
        members.clear();
        for (k, row) in rows.iter().enumerate() {
            let pushed = self.members.get(next) == Some(&to_u32(k));
            next += usize::from(pushed);
            let pushes = if pushed {
                self.multipliers[k] >= -WRONG
            } else {
                self.slacks[k] + row.along(&self.change) < -WRONG
            };
            exchanged |= pushes != pushed;
            if pushes {
                members.push(to_u32(k));
            } else {
                self.multipliers[k] = 0.0;
            }
        }
        self.scratch = std::mem::replace(&mut self.members, members);
        exchanged
    }
}

/// `right -= right[k] entries`.
#[inline(always)]
fn subtract<const B: usize>(right: &mut [Lanes; B], k: usize, entries: &[Lanes; B]) {
    let value = right.as_flattened()[k];
    for (target, entries) in right.iter_mut().zip(entries) {
        for lane in 0..LANES {
            target[lane] -= entries[lane] * value;
        }
    }
}

#[inline(always)]
fn product(one: &Part, other: &Part) -> f64 {
    one[0] * other[0] + one[1] * other[1] + one[2] * other[2]
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "indices of contacts have 32 bits"
)]
#[inline(always)]
fn to_u32(k: usize) -> u32 {
    k as u32
}
