//! Clarabel without scaling of the program and with default settings; set-up included.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, SupportedConeT};
use jostle_physics::stepper::qp::Qp;

/// Solves `qp`. Returns the multipliers, one per contact, and the number of factored systems.
///
/// Minimises `½ dᵀ W d - uᵀ W d` subject to `-A d + s = g`, `s ≥ 0`. Contacts do not turn discs:
/// their program contains only the centres.
pub fn solve(qp: &Qp) -> (Vec<f64>, usize) {
    let turns = qp.contacts.iter().any(|one| one.lever != [0.0, 0.0]);
    let axes = if turns { 3 } else { 2 };
    let columns = axes * qp.free.len();
    let diagonal = (0..columns).map(|k| qp.weights[k % axes]).collect();
    let weights = CscMatrix::new(
        columns,
        columns,
        (0..=columns).collect(),
        (0..columns).collect(),
        diagonal,
    );
    let linear: Vec<f64> = (0..columns)
        .map(|k| -qp.weights[k % axes] * qp.free[k / axes][k % axes])
        .collect();
    let gaps: Vec<f64> = qp.contacts.iter().map(|contact| contact.gap).collect();
    let cones = [SupportedConeT::NonnegativeConeT(qp.contacts.len())];
    let settings = DefaultSettings {
        verbose: false,
        ..DefaultSettings::default()
    };
    let rows = negative_gradients(qp, axes);
    let mut solver = DefaultSolver::new(&weights, &linear, &rows, &gaps, &cones, settings)
        .expect("Clarabel accepts the program");
    solver.solve();
    let iterations = solver.solution.iterations as usize;
    (solver.solution.z.clone(), iterations)
}

/// Returns `-A` in compressed columns, in two passes over the contacts: count, then fill.
fn negative_gradients(qp: &Qp, axes: usize) -> CscMatrix<f64> {
    let columns = axes * qp.free.len();
    let mut starts = vec![0; columns + 1];
    for contact in &qp.contacts {
        for individual in [contact.i as usize, contact.j as usize] {
            for axis in 0..axes {
                starts[axes * individual + axis + 1] += 1;
            }
        }
    }
    for column in 0..columns {
        starts[column + 1] += starts[column];
    }
    let entries = starts[columns];
    let (mut rows, mut values) = (vec![0; entries], vec![0.0; entries]);
    let mut next = starts.clone();
    for (row, contact) in qp.contacts.iter().enumerate() {
        let ([x, y], [one, two]) = (contact.normal, contact.lever);
        for (individual, parts) in [(contact.i, [x, y, one]), (contact.j, [-x, -y, -two])] {
            for (axis, &part) in parts.iter().enumerate().take(axes) {
                let at = &mut next[axes * individual as usize + axis];
                (rows[*at], values[*at]) = (row, part);
                *at += 1;
            }
        }
    }
    CscMatrix::new(qp.contacts.len(), columns, starts, rows, values)
}
