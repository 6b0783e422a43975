//! The positions of a group as a Delaunay triangulation: nearest neighbours and the convex hull.
//!
//! Individuals at one point share a vertex. The nearest other vertex of a vertex is adjacent to it.
//! From each vertex a path of edges leads to any given one on which the distance to the latter
//! decreases (Bose and Morin, SIAM J. Comput. 33, 937 (2004)). So a search along edges that always
//! continues at the nearest vertex finds all vertices in the order of their distance.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::ops::Range;

use jostle_physics::model::Configuration;
use spade::handles::{FixedVertexHandle, VertexHandle};
use spade::{DelaunayTriangulation, Point2, Triangulation};

/// Coordinates nearer to 0 than this count as 0: the exact predicates do not support them.
const SMALLEST: f64 = spade::MIN_ALLOWED_VALUE;

/// The triangulation of all positions, and the individuals at each vertex.
#[derive(Clone, Debug)]
pub(crate) struct Positions {
    triangulation: DelaunayTriangulation<Point2<f64>>,
    /// Indices of the individuals, those at one point next to each other.
    order: Vec<usize>,
    /// The range of each vertex in `order`.
    members: Vec<Range<usize>>,
}

/// The buffers of a search, which many searches share.
pub(crate) struct Search {
    /// The number of searches so far.
    number: usize,
    /// For each vertex the number of the last search that has reached it, from 1; 0 for none.
    reached_by: Vec<usize>,
    /// Squared distances, as bits: those of numbers from 0 on are ordered like the numbers.
    queue: BinaryHeap<Reverse<(u64, usize)>>,
}

impl Positions {
    /// Triangulates; `None` if a coordinate is not finite or beyond 1e60.
    pub fn new(configuration: &Configuration) -> Option<Self> {
        let Configuration { x, y, .. } = configuration;
        let normal = |value: f64| if value.abs() < SMALLEST { 0.0 } else { value };
        let place = |index: usize| [normal(x[index]), normal(y[index])];
        let mut order: Vec<usize> = (0..configuration.n()).collect();
        order.sort_by(|&one, &other| {
            let [one, other] = [place(one), place(other)];
            one[0]
                .total_cmp(&other[0])
                .then(one[1].total_cmp(&other[1]))
        });
        let (mut points, mut members, mut start) = (Vec::new(), Vec::new(), 0);
        for here in order.chunk_by(|&one, &other| place(one) == place(other)) {
            let [x, y] = place(here[0]);
            points.push(Point2::new(x, y));
            members.push(start..start + here.len());
            start += here.len();
        }
        // No two points are equal, so the vertices are in the order of the points.
        let triangulation = DelaunayTriangulation::bulk_load_stable(points).ok()?;
        Some(Self {
            triangulation,
            order,
            members,
        })
    }

