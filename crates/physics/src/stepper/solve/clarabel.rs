//! The program of one step as Clarabel wants it.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, SupportedConeT};

use crate::stepper::qp::Qp;

/// The tolerance asked for, in scaled units. It is not always reached, and the status is no
/// guide to when; the caller measures.
const TOLERANCE: f64 = 1e-12;

/// What is added to the systems' diagonals. At Clarabel's own 1e-8 it stalls on packed groups,
/// short of the tolerance by six orders.
const REGULARISATION: f64 = 1e-12;

/// Finds multipliers of `qp` by an interior point method, with how many systems it factored.
///
/// In `w = d - u` the program is: minimise `½ wᵀ W w` subject to `A w + (g + A u) ≥ 0`. Nothing
/// is promised about the answer. None if Clarabel does not take the program.
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
        // A limit in time would make the answer depend on the clock.
        time_limit: f64::INFINITY,
        max_threads: 1,
        tol_gap_abs: TOLERANCE,
        tol_gap_rel: TOLERANCE,
        tol_feas: TOLERANCE,
        static_regularization_constant: REGULARISATION,
        ..DefaultSettings::default()
    }
}

/// `-A` by columns: one row per contact, three columns per individual.
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
