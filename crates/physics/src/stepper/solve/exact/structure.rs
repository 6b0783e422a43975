//! Symbolic factorisation: the non-zero blocks of the factor of `K`, from the contact graph.

use super::rows::Row;
use crate::stepper::contact::Contact;

/// No column, or no block.
pub const NONE: u32 = u32::MAX;

/// Largest number of columns whose row sets are stored as bits of one integer.
const MAX_BIT_COLUMNS: usize = 128;

/// The columns of the factor, one for each individual of an active pair.
///
/// The structure depends only on the elimination order and on the active pairs, so it is kept while
/// both stay the same.
#[derive(Clone, Debug, Default)]
pub struct Structure {
    /// Number of columns.
    pub columns: usize,
    /// Place of each individual: its column, or a place after all columns.
    pub place: Vec<u32>,
    /// Column `k` has the blocks `start[k]..start[k + 1]`. Places after the columns have no blocks.
    pub start: Vec<u32>,
    /// Row of each block as a place, ascending within a column.
    pub row: Vec<u32>,
    /// Row `k` has the entries `left_start[k]..left_start[k + 1]` of `left`.
    pub left_start: Vec<u32>,
    /// Column and block of each entry left of the diagonal, by row.
    pub left: Vec<[u32; 2]>,
    /// First row below the diagonal of each column: its parent in the elimination tree.
    pub parent: Vec<u32>,
    /// The block that couples the two individuals of each contact; [`NONE`] if no contact of the
    /// pair is active.
    pub block: Vec<u32>,
    order: Vec<u32>,
    /// The active pairs, each once.
    pairs: Vec<[u32; 2]>,
    pair_block: Vec<u32>,
    scratch: Scratch,
}

#[derive(Clone, Debug, Default)]
struct Scratch {
    pairs: Vec<[u32; 2]>,
    ends: Vec<[u32; 2]>,
    bits: Vec<u128>,
    upward_start: Vec<u32>,
    upward: Vec<u32>,
    unsorted_start: Vec<u32>,
    unsorted: Vec<u32>,
    child: Vec<u32>,
    sibling: Vec<u32>,
    seen: Vec<u32>,
    next: Vec<u32>,
}

impl Structure {
    /// Rebuilds the structure if the order or the active pairs have changed.
    ///
    /// - Shapes: an order of all n individuals; m contacts ordered by (i, j), and m rows. A pair is
    ///   active if one of its rows is.
    pub fn update(&mut self, order: &[u32], contacts: &[Contact], rows: &[Row]) {
        let pairs = &mut self.scratch.pairs;
        pairs.clear();
        let mut last = [NONE, NONE];
        for (contact, row) in contacts.iter().zip(rows) {
            let pair = [contact.i, contact.j];
            if row.active && pair != last {
                pairs.push(pair);
                last = pair;
            }
        }
        if self.order != order || self.pairs != *pairs {
            self.order.clear();
            self.order.extend_from_slice(order);
            std::mem::swap(&mut self.pairs, pairs);
            self.number();
            self.list_ends();
            if self.columns <= MAX_BIT_COLUMNS {
                self.eliminate_bits();
            } else {
                self.point_upward();
                self.eliminate();
                self.sort();
            }
            self.find_blocks();
        }
        self.block.clear();
        let mut next = 0;
        for contact in contacts {
            let pair = [contact.i, contact.j];
            while next < self.pairs.len() && self.pairs[next] < pair {
                next += 1;
            }
            let joined = self.pairs.get(next) == Some(&pair);
            self.block
                .push(if joined { self.pair_block[next] } else { NONE });
        }
    }

