//! Solution of the program of one step to the accuracy [`TARGET`].
//!
//! The exact solver (`exact`) starts from the contacts that pushed in the last step and resolves
//! the few that change sides. If it fails, the fallback runs; tests also run it alone, as an
//! independent solver. In the fallback, Clarabel finds the active set. `polish` exchanges the few
//! contacts that are wrong; if that does not converge, `descend` changes one contact at a time.
//! No solver's status is used: a solution is checked by its residual, computed from the multipliers
//! alone.

mod clarabel;
mod descend;
mod envelope;
mod exact;
mod polish;

use super::qp::Qp;
pub use exact::Exact;
use polish::Workspace as Polish;

/// Target residual of a step, in body sizes: far below the `dt²` of linearisation, far above
/// rounding.
pub const TARGET: f64 = 1e-9;

/// Largest residual with which a step is taken, in body sizes.
pub const ACCEPTABLE: f64 = 1e-6;

/// Factors of the right-hand side in Clarabel's program, tried in turn. Gaps and multipliers are of
/// the order of `dt`, whereas Clarabel's tolerances are meant for numbers of order one. If Clarabel
/// makes no progress with one scale, it may with another.
const SCALES: [f64; 2] = [1e3, 1e4];

/// Selects the solver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Backend {
    /// The exact solver, and the fallback if it fails.
    #[default]
    Exact,
    /// The fallback alone: slow. Of the hints it uses only whether any multiplier is positive.
    Fallback,
}

/// Input from the last step.
#[derive(Clone, Copy, Debug)]
pub struct Hints<'a> {
    /// A guess of the multipliers, one per contact.
    pub multipliers: &'a [f64],
    /// Coordinates of the n individuals, from which an elimination order is computed.
    pub x: &'a [f64],
    /// Coordinates of the n individuals.
    pub y: &'a [f64],
}

/// A solution of the program of one step.
#[derive(Clone, Debug, Default)]
pub struct Solution {
    /// λ, one per contact, never negative.
    pub multipliers: Vec<f64>,
    /// `d` of each individual, computed from λ.
    pub displacement: Vec<[f64; 3]>,
    /// `max |min(λ, s)|`.
    pub residual: f64,
    /// Number of linear systems factored, including one for each iteration of Clarabel.
    pub iterations: usize,
    /// Number of calls of Clarabel.
    pub fallback: usize,
    offered: Vec<f64>,
    moved: Vec<[f64; 3]>,
}

impl Solution {
    /// Resets the residual and the counters.
    fn clear(&mut self) {
        self.residual = f64::INFINITY;
        (self.iterations, self.fallback) = (0, 0);
    }

    /// Keeps `multipliers`, negative ones replaced by 0, if their residual is the least so far.
    ///
    /// - Shapes: m multipliers.
    fn offer(&mut self, qp: &Qp, multipliers: impl ExactSizeIterator<Item = f64>) {
        self.offered.clear();
        let cut = |value: f64| if value > 0.0 { value } else { 0.0 };
        self.offered.extend(multipliers.map(cut));
        let residual = qp.residual(&self.offered, &mut self.moved);
        if residual < self.residual {
            std::mem::swap(&mut self.multipliers, &mut self.offered);
            std::mem::swap(&mut self.displacement, &mut self.moved);
            self.residual = residual;
        }
    }
}

/// Buffers that solutions reuse, and the elimination order.
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    /// The exact solver with its buffers and elimination order.
    pub exact: Exact,
    polish: Polish,
}

/// Solves `qp` and stores the best solution found in `solution`. Its residual may exceed
/// [`TARGET`]; it is infinite if there is no solution.
///
/// - Shapes: n individuals and m contacts in `qp`; m multipliers and n coordinates in `hints`.
pub fn solve(
    backend: Backend,
    qp: &Qp,
    hints: &Hints,
    workspace: &mut Workspace,
    solution: &mut Solution,
) {
    solution.clear();
    if hints.multipliers.iter().all(|&value| value <= 0.0) {
        solution.offer(qp, hints.multipliers.iter().copied());
        if solution.residual <= TARGET {
            return;
        }
    }
    if backend == Backend::Exact {
        workspace.exact.solve(qp, hints, solution);
    }
    if solution.residual > TARGET {
        by_fallback(qp, &mut workspace.polish, solution);
    }
}

