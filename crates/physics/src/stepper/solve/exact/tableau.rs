//! A small dense linear complementarity problem: `w = q + T z`, `w ≥ 0`, `z ≥ 0`, `w·z = 0`.
//!
//! The method is principal pivoting: Cottle and Dantzig (1968). Each major cycle raises the `z` of
//! the most negative basic variable until that variable is zero. A basic variable that would become
//! negative on the way is exchanged. The method is finite since every principal minor of `T` is
//! positive.

/// Pivots before the solver stops. Usually there is one for each contact that changes sides.
const MAX_PIVOTS: usize = 2000;

/// An entry of a column smaller than this is a rounding error and does not block.
const NEGLIGIBLE: f64 = 1e-13;

/// The problem, and after [`Tableau::solve`] its solution.
#[derive(Clone, Debug, Default)]
pub struct Tableau {
    /// Number of unknowns.
    pub size: usize,
    /// `T`, then `T` in terms of the present basis, row by row at [`Tableau::stride`].
    entries: Vec<f64>,
    stride: usize,
    /// `q`, then the values of the basic variables.
    pub value: Vec<f64>,
    /// Whether `z` is basic in place of `w`.
    pub exchanged: Vec<bool>,
    moving: Vec<f64>,
    row: Vec<f64>,
    raised: Vec<usize>,
}

impl Tableau {
    /// Removes all unknowns.
    pub fn clear(&mut self) {
        self.size = 0;
        self.stride = 0;
        self.value.clear();
        self.exchanged.clear();
    }

    /// Adds unknowns, up to `size` in all; `entry(row, column)` are the entries of `T`. The basis
    /// stays, and for the new unknowns `w` is basic. The caller sets [`Tableau::value`] of all.
    #[inline(always)]
    pub fn extend(&mut self, size: usize, entry: impl Fn(usize, usize) -> f64) {
        let old = self.size;
        if size == old {
            return;
        }
        self.widen(size);
        self.exchanged.resize(size, false);
        let (stride, exchanged) = (self.stride, &self.exchanged);
        self.raised.clear();
        self.raised.extend((0..old).filter(|&k| exchanged[k]));
        // The columns of the new z: their direct effect on a basic w, and the effect by way of the
        // basic z on all.
        self.moving.clear();
        for &basic in &self.raised {
            self.moving.extend((old..size).map(|new| entry(basic, new)));
        }
        for (k, &basic) in exchanged[..old].iter().enumerate() {
            let (own, new) = self.entries[k * stride..][..size].split_at_mut(old);
            for (at, target) in (old..).zip(&mut *new) {
                *target = if basic { 0.0 } else { entry(k, at) };
            }
            let direct = self.moving.chunks_exact(size - old);
            for (&basic, direct) in self.raised.iter().zip(direct) {
                subtract_scaled(new, own[basic], direct);
            }
        }
        // The rows of the new w, in terms of the same basis.
        for k in old..size {
            self.row.clear();
            let direct = |at: usize| if exchanged[at] { 0.0 } else { entry(k, at) };
            self.row.extend((0..size).map(direct));
            for &basic in &self.raised {
                let above = &self.entries[basic * stride..][..size];
                subtract_scaled(&mut self.row, -entry(k, basic), above);
            }
            self.entries[k * stride..][..size].copy_from_slice(&self.row);
        }
    }

    /// Extends the buffer to `size` unknowns.
    #[inline(always)]
    fn widen(&mut self, size: usize) {
        let (before, stride) = (self.stride, size.next_multiple_of(8));
        if self.entries.len() < stride * stride {
            self.entries.resize(stride * stride, 0.0);
        }
        for k in (1..self.size).rev() {
            let row = k * before..k * before + self.size;
            self.entries.copy_within(row, k * stride);
        }
        (self.size, self.stride) = (size, stride);
    }

