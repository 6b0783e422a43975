//! Motion between an earlier step and the present one. Individuals that are not present at both steps
//! do not count.

use std::ops::Bound;

use jostle_physics::model::Configuration;
use jostle_physics::simulation::steps_in;

use crate::definition::{Argument, Definition, Lag};
use crate::past::Frame;
use crate::view::View;

pub(crate) const DEFINITIONS: [Definition; 4] = [
    Definition {
        name: "turning_rate",
        unit: "rad/(s/v0)",
        formula: "sqrt(mean_i (ω_i - ω)²), ω_i = (α_i(t) - α_i(t - dt))/dt, ω their mean",
        source: "standard deviation of the turning rates of docs/model.md, Free motion, contacts included",
        range: "at least 0",
        lag: Lag::Step,
        evaluate: |view, _| turning_rate(view),
        ..Definition::PLAIN
    },
    Definition {
        name: "speed.informed",
        unit: "v0",
        formula: "mean over the informed of |x_i(t) - x_i(t - dt)|/dt",
        source: "speed after contacts, by docs/model.md, One step",
        range: "at least 0",
        is_of_informed: true,
        lag: Lag::Step,
        evaluate: |view, _| speed(view, true),
        ..Definition::PLAIN
    },
    Definition {
        name: "speed.others",
        unit: "v0",
        formula: "mean over the uninformed of |x_i(t) - x_i(t - dt)|/dt",
        source: "speed after contacts, by docs/model.md, One step",
        range: "at least 0",
        is_of_informed: true,
        lag: Lag::Step,
        evaluate: |view, _| speed(view, false),
        ..Definition::PLAIN
    },
    Definition {
        name: "msd",
        unit: "body sizes²",
        formula: "mean_i |x_i(t) - x_i(t - lag)|², lag rounded up to whole steps",
        source: "Frenkel and Smit, Understanding Molecular Simulation (2002), section 4.4.1",
        range: "at least 0",
        argument: Some(Argument {
            name: "lag",
            unit: "s/v0",
            default: None,
            range: (Bound::Excluded(0.0), Bound::Unbounded),
        }),
        lag: Lag::Argument,
        evaluate: |view, lag| mean_squared_displacement(view, lag),
        ..Definition::PLAIN
    },
];

/// Returns the present configuration and the frame `steps` steps before.
fn motion<'a>(view: &View<'a>, steps: u64) -> Option<(&'a Configuration, &'a Frame)> {
    let state = view.state();
    let frame = view.frame_before(steps)?;
    Some((&state.configuration, frame))
}

/// Returns the mean; `None` without values.
fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0.0);
    for value in values {
        sum += value;
        count += 1.0;
    }
    (count > 0.0).then(|| sum / count)
}

fn turning_rate(view: &View<'_>) -> Option<f64> {
    let (now, frame) = motion(view, 1)?;
    let dt = view.state().parameters.dt;
    let rates = || {
        let pairs = frame.matched(now);
        pairs.map(|(index, then)| (now.alpha[index] - frame.alpha[then]) / dt)
    };
    let centre = mean(rates())?;
    let variance = mean(rates().map(|rate| (rate - centre) * (rate - centre)))?;
    Some(variance.sqrt())
}

fn speed(view: &View<'_>, of_informed: bool) -> Option<f64> {
    let (now, frame) = motion(view, 1)?;
    let pairs = frame.matched(now);
    let chosen = pairs.filter(|&(index, _)| (now.weight[index] > 0.0) == of_informed);
    let lengths = chosen.map(|(index, then)| square(frame.displacement(then, now, index)).sqrt());
    Some(mean(lengths)? / view.state().parameters.dt)
}

fn mean_squared_displacement(view: &View<'_>, lag: f64) -> Option<f64> {
    let steps = steps_in(lag, view.state().parameters.dt);
    let (now, frame) = motion(view, steps)?;
    let pairs = frame.matched(now);
    mean(pairs.map(|(index, then)| square(frame.displacement(then, now, index))))
}

fn square([dx, dy]: [f64; 2]) -> f64 {
    dx * dx + dy * dy
}

#[cfg(test)]
mod tests {
    use jostle_physics::model::State;

