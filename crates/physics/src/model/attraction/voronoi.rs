//! Neighbours in the Voronoi diagram: points whose cells share an edge of positive length.
//!
//! The dual, the Delaunay triangulation, is not unique if four or more points are on an empty
//! circle: their cells then meet in one point, and the diagonal that the triangulation draws is
//! arbitrary. Such diagonals are left out, so that neighbours depend on the positions alone.

use robust::{Coord, incircle};
use spade::handles::DirectedEdgeHandle;
use spade::{DelaunayTriangulation, HasPosition, Point2, Triangulation};

use super::local_laws;
use crate::model::Configuration;

/// A point with at least one individual, identified by the lowest index there.
#[derive(Clone, Copy, Debug)]
struct Site {
    at: [f64; 2],
    first: usize,
}

impl HasPosition for Site {
    type Scalar = f64;

    fn position(&self) -> Point2<f64> {
        Point2::new(self.at[0], self.at[1])
    }
}

/// Computes the mean over all neighbours, individuals at the same point included.
pub(super) fn voronoi(configuration: &Configuration, pull: &mut [[f64; 2]]) {
    let members = members(configuration);
    let mut neighbours = vec![Vec::new(); pull.len()];
    let mut join = |one: &[usize], other: &[usize]| {
        for &member in one {
            let others = other.iter().copied().filter(|&it| it != member);
            neighbours[member].extend(others);
        }
    };
    for here in &members {
        join(here, here);
    }
    for [one, other] in edges(configuration, &members) {
        join(&members[one], &members[other]);
        join(&members[other], &members[one]);
    }
    for (one, (pull, neighbours)) in pull.iter_mut().zip(&mut neighbours).enumerate() {
        // Sums follow the order of individuals, not that of the triangles.
        neighbours.sort_unstable();
        *pull = local_laws::mean(configuration, one, neighbours.iter().copied());
    }
}

/// Coordinates nearer to 0 than this count as 0: the exact predicates do not support them.
const SMALLEST: f64 = spade::MIN_ALLOWED_VALUE;

/// Returns the position of individual `index`; -0 becomes 0.
fn place(configuration: &Configuration, index: usize) -> [f64; 2] {
    let coordinates = [configuration.x[index], configuration.y[index]];
    coordinates.map(|value| if value.abs() < SMALLEST { 0.0 } else { value })
}

/// Returns the individuals at each point, in the list of the lowest index there; the other lists
/// are empty.
fn members(configuration: &Configuration) -> Vec<Vec<usize>> {
    let n = configuration.n();
    let places: Vec<[f64; 2]> = (0..n).map(|index| place(configuration, index)).collect();
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&a, &b| {
        let along = places[a][0].total_cmp(&places[b][0]);
        let up = places[a][1].total_cmp(&places[b][1]);
        along.then(up).then(a.cmp(&b))
    });
    let mut members = vec![Vec::new(); n];
    for here in order.chunk_by(|&a, &b| places[a] == places[b]) {
        members[here[0]] = here.to_vec();
    }
    members
}

/// Returns the pairs of points whose cells share an edge of positive length, by the lowest index
/// at each point.
fn edges(configuration: &Configuration, members: &[Vec<usize>]) -> Vec<[usize; 2]> {
    let firsts = (0..members.len()).filter(|&index| !members[index].is_empty());
    let sites = firsts.map(|first| Site {
        at: place(configuration, first),
        first,
    });
    // This fails only for coordinates that spade rejects: NaN, too large, or too small. `place`
    // replaces those that are too small by 0.
    let Ok(triangulation) = DelaunayTriangulation::<Site>::bulk_load_stable(sites.collect()) else {
        return Vec::new();
    };
    let edges = triangulation.directed_edges();
    let drawn_once = edges.filter(|edge| edge.from().data().first < edge.to().data().first);
    let shared = drawn_once.filter(|&edge| !is_diagonal(edge));
    shared
        .map(|edge| [edge.from().data().first, edge.to().data().first])
        .collect()
}

/// Returns whether the four corners of an edge's two triangles are on one circle.
fn is_diagonal(edge: DirectedEdgeHandle<'_, Site, (), (), ()>) -> bool {
    let corner = |edge: DirectedEdgeHandle<'_, Site, (), (), ()>| {
        edge.opposite_vertex().map(|vertex| vertex.data().at)
    };
    let (Some(left), Some(right)) = (corner(edge), corner(edge.rev())) else {
        return false;
    };
    let [from, to, left, right] =
        [edge.from().data().at, edge.to().data().at, left, right].map(|[x, y]| Coord { x, y });
    incircle(from, to, left, right) == 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn neighbours(places: &[[f64; 2]]) -> Vec<[usize; 2]> {
        let mut configuration = Configuration::default();
        for [x, y] in places {
            configuration.push(*x, *y, 0.0);
        }
        let mut edges = edges(&configuration, &members(&configuration));
        edges.sort_unstable();
        edges
    }

    #[test]
    fn on_a_line_neighbours_are_next_to_each_other() {
        assert_eq!(neighbours(&[[0.0, 0.0]]), [[0usize; 2]; 0]);
        assert_eq!(neighbours(&[[0.0, 0.0], [1.0, 3.0]]), [[0, 1]]);
        let line = [[3.0, 1.5], [1.0, 0.5], [0.0, 0.0], [2.0, 1.0]];
        assert_eq!(neighbours(&line), [[0, 3], [1, 2], [1, 3]]);
    }

    #[test]
    fn a_square_has_no_diagonal_edges_and_a_rhombus_has_the_short_one() {
        let square = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        assert_eq!(neighbours(&square), [[0, 1], [0, 3], [1, 2], [2, 3]]);
        let rhombus = [[0.0, 0.0], [1.0, -0.5], [2.0, 0.0], [1.0, 0.5]];
        let sides = [[0, 1], [0, 3], [1, 2], [1, 3], [2, 3]];
        assert_eq!(neighbours(&rhombus), sides);
    }

    #[test]
    fn a_grid_has_no_diagonal_edges() {
        let grid: Vec<[f64; 2]> = (0..9)
            .map(|k| [f64::from(k % 3), f64::from(k / 3)])
            .collect();
        let found = neighbours(&grid);
        assert_eq!(found.len(), 12);
        for [one, other] in found {
            let (dx, dy) = (grid[one][0] - grid[other][0], grid[one][1] - grid[other][1]);
            assert_eq!(dx.abs() + dy.abs(), 1.0);
        }
    }

    #[test]
    fn coordinates_nearer_to_zero_than_the_smallest_are_zero() {
        let places = [[0.0, 2.0], [-0.0, 0.0], [0.0, 0.0], [1e-60, -1e-60]];
        assert_eq!(neighbours(&places), [[0, 1]]);
    }
}
