//! Conversion of the program of one step to Clarabel's form, and its solution by Clarabel.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, SupportedConeT};

use crate::stepper::qp::Qp;

/// Tolerance set in Clarabel, in scaled units. Clarabel does not always reach it, and its status is
/// not a reliable indication; the caller computes the residual.
const TOLERANCE: f64 = 1e-12;

/// Value added to the diagonals of Clarabel's systems. With its default of 1e-8 Clarabel makes
/// no further progress on packed groups six orders of magnitude above the tolerance.
const REGULARISATION: f64 = 1e-12;

/// Computes multipliers of `qp` by an interior-point method; returns them with the number of
/// iterations, each of which factors a system.
///
/// In `w = d - u` the program is: minimise `½ wᵀ W w` subject to `A w + (g + A u) ≥ 0`. The
/// right-hand side `g + A u` is multiplied by `scale`, and the multipliers are divided by it. The
/// accuracy is not guaranteed. Returns `None` if the right-hand side is not finite or Clarabel
/// rejects the program.
///
/// - Shapes: m multipliers, one for each contact.
pub fn multipliers(qp: &Qp, scale: f64) -> Option<(Vec<f64>, usize)> {
    let (n, m) = (qp.free.len(), qp.contacts.len());
    let slack: Vec<f64> = qp
        .contacts
        .iter()
        .map(|contact| scale * contact.linearised_gap(&qp.free))
        .collect();
    if !slack.iter().all(|value| value.is_finite()) {
        return None;
    }
    let diagonal = (0..3 * n).map(|k| qp.weights[k % 3]).collect();
    let weights = CscMatrix::new(
        3 * n,
        3 * n,
        (0..=3 * n).collect(),
        (0..3 * n).collect(),
        diagonal,
    );
    let solver = DefaultSolver::new(
        &weights,
        &vec![0.0; 3 * n],
        &negative_gradients(qp),
        &slack,
        &[SupportedConeT::NonnegativeConeT(m)],
        settings(),
    );
    let mut solver = solver.ok()?;
    solver.solve();
    let multipliers = solver
        .solution
        .z
        .iter()
        .map(|value| value / scale)
        .collect();
    Some((multipliers, solver.solution.iterations as usize))
}

fn settings() -> DefaultSettings<f64> {
    DefaultSettings {
        verbose: false,
        // A time limit would make the result depend on the clock.
        time_limit: f64::INFINITY,
        max_threads: 1,
        tol_gap_abs: TOLERANCE,
        tol_gap_rel: TOLERANCE,
        tol_feas: TOLERANCE,
        static_regularization_constant: REGULARISATION,
        ..DefaultSettings::default()
    }
}

/// Returns `-A` by columns, m × 3n: a row for each contact, three columns for each individual.
fn negative_gradients(qp: &Qp) -> CscMatrix<f64> {
    let mut columns: Vec<Vec<(usize, f64)>> = vec![Vec::new(); 3 * qp.free.len()];
    for (row, contact) in qp.contacts.iter().enumerate() {
        let [x, y] = contact.normal;
        let entries = [[x, y, contact.lever[0]], [-x, -y, -contact.lever[1]]];
        for (individual, entries) in [contact.i, contact.j].into_iter().zip(entries) {
            for (axis, entry) in entries.into_iter().enumerate() {
                columns[3 * individual as usize + axis].push((row, entry));
            }
        }
    }
    let mut starts = vec![0];
    let (mut rows, mut values) = (Vec::new(), Vec::new());
    for column in &columns {
        rows.extend(column.iter().map(|(row, _)| *row));
        values.extend(column.iter().map(|(_, value)| *value));
        starts.push(rows.len());
    }
    CscMatrix::new(qp.contacts.len(), columns.len(), starts, rows, values)
}
