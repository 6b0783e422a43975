//! The slow and sure way from rough multipliers to exact ones.
//!
//! One contact changes sides at a time, and never so that the dual objective grows: towards the
//! multipliers that close the active gaps, up to where the first would pull; that one is
//! dropped. Once none pulls, the worst overlap is added. This is the active set method of
//! Lawson and Hanson on the dual. It cannot wander, but needs a system for every change, so it
//! only finishes what the other routes left nearly done.

use super::polish::{WRONG, Workspace};
use crate::stepper::qp::Qp;

/// Systems to factor at most. Interior point multipliers are wrong in a handful of contacts, two
/// systems each.
const MOST_ROUNDS: usize = 60;

impl Workspace {
    /// Descends from multipliers that are not negative, and returns how many systems that took.
    /// The multipliers are left in the workspace, whether exact or not.
    pub fn descend(&mut self, qp: &Qp, start: &[f64]) -> usize {
        self.normalise(qp);
        let mut reached = start.to_vec();
        let mut active: Vec<bool> = start.iter().map(|&value| value > 0.0).collect();
        self.multipliers.clone_from(&reached);
        for round in 1..=MOST_ROUNDS {
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
        MOST_ROUNDS
    }

    /// Moves `reached` towards the workspace's multipliers until one would pull, drops that one,
    /// and tells whether the way was free.
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
