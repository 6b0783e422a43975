//! Informed individuals: the drift along their common direction, and how far ahead they are.

use jostle_physics::model::heading::unit_vector;

use crate::definition::Definition;
use crate::view::View;

pub(crate) const DEFINITIONS: [Definition; 2] = [
    Definition {
        name: "drift",
        unit: "v0",
        formula: "(1/n) Σ e_i · d, d the common direction of the informed individuals",
        source: "paper, the drift in section 3.2",
        range: "-1 to 1",
        is_of_informed: true,
        evaluate: |view, _| view.order().drift,
        ..Definition::PLAIN
    },
    Definition {
        name: "front",
        unit: "1",
        formula: "mean over the informed of rank(x_i · d)/(n - 1), ranks of all from 0 to n - 1, ties have the mean rank; d their common direction",
        source: "the mean rank of Wilcoxon, Biometrics Bull. 1, 80 (1945), scaled to 1 for the foremost",
        range: "0 to 1",
        cost: "n log n",
        is_of_informed: true,
        evaluate: |view, _| front(view),
        ..Definition::PLAIN
    },
];

/// Individuals whose places along the direction differ by at most this from the next one tie: the
/// difference may be a rounding error. In body sizes.
const TIE: f64 = 1e-9;

fn front(view: &View<'_>) -> Option<f64> {
    let [cos, sin] = unit_vector(view.order().direction?);
    let weight = &view.state().configuration.weight;
    let places = view.centred().iter().map(|[x, y]| x * cos + y * sin);
    let mut places: Vec<(f64, bool)> = places
        .zip(weight)
        .map(|(place, &weight)| (place, weight > 0.0))
        .collect();
    places.sort_unstable_by(|(one, _), (other, _)| one.total_cmp(other));
    let (mut first, mut sum, mut informed) = (0.0, 0.0, 0.0);
    for tied in places.chunk_by(|(one, _), (next, _)| next - one <= TIE) {
        let size = tied.len() as f64;
        let among = tied.iter().filter(|(_, is_informed)| *is_informed).count() as f64;
        sum += among * (first + (size - 1.0) / 2.0);
        informed += among;
        first += size;
    }
    (first >= 2.0).then(|| sum / (informed * (first - 1.0)))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use jostle_physics::model::State;

    use crate::testing::{assert_near, state, value};

    fn informed(poses: &[[f64; 3]], informed: &[usize], direction: f64) -> State {
        let mut state = state(poses);
        for &index in informed {
            state.configuration.inform(index, 0.5, direction, None);
        }
        state
    }

    #[test]
    fn drift_is_the_speed_along_the_common_direction() {
        let poses = [[0.0, 0.0, 0.0], [0.0, 0.0, FRAC_PI_2]];
        assert_near(value("drift", &informed(&poses, &[0], 0.0)), 0.5);
        assert_near(value("drift", &informed(&poses, &[0, 1], PI)), -0.5);
        assert_eq!(value("drift", &informed(&poses, &[], 0.0)), None);
    }

    #[test]
    fn front_is_the_mean_rank_of_the_informed() {
        let row = [3.0, 0.0, 2.0, 1.0].map(|x| [x, 0.0, 0.0]);
        let front = |who: &[usize], direction| value("front", &informed(&row, who, direction));
        assert_near(front(&[0], 0.0), 1.0);
        assert_near(front(&[1], 0.0), 0.0);
        assert_near(front(&[0], PI), 0.0);
        assert_near(front(&[0, 3], 0.0), (1.0 + 1.0 / 3.0) / 2.0);
        assert_near(front(&[0, 1, 2, 3], 0.0), 0.5);
        assert_eq!(front(&[], 0.0), None);
    }

    #[test]
    fn individuals_abreast_have_the_mean_rank() {
        // Ranks 0, then three times the mean of 1, 2 and 3, then 4.
        let poses = [0.0, 1.0, 1.0, 1.0, 5.0].map(|y| [300.0 + 7.0 * y * y, y, 0.0]);
        let front = |who: &[usize]| value("front", &informed(&poses, who, FRAC_PI_2));
        assert_near(front(&[2]), 0.5);
        assert_near(front(&[0, 2]), 0.25);
        assert_near(front(&[2, 4]), 0.75);
        // The cosine of π/2 is 6e-17, so places of one height do not come out equal.
        let apart = [[-900.0, 0.1, 0.0], [0.0, 0.1, 0.0], [900.0, 0.1, 0.0]];
        assert_near(value("front", &informed(&apart, &[2], FRAC_PI_2)), 0.5);
    }

    #[test]
    fn front_needs_two_individuals_and_a_direction() {
        assert_eq!(value("front", &informed(&[[0.0; 3]], &[0], 0.0)), None);
        assert_near(value("front", &informed(&[[0.0; 3]; 2], &[0], 0.0)), 0.5);
        let mut opposite = informed(&[[0.0; 3], [1.0, 0.0, 0.0]], &[0, 1], 0.0);
        opposite.configuration.inform(0, 0.5, PI, None);
        assert_eq!(value("front", &opposite), None);
    }
}
