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
mod structure;
mod tableau;

use super::{Hints, Solution, TARGET};
use crate::stepper::qp::Qp;
use closure::{Base, Closure};
use factor::Factor;
use order::Dissection;
use rows::{Part, Row};

/// σ, the penalty on a gap whose gradient has unit length in the metric of `W`. Each pass
/// shrinks the error by σ times the least eigenvalue of `A W⁻¹ Aᵀ`; beyond 1e8 rounding in `K`
/// takes over.
const PENALTY: f64 = 1e8;

/// A gap or multiplier this far on the wrong side is wrong: well below the target, so that what
/// stays is no part of the residual.
const WRONG: f64 = 0.05 * TARGET;

/// A solution this exact is done.
const DONE: f64 = 0.1 * TARGET;

/// Passes with one factor. Each gains several digits or the set was wrong.
const MOST_PASSES: usize = 6;

/// A pass that gains less than this is not worth another.
const GAIN: f64 = 3.0;

/// Factorisations before giving up; one is usual.
const MOST_FACTORS: usize = 12;

/// An order of elimination serves so many steps: those in contact change slowly, and any order
/// is right.
const ORDER_LASTS: u32 = 25;

/// The solver's memory within a step.
#[derive(Clone, Debug, Default)]
pub struct Exact {
    dissection: Dissection,
    /// An order found in this step.
    order: Vec<u32>,
    age: u32,
    rows: Vec<Row>,
    factor: Factor,
    closure: Closure,
    /// Who was taken to push when `K` was factored.
    active: Vec<bool>,
    /// Who is taken to push now.
    pushing: Vec<bool>,
    multipliers: Vec<f64>,
    proposed: Vec<f64>,
    slacks: Vec<f64>,
    ahead: Vec<f64>,
    vector: Vec<Part>,
    change: Vec<Part>,
    extra: Vec<Part>,
}

impl Exact {
    /// The order of elimination to be remembered, with how many solutions it has served.
    #[must_use]
    pub fn order(&self) -> (&[u32], u32) {
        (&self.order, self.age)
    }

    /// Takes over the order of elimination that a step before has found.
    pub(super) fn recall(&mut self, hints: &Hints) {
        if self.order != hints.order {
            self.order.clear();
            self.order.extend_from_slice(hints.order);
        }
        self.age = hints.order_age;
    }

    /// Solves `qp`; the best solution found is offered to `solution`.
    pub(super) fn solve(&mut self, qp: &Qp, hints: &Hints, solution: &mut Solution) {
        self.prepare(qp, hints);
        for _ in 0..MOST_FACTORS {
            self.factor.factor(&self.rows, &self.active);
            solution.iterations += 1;
            self.closure.clear();
            self.pushing.clone_from(&self.active);
            if self.converge(qp, solution) {
                return;
            }
            self.active.clone_from(&self.pushing);
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
        let structure = &mut self.factor.structure;
        structure.update(&self.order, &qp.contacts);
        rows::fill(qp, &mut self.rows);
        for ((row, contact), &block) in self.rows.iter_mut().zip(&qp.contacts).zip(&structure.block)
        {
            row.place = [contact.i, contact.j].map(|k| structure.place[k as usize]);
            row.block = block;
        }
        self.multipliers.clear();
        self.multipliers.extend_from_slice(hints.multipliers);
        self.active.clear();
        self.active
            .extend(self.multipliers.iter().map(|&value| value > 0.0));
        if !self.active.contains(&true) {
            // Nothing is known: those that free motion would let overlap.
            self.active.clear();
            self.active.extend(self.rows.iter().map(|row| row.gap < 0.0));
        }
    }

    /// Passes with the present factor until the solution is exact; tells whether it is.
    fn converge(&mut self, qp: &Qp, solution: &mut Solution) -> bool {
        let mut before = f64::INFINITY;
        for pass in 0..MOST_PASSES {
            let open = self.displace();
            if GAIN * open > before {
                return false;
            }
            before = open;
            self.pass();
            if pass == 0 && self.anybody_wrong() {
                let base = Base {
                    rows: &self.rows,
                    active: &self.active,
                    before: &self.multipliers,
                    multipliers: &self.proposed,
                    slacks: &self.ahead,
                };
                let (mut multipliers, mut slacks) = (self.proposed.clone(), self.ahead.clone());
                let closed = self.closure.close(
                    &base,
                    &mut self.factor,
                    &mut self.change,
                    &mut multipliers,
                    &mut slacks,
                );
                for (k, value) in multipliers.iter().enumerate() {
                    self.pushing[k] = self.active[k] != self.closure.is_exchanged(k);
                    self.multipliers[k] = if self.pushing[k] { value.max(0.0) } else { 0.0 };
                }
                if !closed {
                    return false;
                }
                before = f64::INFINITY;
            } else {
                std::mem::swap(&mut self.multipliers, &mut self.proposed);
            }
            solution.offer(qp, &self.multipliers);
            if solution.residual <= DONE {
                return true;
            }
        }
        false
    }

    /// Computes `w` from the multipliers, and all gaps; returns the largest gap left open.
    fn displace(&mut self) -> f64 {
        self.vector.clear();
        self.vector
            .resize(self.factor.structure.columns, [0.0; 4]);
        for (row, &multiplier) in self.rows.iter().zip(&self.multipliers) {
            if multiplier != 0.0 {
                row.add(multiplier, &mut self.vector);
            }
        }
        self.slacks.clear();
        let mut open = 0.0;
        for (row, &pushing) in self.rows.iter().zip(&self.pushing) {
            let slack = row.slack(&self.vector);
            self.slacks.push(slack);
            if pushing {
                open = f64::max(open, slack.abs());
            }
        }
        open
    }

    /// One pass: `K δ = -Σ σ_k s_k b_k`, then `λ_k -= σ_k (s_k + b_k·δ)`, over those that push.
    fn pass(&mut self) {
        self.change.clear();
        self.change
            .resize(self.factor.structure.columns, [0.0; 4]);
        for (k, row) in self.rows.iter().enumerate() {
            if self.active[k] && self.pushing[k] {
                row.add(-row.penalty * self.slacks[k], &mut self.change);
            }
        }
        self.factor.solve(&mut self.change);
        self.proposed.clone_from(&self.multipliers);
        self.closure.correct(
            &self.active,
            &self.rows,
            &self.slacks,
            &self.factor,
            &mut self.change,
            &mut self.extra,
            &mut self.proposed,
        );
        self.ahead.clear();
        for (k, row) in self.rows.iter().enumerate() {
            let ahead = self.slacks[k] + row.along(&self.change);
            self.ahead.push(ahead);
            if self.active[k] && self.pushing[k] {
                self.proposed[k] -= row.penalty * ahead;
            }
        }
    }

    /// Whether the last pass would have anybody pull or overlap.
    fn anybody_wrong(&self) -> bool {
        (0..self.rows.len()).any(|k| {
            if self.active[k] {
                self.proposed[k] < -WRONG
            } else {
                self.ahead[k] < -WRONG
            }
        })
    }
}
