//! From a guess of the active set to the exact multipliers.
//!
//! For a fixed active set, the condition that all its gaps close is a linear system. Contacts with
//! a negative multiplier then leave the set and overlapping contacts join, until no contact changes
//! sides. Usually few contacts are wrong and this takes a few rounds. It may also cycle, so it
//! stops when rounds make no progress; the caller then uses another method.
//!
//! The system is solved by the method of multipliers: `K = W + Σ σ_k ∇g_k ∇g_kᵀ` over the active
//! set has a row for each coordinate of an individual. It is positive definite even if contacts
//! depend on each other, as in packed groups of discs.

use super::TARGET;
use super::envelope::Envelope;
use crate::stepper::qp::Qp;

/// σ, the penalty on a gap whose gradient has unit length in the metric of `W`. Each pass divides
/// the error by about `σ` times the least eigenvalue of the dual matrix with rows of unit length;
/// beyond 1e8 rounding in `K` dominates.
const PENALTY: f64 = 1e8;

/// An inactive contact is wrong if it overlaps by more than this: well below the target, so that
/// the overlap that remains does not affect whether the residual reaches it. A negative multiplier
/// of any size is wrong.
pub(super) const WRONG: f64 = 0.1 * TARGET;

/// Largest open gap of an active contact that counts as closed.
const CLOSED: f64 = 0.01 * TARGET;

/// Passes with one factor. Two nearly always suffice; a set that four passes cannot close has no
/// solution.
const MAX_PASSES: usize = 4;

/// A round makes progress if the number of wrong contacts falls below this share of the least so
/// far.
const PROGRESS: f64 = 0.7;

/// Total number of rounds without progress, not consecutive, that `polish` makes before it stops:
/// more would cost more than another interior-point solution.
const MAX_IDLE_ROUNDS: usize = 20;

/// From this total number of rounds without progress on, only the worst contacts change sides. In a
/// packed group one wrong contact changes the signs of many multipliers, and most of the contacts
/// that appear wrong are not.
const PARTIAL_FROM: usize = 2;

/// One in this many of the wrong contacts then changes sides.
const WORST_SHARE: usize = 3;

/// Buffers of [`Workspace::polish`] and `descend`; only the result is kept between calls.
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    envelope: Envelope,
    rows: Vec<Row>,
    pub(super) multipliers: Vec<f64>,
    pub(super) displacement: Vec<[f64; 3]>,
    change: Vec<[f64; 3]>,
}

/// A constraint's gradient divided by `√W`, normalised to length 1, and its length before.
#[derive(Clone, Copy, Debug)]
struct Row {
    parts: [[f64; 3]; 2],
    length: f64,
}

impl Workspace {
    /// Returns the m multipliers of the last polish or descent; some may be negative.
    pub fn multipliers(&self) -> &[f64] {
        &self.multipliers
    }

    /// Guesses the active set from approximate multipliers: the contacts whose multiplier exceeds
    /// their gap, both as lengths in the metric of `W`.
    ///
    /// - Shapes: m multipliers and n displacements; m flags.
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

    /// Exchanges contacts until none is on the wrong side, and returns the number of
    /// factorisations. [`Workspace::multipliers`] has the result, which may be inexact.
    ///
    /// - Shapes: m multipliers in `guess`, m flags in `active`.
    pub fn polish(&mut self, qp: &Qp, guess: &[f64], mut active: Vec<bool>) -> usize {
        self.normalise(qp);
        self.multipliers.clear();
        self.multipliers.extend_from_slice(guess);
        let (mut best, mut idle, mut rounds) = (f64::INFINITY, 0, 0);
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
                idle += 1;
            }
            if idle > MAX_IDLE_ROUNDS {
                return rounds;
            }
            if idle >= PARTIAL_FROM {
                let count = wrong.len().div_ceil(WORST_SHARE);
                wrong.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
                wrong.truncate(count);
            }
            wrong.into_iter().for_each(|(k, _)| active[k] = !active[k]);
        }
    }

    /// Fills the rows from the program.
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

    /// Assembles and factors `K` of the active set in the metric of `W`, in which `W` becomes the
    /// unit matrix.
    pub(super) fn factor(&mut self, qp: &Qp, active: &[bool]) {
        let chosen = || (0..active.len()).filter(|&k| active[k]);
        let ends = |k: usize| (qp.contacts[k].i as usize, qp.contacts[k].j as usize);
        let edges: Vec<(usize, usize)> = chosen().map(ends).collect();
        // Discs turn freely: no constraint depends on their angles.
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

    /// Computes the multipliers that close the active gaps; all others become 0.
    pub(super) fn close(&mut self, qp: &Qp, active: &[bool]) {
        for (multiplier, &active) in self.multipliers.iter_mut().zip(active) {
            if !active {
                *multiplier = 0.0;
            }
        }
        for pass in 0..=MAX_PASSES {
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
            // If a multiplier is negative, the set will change, and one pass suffices to find the
            // wrong contacts.
            if open <= CLOSED || pass == MAX_PASSES || pass > 0 && pulls {
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

    /// Lists the contacts on the wrong side and by how much, as lengths in the metric of `W`:
    /// active contacts with a negative multiplier, and inactive contacts that overlap.
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
