//! All pairs of points nearer than a distance. The time grows with the number of points and of
//! neighbours, not with the extent of the points.

use super::simd::{Lanes, Level, WIDTH, multiversion};

/// Up to this number of points comparing all pairs is faster than sorting into cells.
const FEW: usize = 160;

/// Cells are wider than the distance by this factor, so that rounding moves no point beyond a
/// neighbouring cell. It suffices up to a billion distances from the origin.
const MARGIN: f64 = 1.0 + 1e-6;

/// Finds pairs, and reuses its buffers from one search to the next.
///
/// The plane is wrapped onto a square of cells, so coordinates may have any size. Points that are
/// far apart may share a cell, which costs time and does not change the result.
#[derive(Clone, Debug, Default)]
pub struct PairSearch {
    /// Selects the version of the kernels; it changes no bit.
    pub level: Level,
    /// The cell of every point.
    cell: Vec<u32>,
    /// Start of each cell in `order`, and the end of the last cell.
    start: Vec<u32>,
    /// Indices and coordinates of the points, ordered by cell, then by index.
    order: Vec<(u32, [f64; 2])>,
    /// Partners of the current point.
    partners: Vec<u32>,
}

impl PairSearch {
    /// Visits all pairs of points nearer than `distance`, i < j, ordered by i. [`order`] sorts
    /// the pairs that the caller keeps by (i, j).
    pub fn visit(&mut self, x: &[f64], y: &[f64], distance: f64, visit: impl FnMut(u32, u32)) {
        if x.len() <= FEW {
            all_with_all(self.level, x, y, distance, visit);
        } else {
            self.cell_by_cell(x, y, distance, visit);
        }
    }

    fn cell_by_cell(
        &mut self,
        x: &[f64],
        y: &[f64],
        distance: f64,
        mut visit: impl FnMut(u32, u32),
    ) {
        let side = self.sort(x, y, 1.0 / (distance * MARGIN));
        let near = distance * distance;
        for (i, (&xi, &yi)) in (0u32..).zip(x.iter().zip(y)) {
            let mut count = 0;
            let [column, row] = [self.cell[i as usize] / side, self.cell[i as usize] % side];
            // No sum can overflow: there are fewer cells than 2³¹.
            let rows = match row {
                row if row == 0 || row == side - 1 => {
                    [row + side - 1, row, row + 1].map(|row| row % side..row % side + 1)
                }
                // Neighbouring cells of a column are adjacent in `order` as well.
                row => [row - 1..row + 2, 0..0, 0..0],
            };
            for column in [column + side - 1, column, column + 1] {
                let first = column % side * side;
                for rows in &rows {
                    let [from, to] = [rows.start, rows.end]
                        .map(|row| self.start[(first + row) as usize] as usize);
                    let members = &self.order[from..to];
                    if self.partners.len() < count + members.len() {
                        self.partners.resize(count + members.len(), 0);
                    }
                    // The result of the comparison is unpredictable, so a branch would be slow.
                    // Every member is written; the next one overwrites it unless it is near.
                    for &(j, [xj, yj]) in members {
                        let (dx, dy) = (xj - xi, yj - yi);
                        self.partners[count] = j;
                        count += usize::from((dx * dx + dy * dy < near) & (j > i));
                    }
                }
            }
            self.partners[..count].iter().for_each(|&j| visit(i, j));
        }
    }

    /// Sorts the points into about as many cells as points, at least four by four so that the
    /// neighbours of a cell are distinct; returns the number of cells on a side.
    fn sort(&mut self, x: &[f64], y: &[f64], per_length: f64) -> u32 {
        let count = u32::try_from(x.len()).expect("indices fit 32 bits");
        let side = count.isqrt().next_power_of_two().clamp(4, 1 << 15);
        self.cell.clear();
        let places = x.iter().zip(y);
        self.cell.extend(
            places.map(|(&x, &y)| {
                wrapped(x * per_length, side) * side + wrapped(y * per_length, side)
            }),
        );
        self.start.clear();
        self.start.resize((side * side) as usize + 1, 0);
        for &cell in &self.cell {
            self.start[cell as usize] += 1;
        }
        let mut sum = 0;
        for start in &mut self.start {
            sum += *start;
            *start = sum;
        }
        // Each point decrements the start of its cell, which ends at the cell's first entry. The
        // last point comes first, so that a cell is ordered by index.
        self.order.resize(x.len(), (0, [0.0; 2]));
        for index in (0..count).rev() {
            let point = index as usize;
            let start = &mut self.start[self.cell[point] as usize];
            *start -= 1;
            self.order[*start as usize] = (index, [x[point], y[point]]);
        }
        side
    }
}

/// Returns a coordinate rounded down, modulo `side`, a power of two.
fn wrapped(coordinate: f64, side: u32) -> u32 {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a cast saturates, and only the last bits count"
    )]
    let towards_zero = coordinate as i64;
    let below = towards_zero.wrapping_sub(i64::from(coordinate < towards_zero as f64));
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "only the last bits count"
    )]
    let last_bits = below as u32;
    last_bits & (side - 1)
}

