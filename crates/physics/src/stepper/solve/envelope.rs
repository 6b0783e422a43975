//! Cholesky factors of symmetric matrices whose graph is nearly planar.
//!
//! Individuals are ordered breadth first, so that neighbours stay close, and every row is stored
//! from its first non-zero entry to the diagonal. The cost for a packed group of n individuals is
//! about `n · (√n)²` instead of n³.

/// Number of lanes of a sum. With fixed lanes the compiler can use vector registers without
/// changing the order of a sum.
const LANES: usize = 4;

/// A positive definite matrix of `axes` × `axes` blocks; after [`Envelope::factor`], its factor.
#[derive(Clone, Debug, Default)]
pub struct Envelope {
    axes: usize,
    /// Place of each individual in the order; `None` if it is not in the matrix.
    place: Vec<Option<usize>>,
    /// First column of each row, and its start in `values`.
    rows: Vec<(usize, usize)>,
    values: Vec<f64>,
}

impl Envelope {
    /// Sets the unit matrix over the individuals in `edges`, with space for an entry at each edge.
    ///
    /// - Shapes: `n` individuals in all; edges (i, j) with i < j, in any order.
    pub fn prepare(&mut self, n: usize, axes: usize, edges: &[(usize, usize)]) {
        self.axes = axes;
        let order = breadth_first(n, edges);
        self.place.clear();
        self.place.resize(n, None);
        for (place, &individual) in order.iter().enumerate() {
            self.place[individual] = Some(place);
        }
        let mut first: Vec<usize> = (0..order.len()).collect();
        for &(i, j) in edges {
            let (low, high) = self.places(i, j);
            first[high] = first[high].min(low);
        }
        self.rows.clear();
        let mut start = 0;
        for (place, first) in first.iter().enumerate() {
            for axis in 0..axes {
                self.rows.push((axes * first, start));
                start += axes * (place - first) + axis + 1;
            }
        }
        self.values.clear();
        self.values.resize(start, 0.0);
        for row in 0..self.rows.len() {
            *self.entry(row, row) = 1.0;
        }
    }

    /// Adds `factor b bᵀ`, where `b` has the entries `parts` at individuals `i` and `j`. The pair
    /// must be one of the edges.
    pub fn add(&mut self, i: usize, j: usize, parts: [[f64; 3]; 2], factor: f64) {
        let rows = [i, j].map(|individual| self.axes * self.place[individual].expect("in an edge"));
        let axes = self.axes;
        let entries = || {
            rows.into_iter()
                .zip(parts)
                .flat_map(|(row, part)| (row..row + axes).zip(part))
        };
        for (row, one) in entries() {
            for (column, other) in entries().filter(|(column, _)| *column <= row) {
                *self.entry(row, column) += factor * one * other;
            }
        }
    }

    /// Replaces the matrix by its lower Cholesky factor, row by row.
    pub fn factor(&mut self) {
        for row in 0..self.rows.len() {
            let (first, start) = self.rows[row];
            for column in first..row {
                let (other_first, other_start) = self.rows[column];
                let from = first.max(other_first);
                let (done, this) = self.values.split_at(start);
                let other = &done[other_start + from - other_first..];
                let sum = dot(&this[from - first..column - first], &other[..column - from]);
                let pivot = done[other_start + column - other_first];
                let value = (this[column - first] - sum) / pivot;
                self.values[start + column - first] = value;
            }
            let this = &self.values[start..=start + row - first];
            let (diagonal, left) = this.split_last().expect("a row holds its diagonal");
            // The matrix is at least the unit matrix, so a smaller pivot is a rounding error.
            let pivot = (diagonal - dot(left, left)).max(1.0).sqrt();
            self.values[start + row - first] = pivot;
        }
    }

    /// Replaces the right-hand side `vector` by the solution, using the factor. Entries of
    /// individuals that are not in the matrix do not change.
    ///
    /// - Shapes: n rows of three entries.
    pub fn solve(&self, vector: &mut [[f64; 3]]) {
        let mut solution = vec![0.0; self.rows.len()];
        self.each(|individual, axis, row| solution[row] = vector[individual][axis]);
        for row in 0..self.rows.len() {
            let (first, start) = self.rows[row];
            let sum = dot(
                &self.values[start..start + row - first],
                &solution[first..row],
            );
            solution[row] = (solution[row] - sum) / self.values[start + row - first];
        }
        for row in (0..self.rows.len()).rev() {
            let (first, start) = self.rows[row];
            let value = solution[row] / self.values[start + row - first];
            solution[row] = value;
            for (entry, factor) in solution[first..row].iter_mut().zip(&self.values[start..]) {
                *entry -= value * factor;
            }
        }
        self.each(|individual, axis, row| vector[individual][axis] = solution[row]);
    }

    /// Calls `visit` with individual, axis and row of every row.
    fn each(&self, mut visit: impl FnMut(usize, usize, usize)) {
        for (individual, place) in self.place.iter().enumerate() {
            let Some(place) = place else { continue };
            (0..self.axes).for_each(|axis| visit(individual, axis, self.axes * place + axis));
        }
    }

