//! The exact solver: one factorisation, and a small problem for the contacts that change sides.
//!
//! From one step to the next few contacts change sides, so the contacts that pushed in the
//! last step are the first active set (`rows`, `order`, `structure`, `factor`). A pass of the
//! method of multipliers closes their gaps. The contacts that then pull or overlap become members
//! of a small dense complementarity problem (`closure`, `tableau`). Further passes with the same
//! factor refine the solution. If few contacts push, a dense factor is used instead (`small`). The
//! result is checked by the residual alone, computed from the multipliers.

mod closure;
mod factor;
mod order;
mod rows;
mod small;
mod structure;
mod tableau;

use super::{Hints, Solution, TARGET};
use crate::model::simd::{Level, multiversion};
use crate::stepper::qp::Qp;
use closure::Closure;
use factor::Factor;
use order::Dissection;
use rows::{Part, Row};
use small::Small;

/// σ, the penalty on a gap whose gradient has unit length in the metric of `W`. Each pass divides
/// the error by about σ times the least eigenvalue of the dual matrix with rows of unit length;
/// beyond 1e8 rounding in `K` dominates.
const PENALTY: f64 = 1e8;

/// A multiplier or slack below minus this is on the wrong side: well below the target, so that the
/// violation that remains does not affect whether the residual reaches it.
const WRONG: f64 = 0.05 * TARGET;

/// Residual at which the solver stops: well within the target, and usually reached by one pass.
const DONE: f64 = 0.25 * TARGET;

/// Passes with one factor. Each adds several digits, unless the active set is wrong.
const MAX_PASSES: usize = 6;

/// If a pass shrinks the largest open gap by less than this factor, no further pass is made.
const MIN_GAIN: f64 = 3.0;

/// If the first pass with a factor leaves at least this many contacts on the wrong side, all of
/// them change sides at once and `K` is factored again. The closure takes fewer members than that,
/// and in a group large enough for so many wrong contacts most are far from each other, so that
/// each can be resolved separately.
const MIN_BULK: usize = 1000;

/// After such an exchange, another is made only if the number of wrong contacts is below the last
/// one divided by this. Otherwise they are not far from each other, and the closure resolves them,
/// whatever their number.
const BULK_REDUCTION: usize = 2;

/// Factorisations before the solver stops. One is usual, two in a large group.
const MAX_FACTORS: usize = 12;

/// Solutions for which an elimination order is kept. The contacts change slowly, and every order
/// gives a correct factor.
const MAX_ORDER_AGE: u32 = 50;

/// The exact solver: its buffers, and the elimination order that it keeps between steps.
#[derive(Clone, Debug, Default)]
pub struct Exact {
    /// Instruction set of the kernels; it changes no bit of a result.
    pub level: Level,
    dissection: Dissection,
    /// The elimination order, loaded from the state or computed here.
    order: Vec<u32>,
    age: u32,
    rows: Vec<Row>,
    factor: Factor,
    closure: Closure,
    small: Small,
    /// `w`, then the change of `w` in a pass, then that in the closure.
    change: Vec<Part>,
    extra: Vec<Part>,
}

multiversion! {
    /// Solves for few contacts by a dense factor. The body is compiled for each level.
    fn few(level, exact: &mut Exact, qp: &Qp, guess: &[f64], solution: &mut Solution) -> bool {
        exact.small.solve(qp, &exact.rows, guess, solution)
    }
}

multiversion! {
    /// Solves by the sparse factor. The body is compiled for each level.
    fn attempt(level, exact: &mut Exact, qp: &Qp, solution: &mut Solution) {
        exact.attempt(qp, solution);
    }
}

impl Exact {
    /// Returns the elimination order and the number of solutions that have used it.
    ///
    /// - Shapes: n entries, or none before the first order is computed.
    #[must_use]
    pub fn order(&self) -> (&[u32], u32) {
        (&self.order, self.age)
    }

    /// Loads an elimination order and the number of solutions that have used it. An order whose
    /// length is not n is ignored: the solver then computes another.
    pub fn load_order(&mut self, order: &[u32], age: u32) {
        if self.order != order {
            self.order.clear();
            self.order.extend_from_slice(order);
        }
        self.age = age;
    }

    /// Solves `qp`; `solution` keeps the best solution found.
    ///
    /// - Shapes: n individuals and m contacts in `qp`; m multipliers and n coordinates in `hints`.
    pub(super) fn solve(&mut self, qp: &Qp, hints: &Hints, solution: &mut Solution) {
        rows::fill(qp, &mut self.rows);
        let pushed = hints.multipliers.iter().filter(|&&value| value > 0.0);
        if (1..=small::MAX_ACTIVE).contains(&pushed.count())
            && few(self.level, self, qp, hints.multipliers, solution)
        {
            return;
        }
        self.prepare(qp, hints);
        attempt(self.level, self, qp, solution);
    }

