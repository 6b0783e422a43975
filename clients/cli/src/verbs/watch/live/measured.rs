//! The measure that the second chart shows, evaluated on the states that are drawn.

use jostle_measures::{Measure, Past, View};
use jostle_physics::model::{self, Parameters};
use jostle_proto::State;

/// The largest group for measures that cost more than a sum over the individuals: they are evaluated
/// on the thread that draws.
const MAX_COSTLY_INDIVIDUALS: usize = 5000;

/// Returns the measures of the menu; order and drift have charts without it.
pub fn choices() -> Vec<Measure> {
    let mut choices = Measure::all_of_one_state();
    choices.retain(|it| !["order", "drift"].contains(&it.definition().name));
    choices
}

/// Returns the measure `by` places after `measure` in the menu; `None`, the drift, comes before the
/// first one and after the last one.
pub fn neighbour(measure: Option<Measure>, by: isize) -> Option<Measure> {
    let choices = choices();
    let at = measure.and_then(|it| choices.iter().position(|choice| *choice == it));
    let at = at.map_or(0, |at| at + 1);
    let places = choices.len() + 1;
    let to = (at + places).saturating_add_signed(by) % places;
    choices.get(to.checked_sub(1)?).copied()
}

/// Evaluates a measure; none if it is undefined, or too costly for the group.
pub fn evaluate(measure: Measure, state: &State, pi1: f64) -> Option<f64> {
    if measure.definition().cost != "n" && state.id.len() > MAX_COSTLY_INDIVIDUALS {
        return None;
    }
    let mut group = model::State {
        parameters: Parameters {
            pi1,
            ..Parameters::default()
        },
        ..model::State::default()
    };
    let configuration = &mut group.configuration;
    for index in 0..state.id.len() {
        configuration.push(state.x[index], state.y[index], state.alpha[index]);
        configuration.inform(index, state.weight[index], state.direction[index], None);
    }
    let past = Past::new(0);
    measure.evaluate(&View::new(&group, &past))
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;
    use crate::verbs::watch::live::snapshots::state_of;

    #[test]
    fn the_menu_is_a_circle_that_begins_with_the_drift() {
        let first = neighbour(None, 1);
        assert_eq!(first, choices().first().copied());
        assert_eq!(neighbour(first, -1), None);
        assert_eq!(neighbour(None, -1), choices().last().copied());
        assert_eq!(neighbour(choices().last().copied(), 1), None);
        let mut measure = None;
        for _ in 0..=choices().len() {
            measure = neighbour(measure, 1);
        }
        assert_eq!(measure, None);
    }

    #[test]
    fn a_measure_is_that_of_the_drawn_bodies() {
        // Side by side, 0.4 apart, and one far away.
        let bodies = [
            (0.0, 0.0, 0.0, 0.0),
            (0.0, 0.4, 0.0, 0.0),
            (9.0, 9.0, 1.0, 0.0),
        ];
        let state = state_of(&bodies);
        let of = |name: &str, pi1: f64| evaluate(name.parse().unwrap(), &state, pi1);
        assert_eq!(of("clusters.largest", 4.0), Some(2.0));
        assert_eq!(of("clusters.largest", 12.0), Some(1.0));
        assert_eq!(of("front", 4.0), None);
    }
}