/// Solves by Clarabel, `polish` and `descend`, until the residual is at most [`TARGET`].
fn by_fallback(qp: &Qp, workspace: &mut Polish, solution: &mut Solution) {
    let mut displacement = Vec::new();
    for scale in SCALES {
        let Some((multipliers, iterations)) = clarabel::multipliers(qp, scale) else {
            continue;
        };
        solution.fallback += 1;
        solution.iterations += iterations;
        solution.offer(qp, multipliers.iter().copied());
        qp.displace(&multipliers, &mut displacement);
        let active = workspace.pushing(qp, &multipliers, &displacement);
        solution.iterations += workspace.polish(qp, &multipliers, active);
        solution.offer(qp, workspace.multipliers().iter().copied());
        if solution.residual > TARGET {
            let best = solution.multipliers.clone();
            solution.iterations += workspace.descend(qp, &best);
            solution.offer(qp, workspace.multipliers().iter().copied());
        }
        if solution.residual <= TARGET {
            return;
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::stepper::contact::Contact;

    /// `count` touching discs in a row: all move right by 0.02 but the last, which stands.
    fn row(count: u32) -> Qp {
        let mut free = vec![[0.02, 0.0, 0.0]; count as usize];
        free[count as usize - 1] = [0.0; 3];
        Qp {
            weights: [1.0, 1.0, 0.1],
            free,
            contacts: (0..count - 1).map(|i| Contact::in_row(i, 0.0)).collect(),
        }
    }

    fn solved(backend: Backend, qp: &Qp, guess: &[f64]) -> Solution {
        let x: Vec<f64> = (0..qp.free.len()).map(|k| k as f64).collect();
        let hints = Hints {
            multipliers: guess,
            x: &x,
            y: &vec![0.0; x.len()],
        };
        let mut solution = Solution::default();
        solve(
            backend,
            qp,
            &hints,
            &mut Workspace::default(),
            &mut solution,
        );
        solution
    }

    #[test]
    fn a_row_moves_together_with_either_backend() {
        let qp = row(9);
        // The error that the residual allows: the target over the least eigenvalue of `A W⁻¹ Aᵀ`.
        let tolerance = TARGET / (2.0 - 2.0 * libm::cos(std::f64::consts::PI / 9.0));
        for (backend, calls) in [(Backend::Exact, 0), (Backend::Fallback, 1)] {
            for guess in [[0.0; 8], [1.0; 8]] {
                let solution = solved(backend, &qp, &guess);
                assert!(solution.residual <= TARGET);
                for displacement in &solution.displacement {
                    assert!((displacement[0] - 0.02 * 8.0 / 9.0).abs() < tolerance);
                }
                // The multiplier of contact k is what the k + 1 discs behind it lose.
                for (k, &multiplier) in solution.multipliers.iter().enumerate() {
                    assert!((multiplier - (k + 1) as f64 * 0.02 / 9.0).abs() < tolerance);
                }
                assert_eq!(solution.fallback, calls);
                if backend == Backend::Fallback {
                    // The sum of Clarabel's own number and the one of `polish`, which needs no second.
                    let (_, factorisations) = clarabel::multipliers(&qp, SCALES[0]).unwrap();
                    assert_eq!(solution.iterations, factorisations + 1);
                }
            }
        }
    }

    #[test]
    fn contacts_that_depend_on_each_other_are_solved() {
        // The same contact five times: every split of the multiplier is a solution.
        let mut qp = row(2);
        qp.contacts = vec![qp.contacts[0]; 5];
        for guess in [[0.0; 5], [1.0; 5], [0.0, 0.0, 1.0, 0.0, 1.0]] {
            let solution = solved(Backend::Exact, &qp, &guess);
            assert!(solution.residual <= TARGET, "{}", solution.residual);
            assert!((solution.multipliers.iter().sum::<f64>() - 0.01).abs() < 1e-9);
            assert_eq!(solution.fallback, 0);
        }
    }

    #[test]
    fn descend_converges_from_any_start() {
        let (qp, mut polish) = (row(9), Polish::default());
        for start in [
            [0.0; 8],
            [1.0; 8],
            [0.0, 3.0, 0.0, 0.0, 1e3, 0.0, 0.0, 1e-9],
        ] {
            let mut solution = Solution::default();
            solution.clear();
            polish.descend(&qp, &start);
            solution.offer(&qp, polish.multipliers().iter().copied());
            assert!(solution.residual <= TARGET, "{}", solution.residual);
        }
    }

    #[test]
    fn a_wrong_guess_does_not_change_the_solution() {
        let qp = row(9);
        let right = solved(Backend::Exact, &qp, &[1.0; 8]);
        let wrong = [1e6, 0.0, 0.0, 1e-9, 0.0, 3.0, 0.0, 0.0];
        let wrong = solved(Backend::Exact, &qp, &wrong);
        for (one, other) in right.displacement.iter().zip(&wrong.displacement) {
            assert!((one[0] - other[0]).abs() < 1e-9);
        }
    }

    #[test]
    fn without_pushing_contacts_all_move_freely() {
        let mut qp = row(3);
        qp.contacts.iter_mut().for_each(|contact| contact.gap = 0.1);
        for guess in [[0.0; 2], [0.5; 2]] {
            let solution = solved(Backend::Exact, &qp, &guess);
            assert_eq!((solution.fallback, &solution.displacement), (0, &qp.free));
        }
    }

    #[test]
    fn nan_in_a_gap_gives_no_solution() {
        let mut qp = row(3);
        qp.contacts[1].gap = f64::NAN;
        let solution = solved(Backend::Exact, &qp, &[0.5, 0.5]);
        assert_eq!(solution.residual, f64::INFINITY);
    }
}