    /// Factors and converges, until a solution is exact or the factorisations run out.
    #[inline(always)]
    fn attempt(&mut self, qp: &Qp, solution: &mut Solution) {
        let mut bulk_limit = usize::MAX;
        for _ in 0..MAX_FACTORS {
            self.arrange(qp);
            self.factor.factor(&self.rows);
            solution.iterations += 1;
            self.closure.clear();
            if self.converge(qp, &mut bulk_limit, solution) {
                return;
            }
            for row in &mut self.rows {
                row.active = row.pushing;
            }
        }
    }

    /// Computes a new elimination order if necessary, and sets multipliers and active set of the
    /// rows.
    fn prepare(&mut self, qp: &Qp, hints: &Hints) {
        let n = qp.free.len();
        if self.order.len() != n || self.age >= MAX_ORDER_AGE {
            self.dissection
                .order(&qp.contacts, hints.x, hints.y, &mut self.order);
            self.age = 0;
        }
        self.age += 1;
        let mut any_active = false;
        for (row, &multiplier) in self.rows.iter_mut().zip(hints.multipliers) {
            row.multiplier = multiplier;
            row.active = multiplier > 0.0;
            any_active |= row.active;
        }
        for row in &mut self.rows {
            // Without a guess, the active set is the contacts that overlap after free motion.
            row.active |= !any_active && row.gap < 0.0;
            row.pushing = row.active;
        }
    }

    /// Sets the places and blocks of all rows, from the elimination order and the active set.
    fn arrange(&mut self, qp: &Qp) {
        let structure = &mut self.factor.structure;
        structure.update(&self.order, &qp.contacts, &self.rows);
        for ((row, contact), &block) in self.rows.iter_mut().zip(&qp.contacts).zip(&structure.block)
        {
            row.place = [contact.i, contact.j].map(|k| structure.place[k as usize]);
            row.block = block;
        }
    }

    /// Makes passes with the present factor until the solution is exact; returns whether it is.
    /// At least [`MIN_BULK`] and fewer than `bulk_limit` contacts may change sides at once, which
    /// lowers `bulk_limit`.
    #[inline(always)]
    fn converge(&mut self, qp: &Qp, bulk_limit: &mut usize, solution: &mut Solution) -> bool {
        let mut before = f64::INFINITY;
        for pass in 0..MAX_PASSES {
            let open = self.displace();
            if MIN_GAIN * open > before {
                self.extrapolate(open / (before - open));
                return solution.residual <= TARGET;
            }
            before = open;
            let wrong = self.pass();
            if wrong > 0 {
                if pass == 0 && (MIN_BULK..*bulk_limit).contains(&wrong) {
                    *bulk_limit = wrong / BULK_REDUCTION;
                    self.exchange_wrong();
                    return false;
                }
                let (rows, factor) = (&mut self.rows, &self.factor);
                if !self.closure.close(rows, factor, &mut self.change) {
                    return false;
                }
                // Exact up to the rounding errors of the tableau, which another pass removes.
                before = f64::INFINITY;
            } else {
                for row in &mut self.rows {
                    std::mem::swap(&mut row.multiplier, &mut row.proposed);
                }
            }
            solution.offer(qp, self.rows.iter().map(|row| row.multiplier));
            if solution.residual <= DONE {
                return true;
            }
        }
        false
    }

    /// Applies the last pass, and exchanges all contacts on the wrong side.
    fn exchange_wrong(&mut self) {
        for row in &mut self.rows {
            row.pushing = row.active != (row.followed < -WRONG);
            row.multiplier = if row.active {
                not_negative(row.proposed)
            } else {
                0.0
            };
        }
    }

    /// Replaces negative multipliers by 0.
    fn cut_off(&mut self) {
        for row in &mut self.rows {
            row.multiplier = not_negative(row.multiplier);
        }
    }

    /// Extends the multipliers along the last pass by `far` times its change, or up to the first
    /// that would become negative; that contact leaves the active set.
    ///
    /// If contacts nearly depend on each other, passes make no progress: each shifts the
    /// multipliers by as much as the penalty allows, along a line that ends where one of them
    /// becomes 0.
    fn extrapolate(&mut self, far: f64) {
        let mut share = if far > 0.0 { far } else { f64::INFINITY };
        let mut blocking = None;
        for (k, row) in self.rows.iter().enumerate() {
            let (now, before) = (row.multiplier, row.proposed);
            if row.pushing && now < before && now < share * (before - now) {
                share = now / (before - now);
                blocking = Some(k);
            }
        }
        if share < f64::INFINITY {
            for row in &mut self.rows {
                row.multiplier += share * (row.multiplier - row.proposed);
            }
        }
        if let Some(k) = blocking {
            self.rows[k].pushing = false;
            self.rows[k].multiplier = 0.0;
        }
        self.cut_off();
    }