    fn vertex(&self, index: usize) -> VertexHandle<'_, Point2<f64>> {
        self.triangulation
            .vertex(FixedVertexHandle::from_index(index))
    }

    /// Returns the number of vertices.
    pub fn vertices(&self) -> usize {
        self.members.len()
    }

    /// Returns the individuals at a vertex.
    pub fn members(&self, vertex: usize) -> &[usize] {
        &self.order[self.members[vertex].clone()]
    }

    /// Returns for each individual the distance to the nearest other one, in body sizes; infinity if
    /// there is no other.
    pub fn nearest_distances(&self) -> Vec<f64> {
        let mut distances = vec![0.0; self.order.len()];
        for vertex in 0..self.vertices() {
            if let [alone] = *self.members(vertex) {
                let here = self.vertex(vertex);
                let others = here.out_edges().map(|edge| edge.to().position());
                let squares = others.map(|other| squared_distance(here.position(), other));
                distances[alone] = squares.fold(f64::INFINITY, f64::min).sqrt();
            }
        }
        distances
    }

    /// Visits the vertices by ascending distance from the vertex `from`, which is the first, until
    /// `visit` returns false. Its arguments are a distance, in body sizes, and the individuals there.
    pub fn outwards(
        &self,
        from: usize,
        search: &mut Search,
        mut visit: impl FnMut(f64, &[usize]) -> bool,
    ) {
        let centre = self.vertex(from).position();
        let Search {
            number,
            reached_by,
            queue,
        } = search;
        *number += 1;
        queue.clear();
        queue.push(Reverse((0, from)));
        reached_by[from] = *number;
        while let Some(Reverse((square, vertex))) = queue.pop() {
            if !visit(f64::from_bits(square).sqrt(), self.members(vertex)) {
                return;
            }
            for edge in self.vertex(vertex).out_edges() {
                let next = edge.to();
                if reached_by[next.index()] != *number {
                    reached_by[next.index()] = *number;
                    let square = squared_distance(centre, next.position());
                    queue.push(Reverse((square.to_bits(), next.index())));
                }
            }
        }
    }

    /// Returns the area of the convex hull, in squared body sizes; 0 if all positions are on a line.
    pub fn hull_area(&self) -> f64 {
        if self.triangulation.all_vertices_on_line() {
            return 0.0;
        }
        let mut corners = self.triangulation.convex_hull().map(|edge| edge.from());
        let Some(first) = corners.next() else {
            return 0.0;
        };
        let first = first.position();
        let (mut twice, mut before) = (0.0, [0.0, 0.0]);
        for corner in corners {
            let corner = corner.position();
            let corner = [corner.x - first.x, corner.y - first.y];
            twice += before[0] * corner[1] - before[1] * corner[0];
            before = corner;
        }
        // The corners are in clockwise order.
        twice.abs() / 2.0
    }
}

impl Search {
    /// Creates the buffers for searches in `positions`.
    pub fn new(positions: &Positions) -> Self {
        Self {
            number: 0,
            reached_by: vec![0; positions.vertices()],
            queue: BinaryHeap::new(),
        }
    }
}

fn squared_distance(one: Point2<f64>, other: Point2<f64>) -> f64 {
    let (dx, dy) = (other.x - one.x, other.y - one.y);
    dx * dx + dy * dy
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::testing::discs;

    fn outwards(places: &[[f64; 2]], from: [f64; 2], distance: f64) -> Vec<(f64, usize)> {
        let configuration = discs(places).configuration;
        let positions = Positions::new(&configuration).unwrap();
        let is_at = |&vertex: &usize| {
            let first = positions.members(vertex)[0];
            [configuration.x[first], configuration.y[first]] == from
        };
        let from = (0..positions.vertices()).find(is_at).unwrap();
        let (mut found, mut search) = (Vec::new(), Search::new(&positions));
        // The second search must not depend on the first.
        for _ in 0..2 {
            found.clear();
            positions.outwards(from, &mut search, |at, members| {
                found.push((at, members.len()));
                at < distance
            });
        }
        found
    }

    #[test]
    fn a_search_visits_a_grid_by_distance_and_stops() {
        let grid: Vec<[f64; 2]> = (0..49)
            .map(|k| [f64::from(k % 7), f64::from(k / 7)])
            .collect();
        let found = outwards(&grid, [3.0, 3.0], 2.0);
        let expected = [[0.0; 1].as_slice(), &[1.0; 4], &[2.0f64.sqrt(); 4], &[2.0]].concat();
        assert_eq!(
            found,
            expected.iter().map(|&at| (at, 1)).collect::<Vec<_>>()
        );
        assert_eq!(outwards(&grid, [0.0, 0.0], 99.0).len(), 49);
    }

    #[test]
    fn individuals_at_one_point_are_visited_together() {
        let line = [
            [2.0, 0.0],
            [0.0, 0.0],
            [5.0, 0.0],
            [-0.0, 0.0],
            [1e-60, 0.0],
        ];
        assert_eq!(
            outwards(&line, [2.0, 0.0], 9.0),
            [(0.0, 1), (2.0, 3), (3.0, 1)]
        );
        assert_eq!(outwards(&[[1.0, 1.0]; 3], [1.0, 1.0], 9.0), [(0.0, 3)]);
    }

    #[test]
    fn coordinates_that_are_not_finite_have_no_triangulation() {
        assert!(Positions::new(&discs(&[[0.0, f64::NAN]]).configuration).is_none());
        assert!(Positions::new(&discs(&[]).configuration).is_some());
    }
}