    /// Numbers all individuals: first those of active pairs, in elimination order, then the others.
    fn number(&mut self) {
        let Self {
            place,
            pairs,
            order,
            columns,
            ..
        } = self;
        place.clear();
        place.resize(order.len(), NONE);
        pairs
            .iter()
            .flatten()
            .for_each(|&individual| place[individual as usize] = 0);
        let mut next = 0;
        for &individual in order.iter() {
            let place = &mut place[individual as usize];
            if *place != NONE {
                *place = next;
                next += 1;
            }
        }
        *columns = next as usize;
        for place in place.iter_mut().filter(|place| **place == NONE) {
            *place = next;
            next += 1;
        }
    }

    /// Lists the places of each active pair, the lower first.
    fn list_ends(&mut self) {
        let Self {
            place,
            pairs,
            scratch,
            ..
        } = self;
        scratch.ends.clear();
        scratch.ends.extend(pairs.iter().map(|pair| {
            let [a, b] = pair.map(|individual| place[individual as usize]);
            [a.min(b), a.max(b)]
        }));
    }

    /// Finds the rows of every column, with the same result as [`Structure::eliminate`] and
    /// [`Structure::sort`]. The rows of a column are bits of one integer.
    fn eliminate_bits(&mut self) {
        let Scratch {
            ends, bits, next, ..
        } = &mut self.scratch;
        bits.clear();
        bits.resize(self.columns, 0);
        for &[low, high] in ends.iter() {
            bits[low as usize] |= 1 << high;
        }
        self.parent.clear();
        self.start.clear();
        self.row.clear();
        for column in 0..self.columns {
            self.start.push(to_u32(self.row.len()));
            let mut left = bits[column];
            let parent = left.trailing_zeros();
            self.parent.push(if left == 0 { NONE } else { parent });
            while left != 0 {
                self.row.push(left.trailing_zeros());
                left &= left - 1;
            }
            if bits[column] != 0 {
                bits[parent as usize] |= bits[column] & !(1 << parent);
            }
        }
        self.parent.resize(self.place.len(), NONE);
        self.start
            .resize(self.place.len() + 1, to_u32(self.row.len()));
        bin_starts(&mut self.left_start, self.columns, self.row.iter().copied());
        next.clear();
        next.extend_from_slice(&self.left_start);
        self.left.clear();
        self.left.resize(self.row.len(), [0, 0]);
        for column in 0..self.columns {
            for block in self.start[column]..self.start[column + 1] {
                let next = &mut next[self.row[block as usize] as usize];
                self.left[*next as usize] = [to_u32(column), block];
                *next += 1;
            }
        }
    }

    /// Lists the neighbours of every column that have a higher place.
    fn point_upward(&mut self) {
        let Scratch {
            ends,
            upward_start,
            upward,
            next,
            ..
        } = &mut self.scratch;
        bin_starts(upward_start, self.columns, ends.iter().map(|[low, _]| *low));
        upward.clear();
        upward.resize(ends.len(), 0);
        next.clear();
        next.extend_from_slice(upward_start);
        for &[low, high] in ends.iter() {
            let next = &mut next[low as usize];
            upward[*next as usize] = high;
            *next += 1;
        }
    }

    /// Finds the rows of every column: its higher neighbours and the rows of its children in the
    /// elimination tree, without itself.
    fn eliminate(&mut self) {
        let Scratch {
            upward_start,
            upward,
            unsorted_start,
            unsorted,
            child,
            sibling,
            seen,
            ..
        } = &mut self.scratch;
        for list in [&mut *child, &mut *sibling, &mut *seen] {
            list.clear();
            list.resize(self.columns, NONE);
        }
        self.parent.clear();
        self.parent.resize(self.place.len(), NONE);
        unsorted.clear();
        unsorted_start.clear();
        unsorted_start.push(0);
        for column in 0..self.columns {
            let begin = unsorted.len();
            let mut first = NONE;
            seen[column] = to_u32(column);
            let mut take = |row: u32, unsorted: &mut Vec<u32>| {
                if std::mem::replace(&mut seen[row as usize], to_u32(column)) != to_u32(column) {
                    unsorted.push(row);
                    first = first.min(row);
                }
            };
            for &row in &upward[upward_start[column] as usize..upward_start[column + 1] as usize] {
                take(row, unsorted);
            }
            let mut below = child[column];
            while below != NONE {
                let at = below as usize;
                for k in unsorted_start[at]..unsorted_start[at + 1] {
                    let row = unsorted[k as usize];
                    take(row, unsorted);
                }
                below = sibling[at];
            }
            if unsorted.len() > begin {
                self.parent[column] = first;
                sibling[column] = child[first as usize];
                child[first as usize] = to_u32(column);
            }
            unsorted_start.push(to_u32(unsorted.len()));
        }
    }