    /// Computes `w` and all slacks from the multipliers; returns the largest open gap of the active
    /// set.
    #[inline(always)]
    fn displace(&mut self) -> f64 {
        clear(&mut self.change, self.factor.structure.place.len());
        for row in &self.rows {
            if row.multiplier != 0.0 {
                row.add(row.multiplier, &mut self.change);
            }
        }
        let mut open = 0.0;
        for row in &mut self.rows {
            row.slack = row.slack_at(&self.change);
            let size = row.slack.abs();
            if row.pushing && size > open {
                open = size;
            }
        }
        open
    }

    /// One pass over the active set: `K δ = -Σ σ_k s_k b_k`, then `λ_k -= σ_k (s_k + b_k·δ)`.
    /// Returns the number of contacts that would pull or overlap.
    #[inline(always)]
    fn pass(&mut self) -> usize {
        clear(&mut self.change, self.factor.structure.place.len());
        for row in &mut self.rows {
            if row.active && row.pushing {
                row.add(-row.penalty * row.slack, &mut self.change);
            }
            row.proposed = row.multiplier;
        }
        self.factor.solve(&mut self.change);
        self.closure.correct(
            &mut self.rows,
            &self.factor,
            &mut self.change,
            &mut self.extra,
        );
        let mut wrong = 0;
        for row in &mut self.rows {
            row.ahead = row.slack + row.along(&self.change);
            if row.active && row.pushing {
                row.proposed -= row.penalty * row.ahead;
            }
            row.followed = if row.pushing { row.proposed } else { row.ahead };
            wrong += usize::from(row.followed < -WRONG);
        }
        wrong
    }
}

/// Sets `vector` to `length` zeros.
#[inline(always)]
fn clear(vector: &mut Vec<Part>, length: usize) {
    vector.clear();
    vector.resize(length, [0.0; 4]);
}

#[inline(always)]
fn not_negative(value: f64) -> f64 {
    if value > 0.0 { value } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stepper::contact::Contact;

    /// A solver with rows of the multipliers `(now, before)`, all of which push.
    fn after_a_pass(multipliers: &[(f64, f64)]) -> Exact {
        let qp = Qp {
            weights: [1.0; 3],
            free: vec![[0.0; 3]; 2],
            contacts: vec![Contact::in_row(0, 0.0); multipliers.len()],
        };
        let mut exact = Exact::default();
        rows::fill(&qp, &mut exact.rows);
        for (row, &(now, before)) in exact.rows.iter_mut().zip(multipliers) {
            (row.multiplier, row.proposed, row.pushing) = (now, before, true);
        }
        exact
    }

    fn result(exact: &Exact) -> Vec<(f64, bool)> {
        let rows = exact.rows.iter();
        rows.map(|row| (row.multiplier, row.pushing)).collect()
    }

    #[test]
    fn an_extrapolation_ends_at_the_first_multiplier_that_becomes_zero() {
        // The first reaches 0 after one more change of 1, the second after three.
        let multipliers = [(1.0, 2.0), (3.0, 4.0), (2.0, 1.5), (0.5, 0.5)];
        let mut exact = after_a_pass(&multipliers);
        exact.extrapolate(0.0);
        let expected = [(0.0, false), (2.0, true), (2.5, true), (0.5, true)];
        assert_eq!(result(&exact), expected);

        let mut exact = after_a_pass(&multipliers);
        exact.extrapolate(0.5);
        let expected = [(0.5, true), (2.5, true), (2.25, true), (0.5, true)];
        assert_eq!(result(&exact), expected);

        // A contact that does not push neither ends it nor becomes negative.
        let mut exact = after_a_pass(&multipliers);
        exact.rows[0].pushing = false;
        exact.extrapolate(2.0);
        let expected = [(0.0, false), (1.0, true), (3.0, true), (0.5, true)];
        assert_eq!(result(&exact), expected);

        // If none falls, none blocks, and without a distance nothing moves.
        let mut exact = after_a_pass(&[(2.0, 1.0), (1.0, 1.0)]);
        exact.extrapolate(0.0);
        assert_eq!(result(&exact), [(2.0, true), (1.0, true)]);
        exact.extrapolate(1.0);
        assert_eq!(result(&exact), [(3.0, true), (1.0, true)]);
    }
}
