//! The quadratic program of one step as plain data, and the residual of a solution.
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

/// The quadratic program of one step.
///
/// - Shapes: n free displacements, m contacts.
#[derive(Clone, Debug, Default)]
pub struct Qp {
    /// Diagonal of `W` for one individual: drag in x, y and angle.
    pub weights: [f64; 3],
    /// `u`: free displacements in x, y and angle.
    pub free: Vec<[f64; 3]>,
    /// Constraints, ordered by (i, j, code).
    pub contacts: Vec<Contact>,
}

impl Qp {
    /// Computes `d = u + W⁻¹ Aᵀ λ`. The displacement of an individual without a pushing contact
    /// equals its free displacement to the bit.
    ///
    /// - Shapes: m multipliers; n displacements.
    pub fn displace(&self, multipliers: &[f64], displacement: &mut Vec<[f64; 3]>) {
        displacement.clone_from(&self.free);
        let mobility = self.weights.map(|drag| 1.0 / drag);
        for (contact, &multiplier) in self.contacts.iter().zip(multipliers) {
            if multiplier != 0.0 {
                push(contact, multiplier, mobility, displacement);
            }
        }
    }

    /// Computes the displacements from `λ` and returns the residual `max |min(λ, s)|`, or infinity
    /// if a multiplier or slack is not a number. Stationarity then holds by construction, so the
    /// residual covers all optimality conditions.
    ///
    /// - Shapes: m multipliers; n displacements.
    pub fn residual(&self, multipliers: &[f64], displacement: &mut Vec<[f64; 3]>) -> f64 {
        self.displace(multipliers, displacement);
        let mut worst = 0.0;
        for (contact, &multiplier) in self.contacts.iter().zip(multipliers) {
            let slack = contact.linearised_gap(displacement);
            // `min` and `max` would ignore a value that is not a number.
            if slack.is_nan() || multiplier.is_nan() {
                return f64::INFINITY;
            }
            worst = f64::max(worst, multiplier.min(slack).abs());
        }
        worst
    }
}

/// Adds `W⁻¹ ∇g λ` of one contact. The forces on the two bodies are opposite. `mobility` is `W⁻¹`.
#[inline(always)]
fn push(contact: &Contact, multiplier: f64, mobility: [f64; 3], displacement: &mut [[f64; 3]]) {
    let [x, y] = contact.normal;
    let (force_x, force_y) = (multiplier * x * mobility[0], multiplier * y * mobility[1]);
    let [turn_i, turn_j] = contact.lever.map(|lever| multiplier * lever * mobility[2]);
    let first = &mut displacement[contact.i as usize];
    *first = [first[0] - force_x, first[1] - force_y, first[2] - turn_i];
    let second = &mut displacement[contact.j as usize];
    *second = [second[0] + force_x, second[1] + force_y, second[2] + turn_j];
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two discs in line: the first moves towards the second, which stands; each yields half.
    fn two_discs() -> Qp {
        let free = vec![[0.5, 0.0, 0.0], [0.0, 0.0, 0.0]];
        Qp {
            weights: [1.0, 1.0, 0.1],
            free,
            contacts: vec![Contact::in_row(0, 0.1)],
        }
    }

    #[test]
    fn the_solution_of_one_contact_has_no_residual() {
        let mut displacement = Vec::new();
        // Free motion closes 0.5 of a gap of 0.1; each unit of multiplier opens 2.
        assert!(two_discs().residual(&[0.2], &mut displacement) < 1e-16);
        assert!(
            (displacement[0][0] - 0.3).abs() < 1e-16 && (displacement[1][0] - 0.2).abs() < 1e-16
        );
    }

    #[test]
    fn every_kind_of_wrong_multiplier_raises_the_residual() {
        let qp = two_discs();
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
        assert!((contact.gap_change(&displacement) - 0.5 * 6.5).abs() < 1e-15);
    }
}
