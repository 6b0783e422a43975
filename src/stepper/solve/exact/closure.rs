//! The few contacts on the wrong side, resolved jointly.
//!
//! In a packed group one wrong contact swings many multipliers, so exchanging all that look
//! wrong wanders. Instead a set of doubtful contacts grows by the worst offenders, and is solved
//! exactly as a small dense complementarity problem with everybody else following. It only
//! grows, so this ends.

use std::ops::Range;

use super::WRONG;
use super::factor::{Factor, Path};
use super::rows::{Part, Row};
use super::tableau::Tableau;

/// How many contacts join a round at most.
const JOIN: usize = 16;

/// How many contacts may be in doubt: beyond, another factorisation is cheaper.
const MOST_MEMBERS: usize = 384;

const OUTSIDE: u32 = u32::MAX;

/// The doubtful contacts.
#[derive(Clone, Debug, Default)]
pub struct Closure {
    /// Multipliers with everybody on the right side of the pass's problem.
    pub multipliers: Vec<f64>,
    slacks: Vec<f64>,
    /// Which rows they are.
    members: Vec<u32>,
    /// The rank of each row among them.
    rank: Vec<u32>,
    /// Where each member's path begins, and where the last one ends.
    path_start: Vec<usize>,
    path: Path,
    /// Whether each member's path is one way up.
    straight: Vec<bool>,
    /// `b_a K⁻¹ b_b` of all pairs of members, row by row.
    gram: Vec<f64>,
    tableau: Tableau,
    wrong: Vec<(f64, u32)>,
    exchanged: Vec<u32>,
    right: Vec<f64>,
}

/// What closing starts from: multipliers and gaps after one pass over the active set.
pub struct Base<'a> {
    /// The program.
    pub rows: &'a [Row],
    /// Who was taken to push when `K` was factored.
    pub active: &'a [bool],
    /// Multipliers before the pass.
    pub before: &'a [f64],
    /// Multipliers after the pass, of the active.
    pub multipliers: &'a [f64],
    /// Gaps after the pass, of the others.
    pub slacks: &'a [f64],
}

impl Closure {
    /// Forgets all members.
    pub fn clear(&mut self) {
        self.members.clear();
        self.exchanged.clear();
    }

    /// Whether row `k` has changed sides since `K` was factored.
    #[inline(always)]
    pub fn is_exchanged(&self, k: usize) -> bool {
        !self.exchanged.is_empty()
            && self.rank[k] != OUTSIDE
            && self.tableau.exchanged[self.rank[k] as usize]
    }