    /// Sorts the rows of every column by transposing twice.
    fn sort(&mut self) {
        let Scratch {
            unsorted_start,
            unsorted,
            next,
            ..
        } = &mut self.scratch;
        bin_starts(&mut self.left_start, self.columns, unsorted.iter().copied());
        next.clear();
        next.extend_from_slice(&self.left_start);
        self.left.clear();
        self.left.resize(unsorted.len(), [0, 0]);
        for column in 0..self.columns {
            for k in unsorted_start[column]..unsorted_start[column + 1] {
                let next = &mut next[unsorted[k as usize] as usize];
                self.left[*next as usize][0] = to_u32(column);
                *next += 1;
            }
        }
        self.start.clear();
        self.start.extend_from_slice(unsorted_start);
        self.start
            .resize(self.place.len() + 1, to_u32(unsorted.len()));
        next.clear();
        next.extend_from_slice(unsorted_start);
        self.row.clear();
        self.row.resize(unsorted.len(), 0);
        for row in 0..self.columns {
            for entry in
                &mut self.left[self.left_start[row] as usize..self.left_start[row + 1] as usize]
            {
                let next = &mut next[entry[0] as usize];
                entry[1] = *next;
                self.row[*next as usize] = to_u32(row);
                *next += 1;
            }
        }
    }

    /// Finds the block of each active pair.
    fn find_blocks(&mut self) {
        self.pair_block.clear();
        for &[low, high] in &self.scratch.ends {
            let begin = self.start[low as usize] as usize;
            let rows = &self.row[begin..self.start[low as usize + 1] as usize];
            let found = begin + rows.partition_point(|&row| row < high);
            self.pair_block.push(to_u32(found));
        }
    }
}

/// Fills `start` for a counting sort: bin `k` of `bins` begins at `start[k]`.
fn bin_starts(start: &mut Vec<u32>, bins: usize, all: impl Iterator<Item = u32>) {
    start.clear();
    start.resize(bins + 1, 0);
    all.for_each(|bin| start[bin as usize + 1] += 1);
    for bin in 0..bins {
        start[bin + 1] += start[bin];
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "indices have 32 bits, and a nearly planar graph has few entries for each individual"
)]
fn to_u32(count: usize) -> u32 {
    count as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::random::{Purpose, Stream};

    #[test]
    fn bit_sets_and_lists_give_the_same_structure() {
        for seed in 0..100 {
            let mut stream = Stream::new(seed, 0, 0, Purpose::Start);
            let mut structure = Structure::default();
            let n = 2 + u32::try_from(seed).unwrap_or(0);
            structure.order.extend(0..n);
            for first in 0..n {
                let later = first + 1..n.min(first + 9);
                let pushing = later.filter(|_| stream.uniform() < 0.2);
                structure
                    .pairs
                    .extend(pushing.map(|second| [first, second]));
            }
            structure.number();
            structure.list_ends();
            let mut by_bits = structure.clone();
            by_bits.eliminate_bits();
            structure.point_upward();
            structure.eliminate();
            structure.sort();
            let all = |one: &Structure| {
                let lists = [&one.start, &one.row, &one.left_start, &one.parent];
                (lists.map(Vec::clone), one.left.clone())
            };
            assert_eq!(all(&by_bits), all(&structure), "seed {seed}");
        }
    }
}
