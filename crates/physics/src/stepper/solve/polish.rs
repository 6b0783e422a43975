//! From a guess of who pushes to the exact multipliers.
//!
//! With the set of pushing contacts fixed, their gaps close exactly: linear equations. Those
//! that would then pull are dropped, those that would overlap added, and again, until nobody
//! changes sides. Mostly few are wrong and this takes a few rounds. It may also wander, so it
//! gives up when rounds stop paying; the caller then asks elsewhere.
//!
//! The equations are solved by multipliers with a penalty: `K = W + σ A_Aᵀ A_A` lives on the
//! individuals, and is positive definite even when contacts depend on each other, as those of
//! packed discs do.

use super::TARGET;
use super::envelope::Envelope;
use crate::stepper::qp::Qp;

/// The penalty, with rows of unit length in the metric of `W`. Each pass shrinks the error by
/// about `σ` times the least eigenvalue of `A W⁻¹ Aᵀ`; beyond 1e8 rounding in `K` takes over.
const PENALTY: f64 = 1e8;

/// A gap or multiplier this far on the wrong side changes sides: well below the target, so that
/// what stays is no part of the residual.
pub(super) const WRONG: f64 = 0.1 * TARGET;

/// A gap closed to this is closed.
const CLOSED: f64 = 0.01 * TARGET;

/// Passes of one system. Two nearly always do; what four cannot close is a set without solution.
const MOST_PASSES: usize = 4;

/// A round pays if it leaves so much fewer on the wrong side than the best before it.
const PROGRESS: f64 = 0.7;

/// Rounds in all that may fail to pay, before wandering is dearer than an interior point method.
const PATIENCE: usize = 20;

/// After so many rounds that failed to pay, only the worst change sides: in packed groups one
/// wrong contact swings many multipliers, and most of those seen wrong are only swung.
const HASTE: usize = 2;

/// The share of the wrong ones that then changes sides, one in so many.
const WORST_SHARE: usize = 3;

/// The memory of one polish; nothing in it outlives a call.
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    envelope: Envelope,
    rows: Vec<Row>,
    pub(super) multipliers: Vec<f64>,
    pub(super) displacement: Vec<[f64; 3]>,
    change: Vec<[f64; 3]>,
}

/// A constraint's gradient divided by `√W`, brought to length 1, and the length it had.
#[derive(Clone, Copy, Debug)]
struct Row {
    parts: [[f64; 3]; 2],
    length: f64,
}

impl Workspace {
    /// The multipliers that the last polish ended with; some may be negative.
    pub fn multipliers(&self) -> &[f64] {
        &self.multipliers
    }

    /// Tells who pushes by rough multipliers: those whose push is larger than their gap.
    pub fn pushing(
        &mut self,
        qp: &Qp,
        multipliers: &[f64],
        displacement: &[[f64; 3]],
    ) -> Vec<bool> {
        self.normalise(qp);
        let rows = qp.contacts.iter().zip(multipliers).zip(&self.rows);
        rows.map(|((contact, multiplier), row)| {
            multiplier * row.length > contact.linearised_gap(displacement) / row.length
        })
        .collect()
    }

    /// Exchanges contacts until nobody is on the wrong side, and returns how many systems that
    /// took. The multipliers are left in the workspace, whether exact or not.
    pub fn polish(&mut self, qp: &Qp, guess: &[f64], mut active: Vec<bool>) -> usize {
        self.normalise(qp);
        self.multipliers.clear();
        self.multipliers.extend_from_slice(guess);
        let (mut best, mut unpaid, mut rounds) = (f64::INFINITY, 0, 0);
        loop {
            if active.contains(&true) {
                self.factor(qp, &active);
                rounds += 1;
            }
            self.close(qp, &active);
            let mut wrong = self.wrong(qp, &active);
            if wrong.is_empty() {
                return rounds;
            }
            if (wrong.len() as f64) < PROGRESS * best {
                best = wrong.len() as f64;
            } else {
                unpaid += 1;
            }
            if unpaid > PATIENCE {
                return rounds;
            }
            if unpaid >= HASTE {
                let count = wrong.len().div_ceil(WORST_SHARE);
                wrong.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
                wrong.truncate(count);
            }
            wrong.into_iter().for_each(|(k, _)| active[k] = !active[k]);
        }
    }

