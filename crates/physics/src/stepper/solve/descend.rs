//! The last method of the fallback, from approximate multipliers to exact ones: slow, and without
//! cycles.
//!
//! This is the active-set method of Lawson and Hanson on the dual. One contact changes sides at a
//! time, and the dual objective never grows. The multipliers move towards those that close the
//! active gaps, up to the first that would become negative; that contact leaves the active set.
//! If none becomes negative, the contact with the deepest overlap joins. The method cannot cycle,
//! but factors a system for every change, so it serves only to finish a solution in which few
//! contacts are wrong.

use super::polish::{WRONG, Workspace};
use crate::stepper::qp::Qp;

/// Maximum number of rounds, each with at most one factorisation. Interior-point multipliers are
/// wrong in a few contacts, and each takes about two rounds.
const MAX_ROUNDS: usize = 60;

impl Workspace {
    /// Descends from non-negative multipliers and returns the number of rounds.
    /// [`Workspace::multipliers`] has the result, which may be inexact.
    ///
    /// - Shapes: m multipliers in `start`.
    pub fn descend(&mut self, qp: &Qp, start: &[f64]) -> usize {
        self.normalise(qp);
        let mut reached = start.to_vec();
        let mut active: Vec<bool> = start.iter().map(|&value| value > 0.0).collect();
        self.multipliers.clone_from(&reached);
        for round in 1..=MAX_ROUNDS {
            if active.contains(&true) {
                self.factor(qp, &active);
            }
            self.close(qp, &active);
            if self.advance(&mut reached, &mut active) {
                let overlap = |k: &usize| qp.contacts[*k].linearised_gap(&self.displacement);
                let worst = (0..active.len())
                    .filter(|&k| !active[k])
                    .min_by(|a, b| overlap(a).total_cmp(&overlap(b)).then(a.cmp(b)));
                match worst {
                    Some(k) if overlap(&k) < -WRONG => active[k] = true,
                    _ => return round,
                }
            }
            self.multipliers.clone_from(&reached);
        }
        MAX_ROUNDS
    }

    /// Moves `reached` towards the workspace's multipliers until the first would become negative.
    /// That contact leaves the active set. Returns whether no contact did.
    fn advance(&self, reached: &mut [f64], active: &mut [bool]) -> bool {
        let mut share = 1.0;
        let mut blocking = None;
        for k in 0..reached.len() {
            let (from, to) = (reached[k], self.multipliers[k]);
            if active[k] && to < 0.0 && from / (from - to) < share {
                share = from / (from - to);
                blocking = Some(k);
            }
        }
        for (value, target) in reached.iter_mut().zip(&self.multipliers) {
            *value = f64::max(0.0, *value + share * (target - *value));
        }
        if let Some(k) = blocking {
            reached[k] = 0.0;
            active[k] = false;
        }
        blocking.is_none()
    }
}
