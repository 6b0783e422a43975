//! The elimination order: nested dissection by straight cuts, minimum degree in the leaves.
//!
//! The contact graph of a group is nearly planar, so a straight cut severs few contacts. The
//! individuals on both sides of a cut are eliminated first, then those on the cut; each side is cut
//! in turn.

use crate::stepper::contact::Contact;

/// Largest set that is ordered by minimum degree.
const LEAF: usize = 192;

/// Words of a bit set of a leaf and its neighbours outside. If these are more than 256 in all, the
/// rest of the neighbours is not counted.
const WORDS: usize = 4;

/// Cosine and sine of the directions across which cuts are tried.
const DIRECTIONS: [[f64; 2]; 4] = [
    [1.0, 0.0],
    [0.0, 1.0],
    [
        std::f64::consts::FRAC_1_SQRT_2,
        std::f64::consts::FRAC_1_SQRT_2,
    ],
    [
        std::f64::consts::FRAC_1_SQRT_2,
        -std::f64::consts::FRAC_1_SQRT_2,
    ],
];

/// Least share of the set in the smaller side of a cut.
const MIN_SHARE: f64 = 0.3;

/// Weight of the squared imbalance in the cost of a cut.
const UNEVEN: f64 = 6.0;

type Bits = [u64; WORDS];

