//! The program of one step as plain data, and how good a solution of it is.
//!
//! | symbol | field |
//! |---|---|
//! | `W` | `weights`, the diagonal block (ρ1, ρ1, ρ2) of every individual |
//! | `u` | `free` |
//! | `g_k`, `∇g_k` | `contacts[k]`: `gap`; `normal` and `lever` |
//! | `λ` | `multipliers` |
//! | `d` | `displacement` |
//! | `s_k` | `contacts[k].linearised_gap(displacement)` |
//!
//! Minimise `½ (d - u)ᵀ W (d - u)` subject to `g_k + ∇g_k·d ≥ 0`: the paper's Principle 1,
//! eq. (7). At the solution `d = u + W⁻¹ Aᵀ λ` with `λ ≥ 0`, `s ≥ 0` and `λ·s = 0`.

use super::contact::Contact;

/// The program of one step.
#[derive(Clone, Debug, Default)]
pub struct Qp {
    /// Drag in x, y and angle.
    pub weights: [f64; 3],
    /// Free displacements.
    pub free: Vec<[f64; 3]>,
    /// Constraints, ordered by (i, j, code).
    pub contacts: Vec<Contact>,
}

impl Qp {
    /// Computes `d = u + W⁻¹ Aᵀ λ`. Whom nothing pushes moves freely, to the bit.
    pub fn displace(&self, multipliers: &[f64], displacement: &mut Vec<[f64; 3]>) {
        displacement.clone_from(&self.free);
        let ease = self.weights.map(|drag| 1.0 / drag);
        for (contact, &multiplier) in self.contacts.iter().zip(multipliers) {
            if multiplier != 0.0 {
                push(contact, multiplier, ease, displacement);
            }
        }
    }

    /// Computes `max |min(λ, s)|` and the displacements that `λ` gives, so that stationarity
    /// holds exactly and the number says everything about the solution.
    pub fn residual(&self, multipliers: &[f64], displacement: &mut Vec<[f64; 3]>) -> f64 {
        self.displace(multipliers, displacement);
        let mut worst = 0.0;
        for (contact, &multiplier) in self.contacts.iter().zip(multipliers) {
            let slack = contact.linearised_gap(displacement);
            // `min` and `max` would drop what is not a number.
            if slack.is_nan() || multiplier.is_nan() {
                return f64::INFINITY;
            }
            worst = f64::max(worst, multiplier.min(slack).abs());
        }
        worst
    }
}

/// Adds `W⁻¹ ∇g λ` of one contact; what one side gains the other loses. `ease` is `W⁻¹`.
#[inline(always)]
fn push(contact: &Contact, multiplier: f64, ease: [f64; 3], displacement: &mut [[f64; 3]]) {
    let [x, y] = contact.normal;
    let (force_x, force_y) = (multiplier * x * ease[0], multiplier * y * ease[1]);
    let [turn_i, turn_j] = contact.lever.map(|lever| multiplier * lever * ease[2]);
    let first = &mut displacement[contact.i as usize];
    *first = [first[0] - force_x, first[1] - force_y, first[2] - turn_i];
    let second = &mut displacement[contact.j as usize];
    *second = [second[0] + force_x, second[1] + force_y, second[2] + turn_j];
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two discs in line, the first driven at the second, which stands: both get half.
    fn shove() -> Qp {
        let contact = Contact {
            i: 0,
            j: 1,
            code: 0,
            gap: 0.1,
            normal: [1.0, 0.0],
            lever: [0.0, 0.0],
        };
        let free = vec![[0.5, 0.0, 0.0], [0.0, 0.0, 0.0]];
        Qp {
            weights: [1.0, 1.0, 0.1],
            free,
            contacts: vec![contact],
        }
    }

    #[test]
    fn one_contact_is_solved_by_hand() {
        let mut displacement = Vec::new();
        // Free motion closes 0.5 of a gap of 0.1; each unit of multiplier opens 2.
        assert!(shove().residual(&[0.2], &mut displacement) < 1e-16);
        assert!(
            (displacement[0][0] - 0.3).abs() < 1e-16 && (displacement[1][0] - 0.2).abs() < 1e-16
        );
    }

    #[test]
    fn every_kind_of_wrong_multiplier_shows_in_the_residual() {
        let qp = shove();
        let residual = |multiplier: f64| qp.residual(&[multiplier], &mut Vec::new());
        assert!((residual(0.0) - 0.4).abs() < 1e-15, "penetration");
        assert!(
            (residual(0.25) - 0.1).abs() < 1e-15,
            "pushing at a distance"
        );
        assert!((residual(-0.1) - 0.6).abs() < 1e-15, "pulling");
        assert_eq!(residual(f64::NAN), f64::INFINITY);
        assert_eq!(residual(f64::INFINITY), f64::INFINITY);
    }

    #[test]
    fn levers_turn_by_the_rotational_drag() {
        let contact = Contact {
            i: 0,
            j: 1,
            code: 2,
            gap: 0.0,
            normal: [0.0, 1.0],
            lever: [0.3, -0.6],
        };
        let qp = Qp {
            weights: [1.0, 1.0, 0.1],
            free: vec![[0.0; 3]; 2],
            contacts: vec![contact],
        };
        let mut displacement = Vec::new();
        qp.displace(&[0.5], &mut displacement);
        for (moved, expected) in displacement
            .iter()
            .zip([[0.0, -0.5, -1.5], [0.0, 0.5, -3.0]])
        {
            assert!((0..3).all(|axis| (moved[axis] - expected[axis]).abs() < 1e-15));
        }
        // The gap opens by λ (1 + 1 + (0.09 + 0.36) / ρ2).
        assert!((contact.closing(&displacement) - 0.5 * 6.5).abs() < 1e-15);
    }
}