    use crate::Past;
    use crate::testing::{assert_near, state, value_after};

    /// Three steps of three individuals: at each, the first moves by (0.03, 0.04), the second by
    /// (0, 0.01), and the third rests; they turn by 0.02, 0.06 and 0.04. Returns the last state and the
    /// past, which has all four states.
    fn moving() -> (State, Past) {
        let mut state = state(&[[0.0, 0.0, 3.0], [5.0, 5.0, 3.2], [9.0, 9.0, -7.0]]);
        let mut past = Past::new(3);
        past.observe(&state);
        for _ in 0..3 {
            advance(&mut state);
            past.observe(&state);
        }
        (state, past)
    }

    fn advance(state: &mut State) {
        state.step += 1;
        let configuration = &mut state.configuration;
        for (index, step) in [[0.03, 0.04, 0.02], [0.0, 0.01, 0.06], [0.0, 0.0, 0.04]]
            .into_iter()
            .enumerate()
        {
            configuration.x[index] += step[0];
            configuration.y[index] += step[1];
            configuration.alpha[index] += step[2];
        }
    }

    #[test]
    fn the_turning_rate_is_a_standard_deviation() {
        let (state, past) = moving();
        // Turning rates of 1, 3 and 2.
        let value = value_after("turning_rate", &state, &past);
        assert!(value.is_some_and(|it| (it - (2.0f64 / 3.0).sqrt()).abs() < 1e-12));
    }

    #[test]
    fn speeds_of_the_informed_and_of_the_others() {
        let (mut state, past) = moving();
        assert_eq!(value_after("speed.informed", &state, &past), None);
        assert_near(
            value_after("speed.others", &state, &past),
            (2.5 + 0.5) / 3.0,
        );
        state.configuration.inform(0, 0.5, 0.0, None);
        assert_near(value_after("speed.informed", &state, &past), 2.5);
        assert_near(value_after("speed.others", &state, &past), 0.25);
    }

    #[test]
    fn the_displacement_is_over_the_lag() {
        let (mut state, past) = moving();
        for (lag, steps) in [("0.02", 1.0), ("0.03", 2.0), ("0.04", 2.0), ("0.06", 3.0)] {
            let squares = steps * steps * (0.05 * 0.05 + 0.01 * 0.01);
            let value = value_after(&format!("msd({lag})"), &state, &past);
            assert_near(value, squares / 3.0);
        }
        assert_eq!(value_after("msd(0.08)", &state, &past), None);
        // A change of origin alone is no displacement; an individual that is removed does not count.
        state.configuration.origin = [2, -1];
        state.configuration.x.iter_mut().for_each(|x| *x -= 2048.0);
        state.configuration.y.iter_mut().for_each(|y| *y += 1024.0);
        state.configuration.remove(&[1]);
        state.configuration.push(3.0, 3.0, 3.0);
        let value = value_after("msd(0.06)", &state, &past);
        assert!(value.is_some_and(|it| (it - 9.0 * 0.05 * 0.05 / 2.0).abs() < 1e-11));
    }

    #[test]
    fn the_past_may_end_before_the_present_step() {
        let (mut state, past) = moving();
        advance(&mut state);
        assert_near(value_after("speed.others", &state, &past), 1.0);
        assert_near(value_after("msd(0.08)", &state, &past), 16.0 * 0.0026 / 3.0);
        advance(&mut state);
        assert_eq!(value_after("speed.others", &state, &past), None);
    }

    #[test]
    fn nothing_moves_without_a_past() {
        for name in ["turning_rate", "speed.informed", "speed.others", "msd(1)"] {
            let (state, past) = (state(&[[0.0; 3]]), Past::new(1));
            assert_eq!(value_after(name, &state, &past), None, "{name}");
            let mut past = Past::new(1);
            past.observe(&state);
            assert_eq!(value_after(name, &state, &past), None, "{name}");
        }
        // After a step none of the individuals was present before.
        let (mut state, past) = moving();
        state.configuration.remove(&[0, 1, 2]);
        state.configuration.push(0.0, 0.0, 0.0);
        for name in ["turning_rate", "speed.others", "msd(0.02)"] {
            assert_eq!(value_after(name, &state, &past), None, "{name}");
        }
    }
}
