//! The exact solver: one factorisation, and the few contacts that change sides resolved jointly.
//!
//! From one step to the next a handful of contacts change sides, so those that pushed are taken
//! for those that push (`rows`, `order`, `structure`, `factor`). One pass by multipliers with a
//! penalty closes their gaps; whoever then pulls or overlaps is in doubt and is resolved in a
//! small dense complementarity problem (`closure`, `tableau`). Passes with the same factor refine.
//! Nothing here judges the result: the residual does, computed from the multipliers alone.

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

/// σ, the penalty on a gap whose gradient has unit length in the metric of `W`. Each pass
/// shrinks the error by σ times the least eigenvalue of `A W⁻¹ Aᵀ`; beyond 1e8 rounding in `K`
/// takes over.
const PENALTY: f64 = 1e8;

/// A gap or multiplier this far on the wrong side is wrong: well below the target, so that what
/// stays is no part of the residual.
const WRONG: f64 = 0.05 * TARGET;

/// A solution this exact is done: well within the target, yet mostly reached by one pass.
const DONE: f64 = 0.25 * TARGET;

/// Passes with one factor. Each gains several digits or the set was wrong.
const MOST_PASSES: usize = 6;

/// A pass that gains less than this is not worth another.
const GAIN: f64 = 3.0;

/// With more on the wrong side than this all of them change sides at once, and `K` is factored
/// anew: more than this are not resolved jointly, and where a group is so large that they are so
/// many, most are far from each other and settle alone.
const MANY: usize = 1000;

/// Where that has left more than one in so many of them wrong they are not far from each other,
/// and the next are resolved jointly, however many they are.
const LEFT: usize = 2;

/// Factorisations before giving up; one is usual, two in a large group.
const MOST_FACTORS: usize = 12;

/// An order of elimination serves so many steps: those in contact change slowly, and any order
/// is right.
const ORDER_LASTS: u32 = 50;

/// The solver's memory within a step.
#[derive(Clone, Debug, Default)]
pub struct Exact {
    /// Which version of the kernels runs; it changes no bit.
    pub level: Level,
    dissection: Dissection,
    /// An order found in this step.
    order: Vec<u32>,
    age: u32,
    rows: Vec<Row>,
    factor: Factor,
    closure: Closure,
    small: Small,
    /// `w`, then the change of a pass, then that of the closure.
    change: Vec<Part>,
    extra: Vec<Part>,
}

multiversion! {
    /// Solves for few contacts, with everything that it calls compiled for one level.
    fn few(level, exact: &mut Exact, qp: &Qp, guess: &[f64], solution: &mut Solution) -> bool {
        exact.small.solve(qp, &exact.rows, guess, solution)
    }
}

multiversion! {
    /// Solves with everything that it calls compiled for one level.
    fn attempt(level, exact: &mut Exact, qp: &Qp, solution: &mut Solution) {
        exact.attempt(qp, solution);
    }
}

impl Exact {
    /// The order of elimination to be remembered, with how many solutions it has served.
    #[must_use]
    pub fn order(&self) -> (&[u32], u32) {
        (&self.order, self.age)
    }

    /// Takes over the order of elimination that a step before has found, with how many solutions
    /// it has served. One of another length than n is none.
    pub fn recall(&mut self, order: &[u32], age: u32) {
        if self.order != order {
            self.order.clear();
            self.order.extend_from_slice(order);
        }
        self.age = age;
    }

    /// Solves `qp`; the best solution found is offered to `solution`.
    pub(super) fn solve(&mut self, qp: &Qp, hints: &Hints, solution: &mut Solution) {
        rows::fill(qp, &mut self.rows);
        let pushed = hints.multipliers.iter().filter(|&&value| value > 0.0);
        if (1..=small::FEW).contains(&pushed.count())
            && few(self.level, self, qp, hints.multipliers, solution)
        {
            return;
        }
        self.prepare(qp, hints);
        attempt(self.level, self, qp, solution);
    }

