//! The closure: the few contacts on the wrong side, resolved jointly.
//!
//! In a packed group one wrong contact changes the signs of many multipliers, so an exchange of all
//! contacts that appear wrong need not converge. Instead the worst contacts become members of a
//! small dense complementarity problem, which is solved exactly. All other contacts keep their
//! status, and their values follow. Members are never removed within one factorisation, so the
//! rounds are finite.

use super::factor::{Factor, Path};
use super::rows::{NONE, Part, Row};
use super::tableau::Tableau;
use super::{WRONG, clear, not_negative};

/// Contacts that join in a round at most, plus one for every [`ROWS_PER_JOIN`] rows, since a round
/// costs a sweep over all rows.
const MAX_JOIN: usize = 16;
const ROWS_PER_JOIN: usize = 1024;

/// Members at most; beyond that, another factorisation is cheaper.
const MAX_MEMBERS: usize = 384;

/// The members with their complementarity problem.
#[derive(Clone, Debug, Default)]
pub struct Closure {
    /// Row indices of the members.
    members: Vec<u32>,
    /// Start of each member's path in `path`, and the end of the last.
    path_start: Vec<usize>,
    path: Path,
    /// Index in `path` from which on a member's path is a single chain of parents to the root.
    joined: Vec<usize>,
    /// `b_aᵀ K⁻¹ b_b` of all pairs of members: the lower triangle, row by row.
    gram: Vec<f64>,
    tableau: Tableau,
    /// `z` of each member when `close` began, 0 for those that joined since. The pass already
    /// contains its effect.
    before: Vec<f64>,
    wrong: Vec<(f64, u32)>,
    exchanged: Vec<u32>,
    right: Vec<f64>,
}

impl Closure {
    /// Removes all members.
    pub fn clear(&mut self) {
        self.members.clear();
        self.exchanged.clear();
        self.path.clear();
        self.path_start.clear();
        self.path_start.push(0);
        self.joined.clear();
        self.tableau.clear();
    }