multiversion! {
    /// Sets in `found` one bit for each of `others` whose squared distance to the point `at` is
    /// below `near`.
    ///
    /// - Shapes: one block of lanes of `others` for each entry of `found`.
    fn mark(level, at: [f64; 2], others: [&[Lanes]; 2], near: f64, found: &mut [u64]) {
        for ((x, y), found) in others[0].iter().zip(others[1]).zip(found) {
            let mut bits = [0; WIDTH];
            for lane in 0..WIDTH {
                let (dx, dy) = (x[lane] - at[0], y[lane] - at[1]);
                bits[lane] = if dx * dx + dy * dy < near { 1u64 << lane } else { 0 };
            }
            *found = bits.into_iter().fold(0, |all, bit| all | bit);
        }
    }
}

fn all_with_all(
    level: Level,
    x: &[f64],
    y: &[f64],
    distance: f64,
    mut visit: impl FnMut(u32, u32),
) {
    let near = distance * distance;
    for (i, (&xi, &yi)) in (0u32..).zip(x.iter().zip(y)) {
        let others = i as usize + 1..;
        let (x_blocks, x_rest) = x[others.clone()].as_chunks();
        let (y_blocks, y_rest) = y[others].as_chunks();
        let mut found = [0; FEW / WIDTH];
        let found = &mut found[..x_blocks.len()];
        mark(level, [xi, yi], [x_blocks, y_blocks], near, found);
        let mut blocks = (i + 1..).step_by(WIDTH);
        for (&mut mut found, first) in found.iter_mut().zip(&mut blocks) {
            while found != 0 {
                visit(i, first + found.trailing_zeros());
                found &= found - 1;
            }
        }
        let rest = blocks.next().expect("the range of indices is unbounded")..;
        for (j, (&xj, &yj)) in rest.zip(x_rest.iter().zip(y_rest)) {
            let (dx, dy) = (xj - xi, yj - yi);
            if dx * dx + dy * dy < near {
                visit(i, j);
            }
        }
    }
}

/// Finds all pairs of points nearer than `distance`, ordered by (i, j), i < j.
#[must_use]
pub fn pairs_within(x: &[f64], y: &[f64], distance: f64) -> Vec<(u32, u32)> {
    let mut pairs = Vec::new();
    PairSearch::default().visit(x, y, distance, |i, j| pairs.push((i, j)));
    order(&mut pairs);
    pairs
}

/// Sorts pairs by (i, j); the pairs must be ordered by i.
pub fn order(pairs: &mut [(u32, u32)]) {
    for of_one in pairs.chunk_by_mut(|one, other| one.0 == other.0) {
        of_one.sort_unstable();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::random::{Purpose, Stream};

    fn brute_force(x: &[f64], y: &[f64], distance: f64) -> Vec<(u32, u32)> {
        let mut all = Vec::new();
        for i in 0..x.len() {
            for j in i + 1..x.len() {
                let (dx, dy) = (x[j] - x[i], y[j] - y[i]);
                if dx * dx + dy * dy < distance * distance {
                    all.push((u32::try_from(i).unwrap_or(0), u32::try_from(j).unwrap_or(0)));
                }
            }
        }
        all
    }

    #[test]
    fn both_searches_agree_with_brute_force() {
        let mut stream = Stream::new(1, 0, 0, Purpose::Start);
        let mut search = PairSearch::default();
        for (n, width) in [
            (0, 1.0),
            (1, 1.0),
            (2, 1.0),
            (9, 2.0),
            (160, 9.0),
            (161, 9.0),
        ] {
            for (grain, centre) in [(0.25, 0.0), (1e-9, 0.0), (0.25, -1e6), (1e-9, 1e6)] {
                // Coarse grains give coincident points and pairs at exactly the distance.
                let mut draw = |_| centre + grain * libm::floor(width / grain * stream.uniform());
                let x: Vec<f64> = (0..n).map(&mut draw).collect();
                let y: Vec<f64> = (0..n).map(&mut draw).collect();
                for distance in [0.25, 1.0, 3.0] {
                    let mut found = Vec::new();
                    search.visit(&x, &y, distance, |i, j| found.push((i, j)));
                    order(&mut found);
                    assert_eq!(
                        found,
                        brute_force(&x, &y, distance),
                        "{n} {centre} {distance}"
                    );
                    assert!(n < 160 || !found.is_empty());
                    let mut found = Vec::new();
                    search.cell_by_cell(&x, &y, distance, |i, j| found.push((i, j)));
                    order(&mut found);
                    assert_eq!(
                        found,
                        brute_force(&x, &y, distance),
                        "{n} {centre} {distance}"
                    );
                }
            }
        }
    }

    #[test]
    fn cells_find_the_pairs_of_a_thousand_scattered_points() {
        let mut stream = Stream::new(2, 0, 0, Purpose::Start);
        // A dense group, a sparse one around it, and a few points so far away that they are
        // wrapped onto both.
        let mut draw = |k: usize| {
            let width = [20.0, 200.0, 2e6][usize::from(k > 500) + usize::from(k > 990)];
            width * (stream.uniform() - 0.5)
        };
        let x: Vec<f64> = (0..1000).map(&mut draw).collect();
        let y: Vec<f64> = (0..1000).map(&mut draw).collect();
        assert_eq!(pairs_within(&x, &y, 1.7), brute_force(&x, &y, 1.7));
    }

    #[test]
    fn non_finite_points_have_no_neighbours() {
        let mut x = vec![0.0; 200];
        x[3] = f64::NAN;
        x[5] = f64::INFINITY;
        assert_eq!(pairs_within(&x, &[0.0; 200], 1.0).len(), 198 * 197 / 2);
    }
}