    #[inline(always)]
    fn attempt(&mut self, qp: &Qp, solution: &mut Solution) {
        let mut most = usize::MAX;
        for _ in 0..MOST_FACTORS {
            self.arrange(qp);
            self.factor.factor(&self.rows);
            solution.iterations += 1;
            self.closure.clear();
            if self.converge(qp, &mut most, solution) {
                return;
            }
            for row in &mut self.rows {
                row.active = row.pushing;
            }
        }
    }

    fn prepare(&mut self, qp: &Qp, hints: &Hints) {
        let n = qp.free.len();
        if self.order.len() != n || self.age >= ORDER_LASTS {
            self.dissection
                .order(&qp.contacts, hints.x, hints.y, &mut self.order);
            self.age = 0;
        }
        self.age += 1;
        let mut anybody = false;
        for (row, &multiplier) in self.rows.iter_mut().zip(hints.multipliers) {
            row.multiplier = multiplier;
            row.active = multiplier > 0.0;
            anybody |= row.active;
        }
        for row in &mut self.rows {
            // Where nothing is known, those that free motion would let overlap.
            row.active |= !anybody && row.gap < 0.0;
            row.pushing = row.active;
        }
    }

    /// Gives everybody a place and every contact a block, by who pushes.
    fn arrange(&mut self, qp: &Qp) {
        let structure = &mut self.factor.structure;
        structure.update(&self.order, &qp.contacts, &self.rows);
        for ((row, contact), &block) in self.rows.iter_mut().zip(&qp.contacts).zip(&structure.block)
        {
            row.place = [contact.i, contact.j].map(|k| structure.place[k as usize]);
            row.block = block;
        }
    }

    /// Passes with the present factor until the solution is exact; tells whether it is. Fewer
    /// than `most` may change sides at once, and then `most` falls.
    #[inline(always)]
    fn converge(&mut self, qp: &Qp, most: &mut usize, solution: &mut Solution) -> bool {
        let mut before = f64::INFINITY;
        for pass in 0..MOST_PASSES {
            let open = self.displace();
            if GAIN * open > before {
                self.reach_ahead(open / (before - open));
                return solution.residual <= TARGET;
            }
            before = open;
            let wrong = self.pass();
            if wrong > 0 {
                if pass == 0 && (MANY..*most).contains(&wrong) {
                    *most = wrong / LEFT;
                    self.exchange_wrong();
                    return false;
                }
                let (rows, factor) = (&mut self.rows, &self.factor);
                if !self.closure.close(rows, factor, &mut self.change) {
                    return false;
                }
                // Exact up to the rounding of a small tableau, which another pass takes away.
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

    /// Takes the last pass, and has all who are wrong change sides.
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

    /// Leaves no multiplier negative.
    fn cut_off(&mut self) {
        for row in &mut self.rows {
            row.multiplier = not_negative(row.multiplier);
        }
    }

    /// Goes on as the last pass went, `far` times as far or until the first would pull, which
    /// then pushes no more.
    ///
    /// Where contacts nearly depend on each other, passes gain nothing: each shifts the load by
    /// as much as the penalty allows, along a line that ends where somebody lets go.
    fn reach_ahead(&mut self, far: f64) {
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

    /// Computes `w` from the multipliers, and all gaps; returns the largest gap left open.
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

    /// One pass: `K δ = -Σ σ_k s_k b_k`, then `λ_k -= σ_k (s_k + b_k·δ)`, over those that push.
    /// Tells how many would pull or overlap.
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

/// A vector of zeros.
#[inline(always)]
fn clear(vector: &mut Vec<Part>, length: usize) {
    vector.clear();
    vector.resize(length, [0.0; 4]);
}

#[inline(always)]
fn not_negative(value: f64) -> f64 {
    if value > 0.0 { value } else { 0.0 }
}