    /// Returns the places of both individuals, the lower first.
    fn places(&self, i: usize, j: usize) -> (usize, usize) {
        let [a, b] = [i, j].map(|individual| self.place[individual].expect("in an edge"));
        (a.min(b), a.max(b))
    }

    fn entry(&mut self, row: usize, column: usize) -> &mut f64 {
        let (first, start) = self.rows[row];
        &mut self.values[start + column - first]
    }
}

/// Orders all individuals in `edges` so that neighbours are close: breadth first from the border,
/// reversed (the reverse Cuthill-McKee order). Of equal degrees the lower index comes first.
fn breadth_first(n: usize, edges: &[(usize, usize)]) -> Vec<usize> {
    let mut neighbours: Vec<Vec<usize>> = vec![Vec::new(); n];
    for &(i, j) in edges {
        neighbours[i].push(j);
        neighbours[j].push(i);
    }
    neighbours.iter_mut().for_each(|list| {
        list.sort_unstable();
        list.dedup();
    });
    let degree: Vec<usize> = neighbours.iter().map(Vec::len).collect();
    neighbours
        .iter_mut()
        .for_each(|list| list.sort_by_key(|&k| (degree[k], k)));
    let mut starts: Vec<usize> = (0..n).filter(|&k| degree[k] > 0).collect();
    starts.sort_by_key(|&k| (degree[k], k));
    let mut order = Vec::with_capacity(starts.len());
    let mut seen = vec![false; n];
    for start in starts {
        if seen[start] {
            continue;
        }
        // The individual reached last is on the far side, which makes it a better start.
        let begin = order.len();
        visit(start, &neighbours, &mut seen, &mut order);
        let far = order[order.len() - 1];
        order.drain(begin..).for_each(|k| seen[k] = false);
        visit(far, &neighbours, &mut seen, &mut order);
    }
    order.reverse();
    order
}

/// Appends all individuals connected with `start` to `order`, breadth first.
fn visit(start: usize, neighbours: &[Vec<usize>], seen: &mut [bool], order: &mut Vec<usize>) {
    let mut next = order.len();
    order.push(start);
    seen[start] = true;
    while next < order.len() {
        for &k in &neighbours[order[next]] {
            if !seen[k] {
                seen[k] = true;
                order.push(k);
            }
        }
        next += 1;
    }
}

/// Returns the scalar product, summed in lanes.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a_blocks, a_rest) = a.as_chunks::<LANES>();
    let (b_blocks, b_rest) = b.as_chunks::<LANES>();
    let mut lanes = [0.0; LANES];
    for (a, b) in a_blocks.iter().zip(b_blocks) {
        for lane in 0..LANES {
            lanes[lane] += a[lane] * b[lane];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    (lanes[0] + lanes[1]) + (lanes[2] + lanes[3]) + rest
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::*;
    use crate::model::random::{Purpose, Stream};

    #[test]
    fn the_factor_solves_like_a_dense_factor() {
        let mut stream = Stream::new(1, 0, 0, Purpose::Start);
        for axes in [2, 3] {
            // Two rings without a common individual; individual 4 is in neither.
            let edges = [
                (0, 3),
                (3, 7),
                (5, 7),
                (0, 5),
                (0, 7),
                (1, 2),
                (2, 6),
                (1, 6),
                (1, 6),
            ];
            let mut envelope = Envelope::default();
            envelope.prepare(8, axes, &edges);
            let mut dense = DMatrix::<f64>::identity(24, 24);
            for &(i, j) in &edges {
                let parts = [0, 1].map(|_| [0, 1, 2].map(|_| stream.uniform() - 0.5));
                envelope.add(i, j, parts, 50.0);
                let mut b = DVector::zeros(24);
                for axis in 0..axes {
                    (b[3 * i + axis], b[3 * j + axis]) = (parts[0][axis], parts[1][axis]);
                }
                dense += 50.0 * &b * b.transpose();
            }
            envelope.factor();
            let mut vector: Vec<[f64; 3]> = (0..8)
                .map(|_| [0, 1, 2].map(|_| stream.uniform()))
                .collect();
            let expected = dense
                .cholesky()
                .unwrap()
                .solve(&DVector::from_vec(vector.concat()));
            envelope.solve(&mut vector);
            for (individual, solved) in vector.iter().enumerate() {
                for axis in 0..axes {
                    assert!((solved[axis] - expected[3 * individual + axis]).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn neighbours_stay_close_in_the_order() {
        // A strip of 3 × 40 with permuted indices: rows stay a few blocks long.
        let index = |column: usize, row: usize| (37 * (3 * column + row)) % 120;
        let mut edges = Vec::new();
        for column in 0..40 {
            for row in 0..3 {
                if column < 39 {
                    edges.push((index(column, row), index(column + 1, row)));
                }
                if row < 2 {
                    edges.push((index(column, row), index(column, row + 1)));
                }
            }
        }
        let mut envelope = Envelope::default();
        envelope.prepare(120, 1, &edges);
        assert!(envelope.values.len() < 120 * 6, "{}", envelope.values.len());
    }

    #[test]
    fn dot_sums_all_lanes() {
        let a: Vec<f64> = (0..11).map(f64::from).collect();
        assert_eq!(dot(&a, &a), 385.0);
    }
}
