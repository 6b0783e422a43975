//! No measure depends on where the group is, on its direction as a whole or on the numbering.

use jostle_physics::model::State;

use jostle_measures::histograms::{hull_area, neighbour_density, pair_correlation};

use crate::{measures, states, value};

/// Asserts that all measures are defined, and the same up to 1e-9 after a change of the states.
fn assert_invariant(change: impl Fn(&mut State)) {
    // Up to 160 individuals the physics finds pairs in another way than beyond.
    for (n, pi1, seed) in [
        (2, 4.0, 1),
        (40, 4.0, 2),
        (60, 1.0, 3),
        (200, 4.0, 4),
        (30, 12.0, 5),
    ] {
        let states = states(n, pi1, seed);
        let mut changed = states.clone();
        changed.iter_mut().for_each(&change);
        for measure in measures() {
            let (before, after) = (value(&measure, &states), value(&measure, &changed));
            let (before, after) = (before.unwrap(), after.unwrap());
            // The absolute term is for values that are 0 except for rounding.
            let tolerance = 1e-9 * before.abs() + 1e-12;
            let difference = (before - after).abs();
            assert!(difference <= tolerance, "{n} {measure}: {before} {after}");
        }
        assert_same_histograms(states.last().unwrap(), changed.last().unwrap());
    }
}

/// Asserts that the histograms are the same, but for a pair on an edge that rounding moves.
fn assert_same_histograms(before: &State, after: &State) {
    let of = |state: &State| {
        let group = &state.configuration;
        let area = hull_area(group).unwrap_or(1.0);
        let radial = pair_correlation(group, 37, 4.1, area).unwrap();
        [
            radial.counts,
            neighbour_density(group, 9, 3.3).unwrap().counts,
        ]
    };
    for (before, after) in of(before).iter().zip(&of(after)) {
        let moved: u64 = before.iter().zip(after).map(|(a, b)| a.abs_diff(*b)).sum();
        assert!(moved <= 4, "{moved} pairs in other bins");
        assert!(before.iter().sum::<u64>() > 0);
    }
}

#[test]
fn a_translation_changes_no_measure() {
    assert_invariant(|state| {
        let configuration = &mut state.configuration;
        configuration.origin = [3_000_000_000, -77];
        configuration.x.iter_mut().for_each(|x| *x += 123.4);
        configuration.y.iter_mut().for_each(|y| *y -= 0.77);
    });
}

#[test]
fn a_change_of_origin_in_the_middle_changes_no_measure() {
    assert_invariant(|state| {
        if state.step >= 40 {
            state.configuration.origin = [1, -2];
            state.configuration.x.iter_mut().for_each(|x| *x -= 1024.0);
            state.configuration.y.iter_mut().for_each(|y| *y += 2048.0);
        }
    });
}

#[test]
fn a_rotation_changes_no_measure() {
    for angle in [1.0, -2.5, std::f64::consts::PI] {
        assert_invariant(|state| {
            let configuration = &mut state.configuration;
            let (sin, cos) = libm::sincos(angle);
            for (x, y) in configuration.x.iter_mut().zip(&mut configuration.y) {
                (*x, *y) = (*x * cos - *y * sin, *x * sin + *y * cos);
            }
            configuration.alpha.iter_mut().for_each(|it| *it += angle);
            configuration
                .direction
                .iter_mut()
                .for_each(|it| *it += angle);
        });
    }
}

#[test]
fn a_renumbering_changes_no_measure() {
    assert_invariant(|state| {
        let configuration = &mut state.configuration;
        let n = configuration.n();
        // A step that is coprime to all sizes.
        let permute = |column: &mut Vec<f64>| {
            *column = (0..n).map(|index| column[(index * 7919 + 1) % n]).collect();
        };
        permute(&mut configuration.x);
        permute(&mut configuration.y);
        permute(&mut configuration.alpha);
        permute(&mut configuration.weight);
        permute(&mut configuration.direction);
        let first = configuration.next_id;
        configuration
            .id
            .iter_mut()
            .for_each(|id| *id = first + 3 * *id);
        configuration.next_id = 4 * first;
    });
}

#[test]
fn measures_differ_between_steps() {
    // Otherwise the tests above would compare nothing.
    let states = states(40, 4.0, 2);
    for measure in measures() {
        let earlier = value(&measure, &states[..45]);
        let later = value(&measure, &states);
        let name = measure.definition().name;
        let is_integer = name.starts_with("clusters") || name.starts_with("contacts");
        assert!(
            is_integer || name == "front" || earlier != later,
            "{measure} {earlier:?}"
        );
    }
}
