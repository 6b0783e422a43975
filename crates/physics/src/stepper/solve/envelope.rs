//! Cholesky factors of symmetric matrices whose graph is almost planar.
//!
//! Individuals are ordered breadth first, so that neighbours stay close, and every row is kept
//! from its first entry on. A packed group of n costs about `n · (√n)²` instead of n³.

/// Sums run side by side in so many lanes, so that the compiler may use vector registers
/// without changing the order of any sum.
const LANES: usize = 4;

/// A positive definite matrix of `axes` × `axes` blocks, then its factor.
#[derive(Clone, Debug, Default)]
pub struct Envelope {
    axes: usize,
    /// The place of each individual in the order; none if it is not in the matrix.
    place: Vec<Option<usize>>,
    /// First column and start in `values` of each row.
    rows: Vec<(usize, usize)>,
    values: Vec<f64>,
}

impl Envelope {
    /// Prepares the unit matrix over the individuals that `edges` name.
    ///
    /// - Shapes: `n` individuals in all, edges (i, j) with i < j in any order.
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

    /// Adds `factor b bᵀ`, where `b` has the entries `parts` at individuals `i` and `j`.
    pub fn add(&mut self, i: usize, j: usize, parts: [[f64; 3]; 2], factor: f64) {
        let rows =
            [i, j].map(|individual| self.axes * self.place[individual].expect("named by an edge"));
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
            // Never below the unit matrix it began as, but for rounding.
            let pivot = (diagonal - dot(left, left)).max(1.0).sqrt();
            self.values[start + row - first] = pivot;
        }
    }

    /// Solves for the right-hand side `vector`, three entries an individual, with the factor.
    /// Entries of individuals not in the matrix are left alone.
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

    fn each(&self, mut visit: impl FnMut(usize, usize, usize)) {
        for (individual, place) in self.place.iter().enumerate() {
            let Some(place) = place else { continue };
            (0..self.axes).for_each(|axis| visit(individual, axis, self.axes * place + axis));
        }
    }

    fn places(&self, i: usize, j: usize) -> (usize, usize) {
        let [a, b] = [i, j].map(|individual| self.place[individual].expect("named by an edge"));
        (a.min(b), a.max(b))
    }

    fn entry(&mut self, row: usize, column: usize) -> &mut f64 {
        let (first, start) = self.rows[row];
        &mut self.values[start + column - first]
    }
}

/// Orders all individuals that `edges` name so that neighbours are near: breadth first from the
/// outskirts, turned round (the reverse Cuthill-McKee order). Ties go to the lower index.
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
        // The last one reached is on the far side, a better place to begin.
        let begin = order.len();
        visit(start, &neighbours, &mut seen, &mut order);
        let far = order[order.len() - 1];
        order.drain(begin..).for_each(|k| seen[k] = false);
        visit(far, &neighbours, &mut seen, &mut order);
    }
    order.reverse();
    order
}

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
    fn the_factor_solves_what_a_dense_one_solves() {
        let mut stream = Stream::new(1, 0, 0, Purpose::Start);
        for axes in [2, 3] {
            // Two rings that do not meet, and individual 4 in neither.
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
        // A strip of 3 × 40, named in a scrambled way: rows stay a few blocks long.
        let name = |column: usize, row: usize| (37 * (3 * column + row)) % 120;
        let mut edges = Vec::new();
        for column in 0..40 {
            for row in 0..3 {
                if column < 39 {
                    edges.push((name(column, row), name(column + 1, row)));
                }
                if row < 2 {
                    edges.push((name(column, row), name(column, row + 1)));
                }
            }
        }
        let mut envelope = Envelope::default();
        envelope.prepare(120, 1, &edges);
        assert!(envelope.values.len() < 120 * 6, "{}", envelope.values.len());
    }

    #[test]
    fn lanes_add_up() {
        let a: Vec<f64> = (0..11).map(f64::from).collect();
        assert_eq!(dot(&a, &a), 385.0);
    }
}