/// Computes elimination orders. Only buffers are kept between calls.
#[derive(Clone, Debug, Default)]
pub struct Dissection {
    start: Vec<u32>,
    neighbours: Vec<u32>,
    /// Rank within the current set; [`NONE`] outside of it.
    rank: Vec<u32>,
    side: Vec<Side>,
    along: Vec<(f64, u32)>,
    severed: Vec<i32>,
    local: Vec<u32>,
    bits: Vec<Bits>,
    degree: Vec<u32>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
enum Side {
    #[default]
    First,
    Second,
    Cut,
}

const NONE: u32 = u32::MAX;

impl Dissection {
    /// Computes an elimination order of all individuals at (x, y).
    ///
    /// - Shapes: n positions, contacts ordered by (i, j); n entries in the order.
    pub fn order(&mut self, contacts: &[Contact], x: &[f64], y: &[f64], order: &mut Vec<u32>) {
        let n = x.len();
        self.connect(n, contacts);
        self.rank.clear();
        self.rank.resize(n, NONE);
        self.side.clear();
        self.side.resize(n, Side::First);
        order.clear();
        #[expect(
            clippy::cast_possible_truncation,
            reason = "indices of individuals have 32 bits"
        )]
        order.extend(0..n as u32);
        self.dissect(x, y, order);
    }

    /// Builds the lists of neighbours; a pair counts once, whatever its number of contacts.
    fn connect(&mut self, n: usize, contacts: &[Contact]) {
        self.start.clear();
        self.start.resize(n + 2, 0);
        let mut last = (NONE, NONE);
        let mut distinct = |contact: &&Contact| {
            let pair = (contact.i, contact.j);
            std::mem::replace(&mut last, pair) != pair
        };
        for contact in contacts.iter().filter(&mut distinct) {
            self.start[contact.i as usize + 2] += 1;
            self.start[contact.j as usize + 2] += 1;
        }
        for k in 2..n + 2 {
            self.start[k] += self.start[k - 1];
        }
        self.neighbours.clear();
        self.neighbours.resize(self.start[n + 1] as usize, 0);
        last = (NONE, NONE);
        let mut distinct = |contact: &&Contact| {
            let pair = (contact.i, contact.j);
            std::mem::replace(&mut last, pair) != pair
        };
        for contact in contacts.iter().filter(&mut distinct) {
            for (from, to) in [(contact.i, contact.j), (contact.j, contact.i)] {
                let next = &mut self.start[from as usize + 1];
                self.neighbours[*next as usize] = to;
                *next += 1;
            }
        }
    }

    fn neighbours(&self, individual: u32) -> &[u32] {
        let at = individual as usize;
        &self.neighbours[self.start[at] as usize..self.start[at + 1] as usize]
    }

    /// Orders a set in place, by recursion.
    fn dissect(&mut self, x: &[f64], y: &[f64], set: &mut [u32]) {
        if set.len() <= LEAF {
            self.minimum_degree(set);
            return;
        }
        let (direction, count) = self.best_cut(x, y, set);
        self.project(x, y, set, direction);
        for (rank, &(_, individual)) in self.along.iter().enumerate() {
            self.rank[individual as usize] = 0;
            self.side[individual as usize] = if rank < count {
                Side::First
            } else {
                Side::Second
            };
        }
        // The individuals of one side with a neighbour on the other separate the sides. Those of
        // the side that has fewer of them become the cut.
        let facing = |dissection: &Self, individual: u32| {
            let side = dissection.side[individual as usize];
            dissection.neighbours(individual).iter().any(|&other| {
                dissection.rank[other as usize] != NONE && dissection.side[other as usize] != side
            })
        };
        let mut border = [0, 0];
        for &individual in set.iter() {
            if facing(self, individual) {
                border[usize::from(self.side[individual as usize] == Side::Second)] += 1;
            }
        }
        let fewer = if border[0] <= border[1] {
            Side::First
        } else {
            Side::Second
        };
        self.local.clear();
        for &individual in set.iter() {
            if self.side[individual as usize] == fewer && facing(self, individual) {
                self.local.push(individual);
            }
        }
        for k in 0..self.local.len() {
            self.side[self.local[k] as usize] = Side::Cut;
        }
        set.sort_unstable_by_key(|&individual| (self.side[individual as usize], individual));
        let first = set.partition_point(|&k| self.side[k as usize] == Side::First);
        let cut = set.partition_point(|&k| self.side[k as usize] != Side::Cut);
        set.iter()
            .for_each(|&individual| self.rank[individual as usize] = NONE);
        // In order along the cut, neighbours are consecutive.
        let [cos, sin] = DIRECTIONS[direction];
        let across = |k: u32| cos * y[k as usize] - sin * x[k as usize];
        set[cut..].sort_unstable_by(|&a, &b| across(a).total_cmp(&across(b)).then(a.cmp(&b)));
        let (sides, _) = set.split_at_mut(cut);
        let (one, other) = sides.split_at_mut(first);
        self.dissect(x, y, one);
        self.dissect(x, y, other);
    }

    /// Sorts a set by position along a direction, into `along`.
    fn project(&mut self, x: &[f64], y: &[f64], set: &[u32], direction: usize) {
        let [cos, sin] = DIRECTIONS[direction];
        self.along.clear();
        self.along.extend(
            set.iter()
                .map(|&k| (cos * x[k as usize] + sin * y[k as usize], k)),
        );
        self.along
            .sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    }

    /// Returns the direction of the cheapest cut and the size of its first side. The cost is the
    /// number of severed pairs plus 1, increased for uneven sides.
    fn best_cut(&mut self, x: &[f64], y: &[f64], set: &[u32]) -> (usize, usize) {
        let n = set.len();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a share of a length"
        )]
        let least = (MIN_SHARE * n as f64) as usize;
        let mut best = (f64::INFINITY, 0, n / 2);
        for direction in 0..DIRECTIONS.len() {
            self.project(x, y, set, direction);
            for (rank, &(_, individual)) in self.along.iter().enumerate() {
                #[expect(clippy::cast_possible_truncation, reason = "below n")]
                let rank = rank as u32;
                self.rank[individual as usize] = rank;
            }
            self.severed.clear();
            self.severed.resize(n + 1, 0);
            for (rank, &(_, individual)) in self.along.iter().enumerate() {
                let at = individual as usize;
                let own = self.start[at] as usize..self.start[at + 1] as usize;
                for &other in &self.neighbours[own] {
                    let there = self.rank[other as usize];
                    if there != NONE && there as usize > rank {
                        self.severed[rank + 1] += 1;
                        self.severed[there as usize + 1] -= 1;
                    }
                }
            }
            let mut pairs = 0;
            for (count, change) in self.severed.iter().enumerate().take(n - least + 1) {
                pairs += change;
                let uneven = count as f64 / n as f64 - 0.5;
                let cost = (f64::from(pairs) + 1.0) * (1.0 + UNEVEN * uneven * uneven);
                if count >= least && cost < best.0 {
                    best = (cost, direction, count);
                }
            }
            for &individual in set {
                self.rank[individual as usize] = NONE;
            }
        }
        (best.1, best.2)
    }

    /// Orders a small set by minimum degree: the next individual is the one with the fewest
    /// remaining neighbours, including those outside. Of equal ones the lower index comes first.
    fn minimum_degree(&mut self, set: &mut [u32]) {
        set.sort_unstable();
        let n = set.len();
        self.local.clear();
        self.local.extend_from_slice(set);
        for (rank, &individual) in set.iter().enumerate() {
            #[expect(clippy::cast_possible_truncation, reason = "below the size of a leaf")]
            let rank = rank as u32;
            self.rank[individual as usize] = rank;
        }
        self.bits.clear();
        self.bits.resize(n, [0; WORDS]);
        for (k, &individual) in set.iter().enumerate() {
            let at = individual as usize;
            for index in self.start[at]..self.start[at + 1] {
                let other = self.neighbours[index as usize];
                if self.rank[other as usize] == NONE {
                    if self.local.len() == 64 * WORDS {
                        continue;
                    }
                    #[expect(clippy::cast_possible_truncation, reason = "below 64 times WORDS")]
                    let rank = self.local.len() as u32;
                    self.rank[other as usize] = rank;
                    self.local.push(other);
                }
                insert(&mut self.bits[k], self.rank[other as usize] as usize);
            }
        }
        for k in 0..self.local.len() {
            self.rank[self.local[k] as usize] = NONE;
        }
        self.degree.clear();
        self.degree.extend(self.bits.iter().map(count));
        for slot in set.iter_mut() {
            let least = (0..n).min_by_key(|&k| self.degree[k]);
            let next = least.expect("a set is not empty");
            *slot = self.local[next];
            self.degree[next] = NONE;
            let mut clique = self.bits[next];
            remove(&mut clique, next);
            for (word, &members) in clique.iter().enumerate() {
                let mut members = members;
                while members != 0 {
                    let k = 64 * word + members.trailing_zeros() as usize;
                    members &= members - 1;
                    if k < n && self.degree[k] != NONE {
                        let bits = &mut self.bits[k];
                        bits.iter_mut()
                            .zip(&clique)
                            .for_each(|(word, more)| *word |= more);
                        remove(bits, k);
                        remove(bits, next);
                        self.degree[k] = count(bits);
                    }
                }
            }
        }
    }
}

