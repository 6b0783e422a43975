//! Neighbours, clusters and the hull against plain computations over all pairs or triples.

use jostle_physics::model::State;

use crate::{states, value};

fn assert_value(name: &str, states: &[State], expected: f64) {
    let actual = value(&name.parse().unwrap(), states).unwrap();
    let difference = (actual - expected).abs();
    assert!(
        difference <= 1e-9 * expected.abs() + 1e-12,
        "{name}: {actual} {expected}"
    );
}

fn places(state: &State) -> Vec<[f64; 2]> {
    let columns = state.configuration.x.iter().zip(&state.configuration.y);
    columns.map(|(&x, &y)| [x, y]).collect()
}

fn minus(one: [f64; 2], other: [f64; 2]) -> [f64; 2] {
    [one[0] - other[0], one[1] - other[1]]
}

fn dot(one: [f64; 2], other: [f64; 2]) -> f64 {
    one[0] * other[0] + one[1] * other[1]
}

fn cross(one: [f64; 2], other: [f64; 2]) -> f64 {
    one[0] * other[1] - one[1] * other[0]
}

fn length(vector: [f64; 2]) -> f64 {
    dot(vector, vector).sqrt()
}

/// The surface gap of two capsules: from the crossing of their axes, or the four distances of an end
/// from the other axis.
fn gap(state: &State, i: usize, j: usize) -> f64 {
    let pi1 = state.parameters.pi1;
    let (radius, half) = (1.0 / (1.0 + pi1), (pi1 - 1.0) / (1.0 + pi1));
    let configuration = &state.configuration;
    let axis = |k: usize| {
        let (sin, cos) = libm::sincos(configuration.alpha[k]);
        [-half, half].map(|at| [configuration.x[k] + at * cos, configuration.y[k] + at * sin])
    };
    let (one, other) = (axis(i), axis(j));
    let sides = |[a, b]: [[f64; 2]; 2], point| cross(minus(b, a), minus(point, a));
    let separates =
        |line, points: [[f64; 2]; 2]| sides(line, points[0]) * sides(line, points[1]) < 0.0;
    if separates(one, other) && separates(other, one) {
        return -2.0 * radius;
    }
    let to_axis = |point: [f64; 2], [a, b]: [[f64; 2]; 2]| {
        let along = minus(b, a);
        let squared = dot(along, along);
        let share = match squared > 0.0 {
            true => (dot(minus(point, a), along) / squared).clamp(0.0, 1.0),
            false => 0.0,
        };
        length(minus(
            point,
            [a[0] + share * along[0], a[1] + share * along[1]],
        ))
    };
    let distances = [
        to_axis(one[0], other),
        to_axis(one[1], other),
        to_axis(other[0], one),
        to_axis(other[1], one),
    ];
    distances.into_iter().fold(f64::INFINITY, f64::min) - 2.0 * radius
}

/// The five quantiles by numpy's definition: the value at the place `share (n - 1)`, between two values
/// in proportion.
fn assert_quantiles(family: &str, states: &[State], mut values: Vec<f64>) {
    values.sort_by(f64::total_cmp);
    for (name, percent) in [
        ("median", 50),
        ("q05", 5),
        ("q25", 25),
        ("q75", 75),
        ("q95", 95),
    ] {
        let hundredths = percent * (values.len() - 1);
        let (below, rest) = (hundredths / 100, (hundredths % 100) as f64 / 100.0);
        let above = (below + 1).min(values.len() - 1);
        let expected = (1.0 - rest) * values[below] + rest * values[above];
        assert_value(&format!("{family}.{name}"), states, expected);
    }
}

/// The sizes of clusters by spreading the least label until nothing changes.
fn cluster_sizes(state: &State, largest_gap: f64) -> Vec<usize> {
    let n = state.configuration.n();
    let mut label: Vec<usize> = (0..n).collect();
    loop {
        let before = label.clone();
        for i in 0..n {
            for j in 0..n {
                if i != j && gap(state, i, j) <= largest_gap {
                    label[i] = label[i].min(label[j]);
                }
            }
        }
        if label == before {
            break;
        }
    }
    let sizes = (0..n).map(|label_of| label.iter().filter(|&&it| it == label_of).count());
    sizes.filter(|&size| size > 0).collect()
}

/// The area of the convex hull: a side has all other points on its left.
fn hull_area(places: &[[f64; 2]]) -> f64 {
    let mut twice = 0.0;
    for &a in places {
        for &b in places {
            let is_left = |&point: &[f64; 2]| cross(minus(b, a), minus(point, a)) >= 0.0;
            if a != b && places.iter().all(is_left) {
                twice += cross(minus(a, places[0]), minus(b, places[0]));
            }
        }
    }
    twice / 2.0
}

#[test]
fn measures_agree_with_plain_computations() {
    for (n, pi1, seed) in [
        (2, 4.0, 1),
        (3, 4.0, 1),
        (50, 4.0, 2),
        (50, 1.0, 3),
        (70, 12.0, 4),
        (180, 4.0, 5),
    ] {
        let mut states = states(n, pi1, seed);
        // Also with overlapping and crossed bodies, and with individuals far from the others.
        for squeeze in [1.0, 0.5, 0.02] {
            let last = states.last_mut().unwrap();
            for (index, (x, y)) in (last.configuration.x.iter_mut())
                .zip(&mut last.configuration.y)
                .enumerate()
            {
                (*x, *y) = (*x * squeeze, *y * squeeze);
                if squeeze == 0.5 && index % 16 == 5 {
                    (*x, *y) = (*x * 40.0, *y * 40.0);
                }
            }
            let last = last.clone();
            let others = |i: usize| (0..n).filter(move |&j| j != i);
            let places = places(&last);
            let nearest = |i: usize| {
                let distances = others(i).map(|j| length(minus(places[j], places[i])));
                distances.fold(f64::INFINITY, f64::min)
            };
            let smallest = |i: usize| {
                let gaps = others(i).map(|j| gap(&last, i, j));
                gaps.fold(f64::INFINITY, f64::min)
            };
            assert_quantiles("neighbour_distance", &states, (0..n).map(nearest).collect());
            assert_quantiles("neighbour_gap", &states, (0..n).map(smallest).collect());
            assert_value("spread", &states, hull_area(&places));
            for (argument, largest_gap) in
                [("", 1e-3), ("(0)", 0.0), ("(0.25)", 0.25), ("(2)", 2.0)]
            {
                let name = |name: &str| format!("{name}{argument}");
                let sizes = cluster_sizes(&last, largest_gap);
                assert_value(&name("clusters.count"), &states, sizes.len() as f64);
                let largest = *sizes.iter().max().unwrap();
                assert_value(&name("clusters.largest"), &states, largest as f64);
                let squares: usize = sizes.iter().map(|size| size * size).sum();
                assert_value(&name("clusters.n_eff"), &states, squares as f64 / n as f64);
                let touching = |i: usize| {
                    others(i)
                        .filter(|&j| gap(&last, i, j) <= largest_gap)
                        .count()
                };
                let contacts: usize = (0..n).map(touching).sum();
                assert_value(
                    &name("contacts_per_body"),
                    &states,
                    contacts as f64 / n as f64,
                );
            }
        }
    }
}