    /// Collects the worst contacts on the wrong side that are not members: first those that would
    /// overlap, the deepest first, then those that would pull, in the order in which they reach
    /// `λ = 0`.
    #[inline(always)]
    fn find_wrong(&mut self, rows: &[Row]) {
        self.wrong.clear();
        for (k, row) in rows.iter().enumerate() {
            let wrong = row.followed < -WRONG;
            if !wrong || row.rank != NONE {
                continue;
            }
            let depth = if row.active {
                row.multiplier / (row.multiplier - row.followed)
            } else {
                row.followed
            };
            #[expect(
                clippy::cast_possible_truncation,
                reason = "indices of contacts have 32 bits"
            )]
            self.wrong.push((depth, k as u32));
        }
        let join = MAX_JOIN + rows.len() / ROWS_PER_JOIN;
        if self.wrong.len() > join {
            let by_value = |a: &(f64, u32), b: &(f64, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
            self.wrong.select_nth_unstable_by(join - 1, by_value);
            self.wrong.truncate(join);
            self.wrong.sort_unstable_by_key(|(_, name)| *name);
        }
    }

    /// Computes multipliers and the active set, such that after the pass no contact is on the wrong
    /// side. Returns whether it succeeded; if not, the multipliers are inexact but usable.
    ///
    /// - Shapes: m rows; a vector of n parts in `change`, which is overwritten.
    #[inline(always)]
    pub fn close(&mut self, rows: &mut [Row], factor: &Factor, change: &mut Vec<Part>) -> bool {
        self.resume(rows);
        let mut pivots = 0;
        let closed = loop {
            self.find_wrong(rows);
            if self.wrong.is_empty() && self.tableau.value.iter().all(|&value| value >= -WRONG) {
                break true;
            }
            if self.members.len() + self.wrong.len() > MAX_MEMBERS {
                break false;
            }
            clear(change, factor.structure.place.len());
            self.join(rows, factor, change);
            self.pose(rows);
            if !self.tableau.solve(0.1 * WRONG, &mut pivots) {
                break false;
            }
            // The values of all other contacts follow.
            for (a, before) in self.before.iter().enumerate() {
                let more = self.tableau.raised(a) - before;
                if more != 0.0 {
                    let path = self.path_start[a]..self.path_start[a + 1];
                    let push = more * cause(&rows[self.members[a] as usize]);
                    self.path.descend(path, push, change);
                }
            }
            factor.back(change);
            for row in rows.iter_mut() {
                let along = row.along(change);
                row.followed = if row.active {
                    row.proposed - row.penalty * along
                } else {
                    row.ahead + along
                };
            }
        };
        for row in rows.iter_mut().filter(|row| row.rank == NONE) {
            row.multiplier = if row.active {
                not_negative(row.followed)
            } else {
                0.0
            };
        }
        self.exchanged.clear();
        for (a, &k) in (0..).zip(&self.members) {
            let row = &mut rows[k as usize];
            let exchanged = self.tableau.exchanged[a as usize];
            row.rank = NONE;
            row.pushing = row.active != exchanged;
            let value = not_negative(self.tableau.value[a as usize]);
            row.multiplier = if row.pushing { value } else { 0.0 };
            if exchanged {
                self.exchanged.push(a);
            }
        }
        closed
    }

    /// Continues with the members so far. The pass includes those that have changed sides, so their
    /// values are the start of the next round.
    #[inline(always)]
    fn resume(&mut self, rows: &mut [Row]) {
        self.before.clear();
        for (rank, &member) in (0..).zip(&self.members) {
            let row = &mut rows[member as usize];
            row.rank = rank;
            self.tableau.value[rank as usize] = row.followed;
            self.before.push(self.tableau.raised(rank as usize));
        }
    }

    /// Adds the contacts found wrong to the members, with their paths and products. `zeros` is zero
    /// before and after.
    #[inline(always)]
    fn join(&mut self, rows: &mut [Row], factor: &Factor, zeros: &mut [Part]) {
        let old = self.members.len();
        for &(_, name) in &self.wrong {
            #[expect(clippy::cast_possible_truncation, reason = "members are few")]
            let rank = self.members.len() as u32;
            rows[name as usize].rank = rank;
            self.members.push(name);
            self.tableau.value.push(rows[name as usize].followed);
            self.before.push(0.0);
            let joined = factor.climb(&rows[name as usize], &mut self.path, zeros);
            self.joined.push(joined);
            self.path_start.push(self.path.nodes.len());
        }
        let size = self.members.len();
        self.gram.resize(size * (size + 1) / 2, 0.0);
        for a in old..size {
            for b in 0..=a {
                let product = self.product(a, b);
                self.gram[a * (a + 1) / 2 + b] = product;
            }
        }
    }

    /// Returns `b_aᵀ K⁻¹ b_b`: the sum of products at the nodes that two paths share.
    #[inline(always)]
    fn product(&self, a: usize, b: usize) -> f64 {
        let [mut one, mut other] =
            [a, b].map(|member| self.path_start[member]..self.path_start[member + 1]);
        let Path {
            nodes,
            parts,
            scaled,
        } = &self.path;
        let mut forked = [0.0; 4];
        while one.start < self.joined[a] || other.start < self.joined[b] {
            if one.is_empty() || other.is_empty() {
                return sum(forked);
            }
            let (here, there) = (nodes[one.start], nodes[other.start]);
            if here == there {
                let (part, scaled) = (&parts[one.start], &scaled[other.start]);
                for lane in 0..4 {
                    forked[lane] += part[lane] * scaled[lane];
                }
            }
            one.start += usize::from(here <= there);
            other.start += usize::from(there <= here);
        }
        // Two chains of parents stay together once they meet.
        let common = common_end(&nodes[one.clone()], &nodes[other.clone()]);
        let parts = &parts[one.end - common..one.end];
        let scaled = &scaled[other.end - common..other.end];
        sum(forked) + dot(parts.as_flattened(), scaled.as_flattened())
    }

    /// Extends the complementarity problem to all members; for the previous members it is solved.
    ///
    /// For a member that was active when `K` was factored, `z` is its gap and its multiplier must
    /// not become negative. For any other member, `z` is its multiplier and its gap must not become
    /// negative. The passes solve `s + Δλ/σ = 0`, so this gap, `z` or `y`, contains `Δλ/σ`: hence
    /// the terms with the penalty on the diagonal. The next pass removes it.
    #[inline(always)]
    fn pose(&mut self, rows: &[Row]) {
        let Self {
            members,
            gram,
            tableau,
            ..
        } = self;
        let member = |a: usize| &rows[members[a] as usize];
        let entry = |a: usize, b: usize| {
            let row = member(a);
            let (low, high) = if a < b { (a, b) } else { (b, a) };
            let product = gram[high * (high + 1) / 2 + low];
            match (a == b, row.active) {
                (true, true) => row.penalty * (1.0 - row.penalty * product),
                (true, false) => product + 1.0 / row.penalty,
                (false, true) => -row.penalty * cause(member(b)) * product,
                (false, false) => cause(member(b)) * product,
            }
        };
        tableau.extend(members.len(), entry);
    }

    /// Corrects a refining pass for the members that have changed sides.
    ///
    /// On entry `change` is `K⁻¹` times the right-hand side of the other contacts. The correction
    /// is added to it, and the proposed multipliers of the members that now push change, too.
    #[inline(always)]
    pub fn correct(
        &mut self,
        rows: &mut [Row],
        factor: &Factor,
        change: &mut [Part],
        extra: &mut Vec<Part>,
    ) {
        if self.exchanged.is_empty() {
            return;
        }
        self.right.clear();
        for &a in &self.exchanged {
            let row = &rows[self.members[a as usize] as usize];
            let along = row.along(change);
            self.right.push(if row.active {
                -row.penalty * along
            } else {
                row.slack + along
            });
        }
        clear(extra, change.len());
        for &a in &self.exchanged {
            let a = a as usize;
            let entries = self.tableau.row(a);
            let mut sum = 0.0;
            for (&b, right) in self.exchanged.iter().zip(&self.right) {
                sum -= entries[b as usize] * right;
            }
            let row = &mut rows[self.members[a] as usize];
            if !row.active {
                row.proposed += sum;
            }
            let path = self.path_start[a]..self.path_start[a + 1];
            self.path.descend(path, cause(row) * sum, extra);
        }
        factor.back(extra);
        for (part, more) in change.iter_mut().zip(extra) {
            for lane in 0..4 {
                part[lane] += more[lane];
            }
        }
    }
}

