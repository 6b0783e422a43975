//! Groups of no, one or two individuals, at one point or on a line: each measure is finite or undefined.

use jostle_measures::{Past, View};
use jostle_physics::model::State;

use crate::{measures, value};

/// Two states of individuals at these positions, one step apart; every third is informed.
fn resting(places: &[[f64; 2]], pi1: f64) -> [State; 2] {
    let mut state = State::default();
    state.parameters.pi1 = pi1;
    for (index, &[x, y]) in places.iter().enumerate() {
        state.configuration.push(x, y, index as f64);
        if index % 3 == 0 {
            state.configuration.inform(index, 0.5, 1.0, None);
        }
    }
    let mut next = state.clone();
    next.step += 1;
    [state, next]
}

/// Returns the names of the measures that are undefined for a group.
fn undefined(places: &[[f64; 2]]) -> Vec<String> {
    let mut names = Vec::new();
    for pi1 in [1.0, 4.0] {
        names.clear();
        for measure in measures() {
            match value(&measure, &resting(places, pi1)) {
                Some(value) => assert!(value.is_finite(), "{measure} {places:?}"),
                None => names.push(measure.to_string()),
            }
        }
    }
    names
}

#[test]
fn an_empty_group_has_no_measure() {
    assert_eq!(undefined(&[]).len(), measures().len());
}

#[test]
fn a_single_individual_has_no_neighbour_and_no_rank() {
    let needs_two = |name: &&String| name.starts_with("neighbour") || *name == "front";
    let names = undefined(&[[3.0, 4.0]]);
    assert_eq!(names.iter().filter(needs_two).count(), 11);
    // The only individual is informed; and there is no state 0.5 time units before.
    let others: Vec<_> = names.iter().filter(|name| !needs_two(name)).collect();
    assert_eq!(others, ["speed.others", "msd(0.5)"]);
}

#[test]
fn duplicates_and_lines_define_every_measure() {
    let two = [[0.0, 0.0], [1.0, 0.0]];
    let line: Vec<[f64; 2]> = (0..300)
        .map(f64::from)
        .map(|k| [0.1 * k, 0.3 * k])
        .collect();
    let exact_line: Vec<[f64; 2]> = (0..300).map(f64::from).map(|k| [k, -2.0 * k]).collect();
    let copies: Vec<[f64; 2]> = (0..200)
        .map(|k| [f64::from(k % 4), f64::from(k % 3)])
        .collect();
    for places in [
        &two[..],
        &[[0.3, 0.7]; 2],
        &[[0.3, 0.7]; 300],
        &line,
        &exact_line,
        &copies,
    ] {
        assert_eq!(
            undefined(places),
            ["msd(0.5)"],
            "{} {:?}",
            places.len(),
            places[0]
        );
    }
}

#[test]
fn positions_on_a_line_have_exact_neighbours_and_no_area() {
    let line: Vec<[f64; 2]> = (0..300)
        .map(f64::from)
        .map(|k| [3.0 * k, -4.0 * k])
        .collect();
    let states = resting(&line, 1.0);
    let value = |name: &str| value(&name.parse().unwrap(), &states);
    assert_eq!(value("neighbour_distance.q05"), Some(5.0));
    assert_eq!(value("neighbour_gap.q95"), Some(4.0));
    assert_eq!(value("spread"), Some(0.0));
    assert_eq!(value("clusters.count"), Some(300.0));
}

#[test]
fn coordinates_that_are_not_finite_leave_measures_undefined() {
    for bad in [f64::NAN, f64::INFINITY] {
        let [mut before, mut after] = resting(&[[0.0, 0.0], [1.0, 2.0], [4.0, 1.0]], 4.0);
        before.configuration.x[1] = bad;
        after.configuration.alpha[0] = bad;
        for state in [&before, &after] {
            let past = Past::new(0);
            let view = View::new(state, &past);
            for measure in measures() {
                let value = measure.evaluate(&view);
                assert!(value.is_none_or(f64::is_finite), "{measure} {value:?}");
            }
        }
    }
}