    /// Returns `z` of one unknown.
    #[inline(always)]
    pub fn raised(&self, at: usize) -> f64 {
        if self.exchanged[at] {
            self.value[at]
        } else {
            0.0
        }
    }

    /// Returns a row of `T` in terms of the present basis.
    #[inline(always)]
    pub fn row(&self, row: usize) -> &[f64] {
        &self.entries[row * self.stride..][..self.size]
    }

    /// Solves the problem; values down to `-tolerance` count as not negative. Adds the number of
    /// pivots to `pivots`, and returns whether it ended within [`MAX_PIVOTS`].
    #[inline(always)]
    pub fn solve(&mut self, tolerance: f64, pivots: &mut usize) -> bool {
        loop {
            let mut worst = (-tolerance, None);
            for (k, &value) in self.value.iter().enumerate() {
                if value < worst.0 {
                    worst = (value, Some(k));
                }
            }
            let Some(driven) = worst.1 else { return true };
            self.moving.clear();
            self.moving.extend_from_slice(&self.value);
            loop {
                *pivots += 1;
                if *pivots > MAX_PIVOTS {
                    return false;
                }
                let blocking = self.raise(driven, tolerance);
                self.exchange(blocking);
                if blocking == driven {
                    break;
                }
                self.moving[blocking] = 0.0;
            }
        }
    }

    /// Raises the non-basic variable of `driven` until a basic variable is zero, and returns the
    /// unknown of that variable.
    #[inline(always)]
    fn raise(&mut self, driven: usize, tolerance: f64) -> usize {
        let (stride, entries) = (self.stride, &self.entries);
        let along = |k: usize| entries[k * stride + driven];
        let mut blocking = driven;
        let mut step = if along(driven) > 0.0 {
            -self.moving[driven] / along(driven)
        } else {
            f64::INFINITY
        };
        for (k, &value) in self.moving.iter().enumerate() {
            if k != driven && value >= -tolerance && along(k) < -NEGLIGIBLE {
                let bound = value.max(0.0) / -along(k);
                if bound < step {
                    (step, blocking) = (bound, k);
                }
            }
        }
        for (k, value) in self.moving.iter_mut().enumerate() {
            *value += along(k) * step;
        }
        blocking
    }

    /// Exchanges `w` and `z` of one unknown in the basis: a principal pivot.
    #[inline(always)]
    pub fn exchange(&mut self, at: usize) {
        self.exchanged[at] = !self.exchanged[at];
        let (stride, size) = (self.stride, self.size);
        let inverse = 1.0 / self.entries[at * stride + at];
        self.row.clear();
        self.row
            .extend_from_slice(&self.entries[at * stride..][..size]);
        self.row[at] = 0.0;
        let value = self.value[at];
        for k in (0..size).filter(|&k| k != at) {
            let row = &mut self.entries[k * stride..][..size];
            let factor = row[at] * inverse;
            if factor != 0.0 {
                subtract_scaled(row, factor, &self.row);
                row[at] = factor;
                self.value[k] -= factor * value;
            }
        }
        let row = &mut self.entries[at * stride..][..size];
        for (entry, old) in row.iter_mut().zip(&self.row) {
            *entry = -old * inverse;
        }
        row[at] = inverse;
        self.value[at] = -value * inverse;
    }
}