fn insert(bits: &mut Bits, k: usize) {
    bits[k / 64] |= 1 << (k % 64);
}

fn remove(bits: &mut Bits, k: usize) {
    bits[k / 64] &= !(1 << (k % 64));
}

fn count(bits: &Bits) -> u32 {
    bits.iter().map(|word| word.count_ones()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square grid of `side` × `side` individuals, each in contact with its adjacent ones.
    fn grid(side: u32) -> (Vec<Contact>, Vec<f64>, Vec<f64>) {
        let contact = |i, j| Contact {
            i,
            j,
            code: 0,
            gap: 0.0,
            normal: [1.0, 0.0],
            lever: [0.0; 2],
        };
        let mut contacts = Vec::new();
        let (mut x, mut y) = (Vec::new(), Vec::new());
        for k in 0..side * side {
            let (column, row) = (k % side, k / side);
            x.push(f64::from(column));
            y.push(f64::from(row));
            if column + 1 < side {
                contacts.push(contact(k, k + 1));
                // A pair with two contacts counts as one neighbour.
                contacts.push(contact(k, k + 1));
            }
            if row + 1 < side {
                contacts.push(contact(k, k + side));
            }
        }
        (contacts, x, y)
    }

    /// Returns the number of blocks of the factor below the diagonal, for elimination in `order`.
    fn entries(contacts: &[Contact], order: &[u32]) -> usize {
        let mut place = vec![0; order.len()];
        (0..)
            .zip(order)
            .for_each(|(k, &individual)| place[individual as usize] = k);
        let mut rows = vec![std::collections::BTreeSet::new(); order.len()];
        for contact in contacts {
            let [a, b]: [usize; 2] = [contact.i, contact.j].map(|k| place[k as usize]);
            rows[a.min(b)].insert(a.max(b));
        }
        for column in 0..rows.len() {
            let own = rows[column].clone();
            if let Some(&parent) = own.first() {
                rows[parent].extend(own.into_iter().skip(1));
            }
        }
        rows.iter().map(std::collections::BTreeSet::len).sum()
    }

    #[test]
    fn each_individual_is_eliminated_once() {
        for side in [1, 3, 14, 40] {
            let (contacts, x, y) = grid(side);
            let (mut dissection, mut order) = (Dissection::default(), Vec::new());
            dissection.order(&contacts, &x, &y, &mut order);
            let again = order.clone();
            dissection.order(&contacts, &x, &y, &mut order);
            assert_eq!(order, again, "the same group has the same order");
            order.sort_unstable();
            assert!(order.into_iter().eq(0..side * side));
        }
    }

    #[test]
    fn an_order_fills_far_less_than_the_order_of_indices() {
        for (side, share) in [(10, 0.7), (40, 0.4)] {
            let (contacts, x, y) = grid(side);
            let mut order = Vec::new();
            Dissection::default().order(&contacts, &x, &y, &mut order);
            let by_index: Vec<u32> = (0..side * side).collect();
            let filled = entries(&contacts, &order) as f64 / entries(&contacts, &by_index) as f64;
            assert!(filled < share, "{side}: {filled}");
        }
    }
}
