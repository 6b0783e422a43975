//! The constraints in the form of the exact solver: in the metric of `W`, by place in the
//! elimination order.
//!
//! With `w = √W (d - u)` the program is: minimise `½ |w|²` subject to `b_k·w + γ_k ≥ 0`. The row
//! `b_k` is the scaled gradient, and `γ_k = g_k + ∇g_k·u` is the gap after free motion, where `g_k`
//! is the gap at the start of the step. At the solution `w = Σ b_k λ_k`, `λ ≥ 0`.

use super::PENALTY;
use crate::stepper::qp::Qp;

/// The entries of a vector for one individual: x, y, angle, and a zero that fills the fourth lane.
pub type Part = [f64; 4];

/// One constraint with the state of its solution.
///
/// All fields of a row are in one struct, since the sweeps over all rows are most of the cost of a
/// small group.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Places of the two individuals in vectors.
    pub place: [u32; 2],
    /// `b_k` at each of the two places.
    pub parts: [Part; 2],
    /// `γ_k`, the gap after free motion.
    pub gap: f64,
    /// `σ_k`, the penalty on this gap: `σ / |b_k|²`.
    pub penalty: f64,
    /// The block of the factor that couples the two individuals.
    pub block: u32,
    /// Rank among the members of the closure; [`NONE`] outside of it.
    pub rank: u32,
    /// Whether the contact was in the active set when `K` was factored.
    pub active: bool,
    /// Whether the contact is in the active set now.
    pub pushing: bool,
    /// `λ_k`.
    pub multiplier: f64,
    /// `λ_k` after the current pass; once the pass is applied, `λ_k` before it.
    pub proposed: f64,
    /// `s_k`, the gap that the multipliers leave.
    pub slack: f64,
    /// The gap after the current pass.
    pub ahead: f64,
    /// `λ_k` of a pushing row, the gap of any other, after the current pass or round of the
    /// closure.
    pub followed: f64,
}

/// No rank.
pub const NONE: u32 = u32::MAX;

impl Row {
    /// Returns `b_k·w`.
    #[inline(always)]
    pub fn along(&self, vector: &[Part]) -> f64 {
        let [first, second] = self.place.map(|place| &vector[place as usize]);
        let mut lanes = [0.0; 4];
        for (lane, sum) in lanes.iter_mut().enumerate() {
            *sum = self.parts[0][lane] * first[lane] + self.parts[1][lane] * second[lane];
        }
        (lanes[0] + lanes[1]) + lanes[2]
    }

    /// Returns the gap left at `w`.
    #[inline(always)]
    pub fn slack_at(&self, vector: &[Part]) -> f64 {
        self.gap + self.along(vector)
    }

    /// Adds `factor b_k` to `vector`.
    #[inline(always)]
    pub fn add(&self, factor: f64, vector: &mut [Part]) {
        for (place, part) in self.place.iter().zip(&self.parts) {
            let entry = &mut vector[*place as usize];
            for lane in 0..4 {
                entry[lane] += factor * part[lane];
            }
        }
    }
}

/// Fills `rows` from the program. Places are the indices of individuals until an elimination order
/// replaces them.
///
/// - Shapes: m contacts; m rows.
pub fn fill(qp: &Qp, rows: &mut Vec<Row>) {
    let [drag_x, drag_y, drag_angle] = qp.weights.map(|weight| 1.0 / weight.sqrt());
    rows.clear();
    rows.extend(qp.contacts.iter().map(|contact| {
        let [x, y] = [contact.normal[0] * drag_x, contact.normal[1] * drag_y];
        let [one, two] = contact.lever.map(|lever| lever * drag_angle);
        let squares = 2.0 * (x * x + y * y) + (one * one + two * two);
        Row {
            place: [contact.i, contact.j],
            parts: [[-x, -y, -one, 0.0], [x, y, two, 0.0]],
            gap: contact.linearised_gap(&qp.free),
            penalty: PENALTY / squares,
            block: 0,
            rank: NONE,
            active: false,
            pushing: false,
            multiplier: 0.0,
            proposed: 0.0,
            slack: 0.0,
            ahead: 0.0,
            followed: 0.0,
        }
    }));
}