/// `target -= factor · other`.
#[inline(always)]
fn subtract_scaled(target: &mut [f64], factor: f64, other: &[f64]) {
    for (entry, other) in target.iter_mut().zip(other) {
        *entry -= factor * other;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::random::{Purpose, Stream};

    /// `T = Fᵀ F + F - Fᵀ` plus 1e-6 of the unit matrix, with a random `F`: not symmetric, with
    /// positive principal minors, as in the problems of the closure.
    fn problem(size: usize, seed: u64) -> (Vec<Vec<f64>>, Vec<f64>) {
        let mut stream = Stream::new(seed, 0, 0, Purpose::Start);
        let mut draw = || stream.uniform() - 0.5;
        let factor: Vec<Vec<f64>> = (0..size)
            .map(|_| (0..size).map(|_| draw()).collect())
            .collect();
        let mut matrix = vec![vec![0.0; size]; size];
        for a in 0..size {
            for b in 0..size {
                let products = factor.iter().map(|row| row[a] * row[b]);
                matrix[a][b] = products.sum::<f64>() + factor[a][b] - factor[b][a];
            }
            matrix[a][a] += 1e-6;
        }
        let start = (0..size).map(|_| draw()).collect();
        (matrix, start)
    }

    #[test]
    fn solutions_are_complementary() {
        let mut tableau = Tableau::default();
        let (mut raised, mut sizes) = (0, 0);
        for seed in 0..200 {
            let size = 1 + usize::try_from(seed).unwrap_or(0) % 40;
            let (matrix, start) = problem(size, seed);
            tableau.clear();
            // All unknowns at once, or in three parts with a solution after each.
            let parts = if seed % 2 == 0 { 1 } else { 3 };
            for part in 1..=parts {
                let size = size * part / parts;
                let z: Vec<f64> = (0..tableau.size).map(|k| tableau.raised(k)).collect();
                let follow = |a: usize| {
                    let row = matrix[a].iter().zip(&z);
                    start[a] + row.map(|(t, z)| t * z).sum::<f64>()
                };
                tableau.value.extend((tableau.size..size).map(follow));
                tableau.extend(size, |a, b| matrix[a][b]);
                assert!(tableau.solve(1e-12, &mut 0), "seed {seed}");
            }
            let z: Vec<f64> = (0..size).map(|k| tableau.raised(k)).collect();
            for (a, row) in matrix.iter().enumerate() {
                let w = start[a] + row.iter().zip(&z).map(|(t, z)| t * z).sum::<f64>();
                let expected = if tableau.exchanged[a] {
                    0.0
                } else {
                    tableau.value[a]
                };
                assert!((w - expected).abs() < 1e-7, "seed {seed}: {w} {expected}");
                assert!(z[a] >= -1e-9 && w >= -1e-7, "seed {seed}");
            }
            raised += tableau.exchanged.iter().filter(|&&one| one).count();
            sizes += size;
        }
        assert!(10 * raised > sizes, "{raised} of {sizes} are raised");
    }

    #[test]
    fn nothing_is_exchanged_if_no_value_is_negative() {
        let (matrix, _) = problem(5, 3);
        let mut tableau = Tableau::default();
        tableau.extend(5, |a, b| matrix[a][b]);
        tableau.value.extend([0.0, 1.0, 0.5, -1e-13, 2.0]);
        let mut pivots = 0;
        assert!(tableau.solve(1e-12, &mut pivots));
        assert_eq!((pivots, &tableau.exchanged[..]), (0, &[false; 5][..]));
    }

    #[test]
    fn a_variable_at_zero_that_would_fall_blocks_at_once() {
        let matrix = [[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [1e-14, 0.0, 1.0]];
        let mut tableau = Tableau::default();
        tableau.extend(3, |a, b| matrix[a][b]);
        // The values before, the variable that blocks, and the step.
        for (values, blocking, step) in [
            ([-1.0, 0.0, 0.0], 1, 0.0),
            ([-1.0, -1e-13, 0.0], 1, 0.0),
            ([-1.0, 0.25, 0.0], 1, 0.25),
            // One that is negative already, or does not fall, does not block.
            ([-1.0, -0.5, 0.0], 0, 1.0),
            ([-1.0, 2.0, 0.0], 0, 1.0),
        ] {
            tableau.moving = values.to_vec();
            assert_eq!(tableau.raise(0, 1e-12), blocking, "{values:?}");
            let moved: Vec<f64> = values
                .iter()
                .zip(matrix)
                .map(|(v, t)| v + t[0] * step)
                .collect();
            assert_eq!(tableau.moving, moved, "{values:?}");
        }
    }
}