/// Returns the factor of `b_k` for a unit of a member's `z`: the penalty for a gap, 1 for a
/// multiplier.
#[inline(always)]
fn cause(row: &Row) -> f64 {
    if row.active { row.penalty } else { 1.0 }
}

#[inline(always)]
fn sum([x, y, z, _]: Part) -> f64 {
    (x + y) + z
}

/// Returns the number of nodes that two paths to a root share at their ends.
#[inline(always)]
fn common_end(a: &[u32], b: &[u32]) -> usize {
    // Paths stay together once they meet, so a binary search finds the shared length.
    let (mut shared, mut apart) = (0, a.len().min(b.len()) + 1);
    while apart - shared > 1 {
        let middle = shared + (apart - shared) / 2;
        if a[a.len() - middle] == b[b.len() - middle] {
            shared = middle;
        } else {
            apart = middle;
        }
    }
    shared
}

/// Returns the scalar product, summed in lanes whose order is the same on every processor.
#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    const LANES: usize = 8;
    let (a_blocks, a_rest) = a.as_chunks::<LANES>();
    let (b_blocks, b_rest) = b.as_chunks::<LANES>();
    let mut lanes = [0.0; LANES];
    for (a, b) in a_blocks.iter().zip(b_blocks) {
        for lane in 0..LANES {
            lanes[lane] += a[lane] * b[lane];
        }
    }
    for (lane, (a, b)) in a_rest.iter().zip(b_rest).enumerate() {
        lanes[lane] += a * b;
    }
    ((lanes[0] + lanes[4]) + (lanes[1] + lanes[5]))
        + ((lanes[2] + lanes[6]) + (lanes[3] + lanes[7]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row() -> Row {
        Row {
            place: [0, 1],
            parts: [[0.0; 4]; 2],
            gap: 0.0,
            penalty: 1.0,
            block: 0,
            rank: NONE,
            active: false,
            pushing: false,
            multiplier: 0.0,
            proposed: 0.0,
            slack: 0.0,
            ahead: 0.0,
            followed: 0.0,
        }
    }

    fn names(closure: &Closure) -> Vec<u32> {
        closure.wrong.iter().map(|(_, name)| *name).collect()
    }

    #[test]
    fn at_most_16_of_the_worst_are_chosen_and_one_more_for_every_1024_rows() {
        for (count, joining) in [(20_u32, 16), (1023, 16), (1024, 17), (2048, 18)] {
            // The deepest are the last; each second row is a member already.
            let mut rows = vec![row(); count as usize];
            for (k, row) in rows.iter_mut().enumerate() {
                row.followed = -1.0 - k as f64;
                if k % 2 == 0 {
                    row.rank = 3;
                }
            }
            let mut closure = Closure::default();
            closure.find_wrong(&rows);
            let candidates = count as usize / 2;
            let last = (0..count).filter(|k| k % 2 == 1);
            let skipped = candidates.saturating_sub(joining);
            let expected: Vec<u32> = last.skip(skipped).collect();
            assert_eq!(names(&closure), expected, "{count}");
        }
    }

    #[test]
    fn overlaps_are_chosen_first_then_contacts_that_reach_zero_soonest() {
        // Multipliers of 1 that fall to -1, -3, ... reach 0 at 1/2, 1/4, ... of the way.
        let mut rows = vec![row(); 20];
        for (k, row) in rows.iter_mut().enumerate() {
            row.active = true;
            row.multiplier = 1.0;
            row.followed = -1.0 - 2.0 * k as f64;
        }
        // An overlap joins whatever its depth; what is only just wrong by rounding does not.
        (rows[0].active, rows[0].followed) = (false, -2.0 * WRONG);
        rows[19].followed = -0.5 * WRONG;
        (rows[18].active, rows[18].followed) = (false, 1.0);
        let mut closure = Closure::default();
        closure.find_wrong(&rows);
        let expected: Vec<u32> = [0].into_iter().chain(3..18).collect();
        assert_eq!(names(&closure), expected);
    }

    #[test]
    fn scalar_products_of_any_length_are_exact_for_small_integers() {
        for length in [0, 1, 7, 8, 9, 16, 19] {
            let a: Vec<f64> = (1..=length).map(f64::from).collect();
            let b: Vec<f64> = (1..=length).map(|k| f64::from(2 * k - 1)).collect();
            let expected: i32 = (1..=length).map(|k| k * (2 * k - 1)).sum();
            assert_eq!(dot(&a, &b), f64::from(expected), "{length}");
        }
    }

    #[test]
    fn paths_share_their_common_end() {
        let all = [1, 2, 3, 4, 5, 6, 7];
        for shared in 0..=7 {
            for other in 0..4 {
                let mut b: Vec<u32> = (10..10 + other).collect();
                b.extend(&all[7 - shared..]);
                assert_eq!(common_end(&all, &b), shared, "{b:?}");
                assert_eq!(common_end(&b, &all), shared, "{b:?}");
            }
        }
    }
}