    /// Collects who is on the wrong side: those that would pull, by who stops pushing first,
    /// and before them those that would overlap, the deepest first.
    #[inline(always)]
    fn find_wrong(&mut self, base: &Base) {
        let (multipliers, slacks) = (&self.multipliers, &self.slacks);
        self.wrong.clear();
        for k in 0..base.rows.len() {
            if self.rank[k] != OUTSIDE {
                continue;
            }
            #[expect(
                clippy::cast_possible_truncation,
                reason = "contacts are named by 32 bits"
            )]
            let name = k as u32;
            if base.active[k] {
                if multipliers[k] < -WRONG {
                    let share = base.before[k] / (base.before[k] - multipliers[k]);
                    self.wrong.push((share, name));
                }
            } else if slacks[k] < -WRONG {
                self.wrong.push((slacks[k], name));
            }
        }
        if self.wrong.len() > JOIN {
            let by_value = |a: &(f64, u32), b: &(f64, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
            self.wrong.select_nth_unstable_by(JOIN - 1, by_value);
            self.wrong.truncate(JOIN);
            self.wrong.sort_unstable_by_key(|(_, name)| *name);
        }
    }

    /// Finds multipliers with nobody on the wrong side of the pass's problem, and tells whether it
    /// came to an end.
    #[inline(always)]
    pub fn close(&mut self, base: &Base, factor: &mut Factor, change: &mut Vec<Part>) -> bool {
        self.multipliers.clear();
        self.multipliers.extend_from_slice(base.multipliers);
        self.slacks.clear();
        self.slacks.extend_from_slice(base.slacks);
        self.rank.clear();
        self.rank.resize(base.rows.len(), OUTSIDE);
        self.members.clear();
        self.exchanged.clear();
        self.path.clear();
        self.straight.clear();
        self.path_start.clear();
        self.path_start.push(0);
        let mut pivots = 0;
        loop {
            self.find_wrong(base);
            if self.wrong.is_empty() {
                return true;
            }
            if self.members.len() + self.wrong.len() > MOST_MEMBERS {
                return false;
            }
            self.join(base, factor);
            self.pose(base);
            if !self.tableau.solve(0.1 * WRONG, &mut pivots) {
                return false;
            }
            self.exchanged.clear();
            #[expect(clippy::cast_possible_truncation, reason = "members are few")]
            self.exchanged.extend(
                (0..self.members.len() as u32).filter(|&a| self.tableau.exchanged[a as usize]),
            );
            // Everybody outside follows.
            change.clear();
            change.resize(factor.structure.place.len(), [0.0; 4]);
            for &a in &self.exchanged {
                let a = a as usize;
                let k = self.members[a] as usize;
                let push = self.tableau.value[a]
                    * if base.active[k] {
                        base.rows[k].penalty
                    } else {
                        1.0
                    };
                let path = self.path_start[a]..self.path_start[a + 1];
                self.path.descend(path, push, change);
            }
            factor.back(change);
            for (k, row) in base.rows.iter().enumerate() {
                if self.rank[k] != OUTSIDE {
                    let a = self.rank[k] as usize;
                    let pushes = base.active[k] != self.tableau.exchanged[a];
                    self.multipliers[k] = if pushes { self.tableau.value[a] } else { 0.0 };
                } else if base.active[k] {
                    self.multipliers[k] = base.multipliers[k] - row.penalty * row.along(change);
                } else {
                    self.slacks[k] = base.slacks[k] + row.along(change);
                }
            }
        }
    }

    /// Takes those found wrong for members, with their paths and products.
    #[inline(always)]
    fn join(&mut self, base: &Base, factor: &mut Factor) {
        let old = self.members.len();
        for &(_, name) in &self.wrong {
            #[expect(clippy::cast_possible_truncation, reason = "members are few")]
            let rank = self.members.len() as u32;
            self.rank[name as usize] = rank;
            self.members.push(name);
            let straight = factor.climb(&base.rows[name as usize], &mut self.path);
            self.straight.push(straight);
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

    /// `b_a K⁻¹ b_b`, where two paths are the same; ways up, once met, stay together.
    #[inline(always)]
    fn product(&self, a: usize, b: usize) -> f64 {
        let [one, other] =
            [a, b].map(|member| self.path_start[member]..self.path_start[member + 1]);
        let Path {
            nodes,
            parts,
            scaled,
        } = &self.path;
        if !(self.straight[a] && self.straight[b]) {
            return shared_product(&self.path, one, other);
        }
        let common = common_end(&nodes[one.clone()], &nodes[other.clone()]);
        let parts = &parts[one.end - common..one.end];
        let scaled = &scaled[other.end - common..other.end];
        dot(parts.as_flattened(), scaled.as_flattened())
    }

    /// Poses the complementarity problem of the members.
    ///
    /// A member that was taken to push is free to open its gap, by `z`, and its multiplier must
    /// not become negative; one that was not is free to push, by `z`, and its gap must not.
    #[inline(always)]
    fn pose(&mut self, base: &Base) {
        let size = self.members.len();
        self.tableau.begin(size);
        for a in 0..size {
            let k = self.members[a] as usize;
            let (pushes, penalty) = (base.active[k], base.rows[k].penalty);
            let answer = if pushes { -penalty } else { 1.0 };
            let start = if pushes {
                base.multipliers[k]
            } else {
                base.slacks[k]
            };
            self.tableau.value.push(start);
            let row = self.tableau.row_mut(a);
            for (b, entry) in row.iter_mut().enumerate() {
                let (high, low) = (a.max(b), a.min(b));
                let product = self.gram[high * (high + 1) / 2 + low];
                let other = self.members[b] as usize;
                let cause = if base.active[other] {
                    base.rows[other].penalty
                } else {
                    1.0
                };
                *entry = if a != b {
                    answer * cause * product
                } else if pushes {
                    penalty * (1.0 - penalty * product)
                } else {
                    product + 1.0 / penalty
                };
            }
        }
    }
    /// The correction of a refining pass for those that have changed sides.
    ///
    /// `change` is `K⁻¹` of the pass's right-hand side; `slack` gives the gaps before it. Adds
    /// what the exchanged contribute, and returns through `multipliers` the change of those that
    /// now push.
    #[inline(always)]
    pub fn correct(
        &mut self,
        base_active: &[bool],
        rows: &[Row],
        slacks: &[f64],
        factor: &Factor,
        change: &mut [Part],
        extra: &mut Vec<Part>,
        multipliers: &mut [f64],
    ) {
        if self.exchanged.is_empty() {
            return;
        }
        self.right.clear();
        for &a in &self.exchanged {
            let k = self.members[a as usize] as usize;
            let along = rows[k].along(change);
            self.right.push(if base_active[k] {
                -rows[k].penalty * along
            } else {
                slacks[k] + along
            });
        }
        extra.clear();
        extra.resize(change.len(), [0.0; 4]);
        for &a in &self.exchanged {
            let a = a as usize;
            let k = self.members[a] as usize;
            let row = self.tableau.row(a);
            let mut sum = 0.0;
            for (&b, right) in self.exchanged.iter().zip(&self.right) {
                sum -= row[b as usize] * right;
            }
            let path = self.path_start[a]..self.path_start[a + 1];
            let push = if base_active[k] {
                rows[k].penalty * sum
            } else {
                multipliers[k] += sum;
                sum
            };
            self.path.descend(path, push, extra);
        }
        factor.back(extra);
        for (part, more) in change.iter_mut().zip(extra) {
            for lane in 0..4 {
                part[lane] += more[lane];
            }
        }
    }
}

/// The sum of products at the nodes that two paths share.
#[inline(always)]
fn shared_product(path: &Path, mut one: Range<usize>, mut other: Range<usize>) -> f64 {
    let mut lanes = [0.0; 4];
    while !one.is_empty() && !other.is_empty() {
        let (a, b) = (path.nodes[one.start], path.nodes[other.start]);
        if a == b {
            let (part, scaled) = (&path.parts[one.start], &path.scaled[other.start]);
            for lane in 0..4 {
                lanes[lane] += part[lane] * scaled[lane];
            }
        }
        one.start += usize::from(a <= b);
        other.start += usize::from(b <= a);
    }
    (lanes[0] + lanes[1]) + lanes[2]
}

/// How many nodes two paths to a root share at their ends.
#[inline(always)]
fn common_end(a: &[u32], b: &[u32]) -> usize {
    // Once met, paths stay together, so the shared lengths are all those up to the answer.
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

/// The sum of products, in lanes whose order no machine changes.
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
