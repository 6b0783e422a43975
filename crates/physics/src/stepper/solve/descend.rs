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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stepper::contact::Contact;

    #[test]
    fn an_advance_stops_where_the_first_active_multiplier_becomes_zero() {
        let target = [-1.0, 2.0, -3.0, -0.5];
        let mut workspace = Workspace::default();
        workspace.multipliers = target.to_vec();
        // The first reaches 0 at half of the way and the third at a quarter; the last is inactive.
        let mut reached = [1.0, 1.0, 1.0, 0.0];
        let mut active = [true, true, true, false];
        assert!(!workspace.advance(&mut reached, &mut active));
        assert_eq!(reached, [0.5, 1.25, 0.0, 0.0]);
        assert_eq!(active, [true, true, false, false]);

        assert!(!workspace.advance(&mut reached, &mut active));
        assert_eq!(active, [false, true, false, false]);
        assert_eq!(reached[0], 0.0);
        assert!((reached[1] - 1.5).abs() < 1e-15);

        assert!(workspace.advance(&mut reached, &mut active));
        assert_eq!(reached, [0.0, 2.0, 0.0, 0.0]);
    }

    #[test]
    fn a_contact_that_only_touches_does_not_join() {
        // The first disc pushes the second by half of its way, up to the third.
        let qp = Qp {
            weights: [1.0, 1.0, 0.1],
            free: vec![[0.02, 0.0, 0.0], [0.0; 3], [0.0; 3]],
            contacts: vec![Contact::in_row(0, 0.0), Contact::in_row(1, 0.01)],
        };
        let mut workspace = Workspace::default();
        assert_eq!(workspace.descend(&qp, &[0.01, 0.0]), 1);
        assert!((workspace.multipliers()[0] - 0.01).abs() < 1e-12);
        assert_eq!(workspace.multipliers()[1], 0.0);
        // From zero, the first contact joins; its push makes the second overlap, which joins in the
        // next round.
        let qp = Qp {
            contacts: vec![Contact::in_row(0, 0.0), Contact::in_row(1, 0.001)],
            ..qp
        };
        assert_eq!(workspace.descend(&qp, &[0.0, 0.0]), 3);
        // d = (0.02 - a, a - b, b), d_1 = d_0 and d_2 = d_1 - 0.001.
        for (found, expected) in workspace.multipliers().iter().zip([0.013, 0.006]) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
    }
}
