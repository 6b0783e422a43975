//! The constraints as the exact solver wants them: in the metric of `W`, by place in the order.
//!
//! With `w = √W (d - u)` the program is: minimise `½ |w|²` subject to `b_k·w + g_k ≥ 0`, where
//! `g_k` is the gap that free motion leaves. At the solution `w = Σ b_k λ_k`, `λ ≥ 0`.

use super::PENALTY;
use crate::stepper::qp::Qp;

/// An individual's share of a vector: x, y, angle, and a zero that fills four lanes.
pub type Part = [f64; 4];

/// One constraint, and where its solution stands.
///
/// All of it side by side: the sweeps over all rows are most of what a small group costs.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// The places of the two individuals in vectors.
    pub place: [u32; 2],
    /// `b_k` at each of them.
    pub parts: [Part; 2],
    /// The gap that free motion leaves.
    pub gap: f64,
    /// σ_k, the penalty on this gap: σ where the row has unit length.
    pub penalty: f64,
    /// Which block of the factor joins the two.
    pub block: u32,
    /// Its rank among the doubtful; [`NONE`] outside of them.
    pub rank: u32,
    /// Whether it was taken to push when `K` was factored.
    pub active: bool,
    /// Whether it is taken to push now.
    pub pushing: bool,
    /// λ.
    pub multiplier: f64,
    /// λ as the pass at hand would have it.
    pub proposed: f64,
    /// The gap left by the multipliers.
    pub slack: f64,
    /// The gap as the pass at hand would leave it.
    pub ahead: f64,
    /// Of a pushing row λ, of another the gap, as the pass or the doubtful would have it.
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

    /// Adds `factor b_k`.
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

/// Fills `rows` from the program; places are individuals, until the factor has others.
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