    pub(super) fn normalise(&mut self, qp: &Qp) {
        let scale = qp.weights.map(f64::sqrt);
        self.rows.clear();
        self.rows.extend(qp.contacts.iter().map(|contact| {
            let ([x, y], [one, two]) = (contact.normal, contact.lever);
            let mut parts = [[-x, -y, -one], [x, y, two]];
            parts
                .iter_mut()
                .flatten()
                .zip(scale.into_iter().cycle())
                .for_each(|(entry, scale)| *entry /= scale);
            let length = parts
                .iter()
                .flatten()
                .map(|entry| entry * entry)
                .sum::<f64>()
                .sqrt();
            parts
                .iter_mut()
                .flatten()
                .for_each(|entry| *entry /= length);
            Row { parts, length }
        }));
    }

    /// Factors `K` of the active set, in the metric of `W`, where it starts from the unit matrix.
    pub(super) fn factor(&mut self, qp: &Qp, active: &[bool]) {
        let chosen = || (0..active.len()).filter(|&k| active[k]);
        let ends = |k: usize| (qp.contacts[k].i as usize, qp.contacts[k].j as usize);
        let edges: Vec<(usize, usize)> = chosen().map(ends).collect();
        // Discs turn freely: their angles are no part of any constraint.
        let turns = qp
            .contacts
            .iter()
            .any(|contact| contact.lever != [0.0, 0.0]);
        self.envelope
            .prepare(qp.free.len(), if turns { 3 } else { 2 }, &edges);
        for k in chosen() {
            let (i, j) = ends(k);
            self.envelope.add(i, j, self.rows[k].parts, PENALTY);
        }
        self.envelope.factor();
    }

    /// Finds the multipliers that close the active gaps; the others are 0.
    pub(super) fn close(&mut self, qp: &Qp, active: &[bool]) {
        for (multiplier, &active) in self.multipliers.iter_mut().zip(active) {
            if !active {
                *multiplier = 0.0;
            }
        }
        for pass in 0..=MOST_PASSES {
            qp.displace(&self.multipliers, &mut self.displacement);
            let gaps: Vec<f64> = qp
                .contacts
                .iter()
                .map(|contact| contact.linearised_gap(&self.displacement))
                .collect();
            let open = (0..gaps.len())
                .filter(|&k| active[k])
                .fold(0.0, |open, k| f64::max(open, gaps[k].abs()));
            let pulls = self.multipliers.iter().any(|&multiplier| multiplier < 0.0);
            // With somebody pulling this is not the last set, and one pass tells who is wrong.
            if open <= CLOSED || pass == MOST_PASSES || pass > 0 && pulls {
                return;
            }
            self.pass(qp, active, &gaps);
        }
    }

    /// One pass: `K δ = -σ Aᵀ s`, then `λ -= σ (s + A δ)`.
    fn pass(&mut self, qp: &Qp, active: &[bool], gaps: &[f64]) {
        self.change.clear();
        self.change.resize(qp.free.len(), [0.0; 3]);
        let chosen = || (0..active.len()).filter(|&k| active[k]);
        let ends = |k: usize| [qp.contacts[k].i as usize, qp.contacts[k].j as usize];
        for k in chosen() {
            let Row { parts, length } = self.rows[k];
            let pull = PENALTY * gaps[k] / length;
            for (individual, part) in ends(k).into_iter().zip(parts) {
                let change = &mut self.change[individual];
                *change = [
                    change[0] - pull * part[0],
                    change[1] - pull * part[1],
                    change[2] - pull * part[2],
                ];
            }
        }
        self.envelope.solve(&mut self.change);
        for k in chosen() {
            let Row { parts, length } = self.rows[k];
            let mut left = gaps[k] / length;
            for (individual, part) in ends(k).into_iter().zip(parts) {
                let change = self.change[individual];
                left += change[0] * part[0] + change[1] * part[1] + change[2] * part[2];
            }
            self.multipliers[k] -= PENALTY * left / length;
        }
    }

    /// Lists who is on the wrong side, and how far, all in lengths of the metric of `W`: active
    /// and pulling, or inactive and overlapping.
    fn wrong(&self, qp: &Qp, active: &[bool]) -> Vec<(usize, f64)> {
        let mut wrong = Vec::new();
        for (k, contact) in qp.contacts.iter().enumerate() {
            let overlap = -contact.linearised_gap(&self.displacement);
            if active[k] && self.multipliers[k] < 0.0 {
                wrong.push((k, -self.multipliers[k] * self.rows[k].length));
            } else if !active[k] && overlap > WRONG {
                wrong.push((k, overlap / self.rows[k].length));
            }
        }
        wrong
    }
}
