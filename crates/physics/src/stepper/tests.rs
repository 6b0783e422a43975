use super::*;
use crate::model::random::{Purpose, Stream};
use crate::model::{Attraction, body};

/// Two touching bodies side by side, and one far away.
fn touching() -> State {
    let mut configuration = Configuration::default();
    configuration.push(0.0, 0.0, 0.0);
    configuration.push(0.1, 0.4, -0.01);
    configuration.push(9.0, 9.0, 0.0);
    State {
        configuration,
        ..State::default()
    }
}

fn error(mut state: State) -> StepError {
    let before = format!("{state:?}");
    let error = Stepper::new().step(&mut state).unwrap_err();
    assert_eq!(
        format!("{state:?}"),
        before,
        "a failed step has changed the state"
    );
    error
}

#[test]
fn a_step_is_counted_and_stores_the_pushing_contacts() {
    let mut state = touching();
    let report = Stepper::new().step(&mut state).unwrap();
    assert_eq!(
        (state.step, report.active),
        (1, state.warm_start.contacts.len())
    );
    assert!(report.active > 0 && report.contacts >= report.active && report.iterations > 0);
    assert!(
        state
            .warm_start
            .contacts
            .iter()
            .all(|contact| contact.multiplier > 0.0)
    );
}

#[test]
fn headings_and_displacements_are_those_of_the_last_step() {
    let mut state = State::default();
    state.configuration.push(1.0, 2.0, 0.5);
    state.configuration.push(-50.0, 0.0, 3.0);
    let mut stepper = Stepper::new();
    let report = stepper.step(&mut state).unwrap();
    assert_eq!((report.contacts, report.worst_gap), (0, None));
    let dt = state.parameters.dt;
    let headings = [0.5, 3.0].map(|alpha| [libm::cos(alpha), libm::sin(alpha)]);
    for ((found, moved), [cos, sin]) in stepper
        .headings()
        .iter()
        .zip(stepper.displacement())
        .zip(headings)
    {
        for (found, expected) in [
            (found[0], cos),
            (found[1], sin),
            (moved[0], dt * cos),
            (moved[1], dt * sin),
        ] {
            assert!((found - expected).abs() < 1e-15, "{found} {expected}");
        }
    }
    assert_eq!(
        (stepper.headings().len(), stepper.displacement().len()),
        (2, 2)
    );
}

#[test]
fn crossed_bodies_are_rejected() {
    let mut state = touching();
    state.configuration.alpha[1] = 1.5;
    state.configuration.id = vec![4, 7, 9];
    assert_eq!(
        error(state),
        StepError::CrossedBodies {
            first: 4,
            second: 7
        }
    );
}

/// A step whose parameters are not checked.
fn unchecked(state: &mut State) -> Result<StepReport, StepError> {
    let mut pull = Vec::new();
    AttractionWorkspace::default().compute(
        state.parameters.attraction,
        &state.configuration,
        &mut pull,
    );
    Stepper::new().advance(state, &pull)
}

#[test]
fn a_step_after_which_bodies_would_cross_is_rejected() {
    // These steps are too long for the check of the parameters, so that linearisation fails.
    let parameters = Parameters {
        pi1: 32.0,
        pi3: 20.0,
        dt: 0.2,
        ..Parameters::default()
    };
    let mut stream = Stream::new(1, 0, 0, Purpose::Start);
    let mut rejected = 0;
    for _ in 0..2000 {
        let mut state = State {
            parameters,
            ..State::default()
        };
        for _ in 0..3 {
            let [x, y, alpha] = [0, 1, 2].map(|_| 3.0 * stream.uniform());
            state.configuration.push(x, y, alpha);
        }
        let gaps = body::gaps(&parameters, &state.configuration);
        let before = format!("{state:?}");
        match unchecked(&mut state) {
            Ok(_) => assert_eq!(body::gaps(&parameters, &state.configuration).crossed, 0),
            Err(error) => {
                assert!(matches!(error, StepError::CrossedBodies { .. }), "{error}");
                assert_eq!(format!("{state:?}"), before);
                rejected += usize::from(gaps.crossed == 0);
            }
        }
    }
    assert!(rejected > 0, "no step would have crossed");
}

/// Takes so many steps of a group whose attraction grows with the distance.
fn led_apart(exponent: f64, parameters: Parameters, steps: u64) -> Result<(), StepError> {
    let attraction = Attraction::Power { exponent };
    let parameters = Parameters {
        attraction,
        ..parameters
    };
    let mut stream = Stream::new(1, 0, 0, Purpose::Start);
    let mut state = State {
        parameters,
        ..State::default()
    };
    for k in 0..30 {
        let (row, column) = (f64::from(k / 6), f64::from(k % 6));
        let alpha = 6.3 * stream.uniform();
        state.configuration.push(1.7 * column, 1.7 * row, alpha);
    }
    let mut stepper = Stepper::new();
    for _ in 0..steps {
        stepper.step(&mut state)?;
    }
    Ok(())
}

#[test]
fn the_cause_of_a_failure_is_the_attraction_if_that_turns_bodies_too_far() {
    let default = Parameters::default();
    let dt = |dt| Parameters { dt, ..default };
    let pi3 = |pi3| Parameters { pi3, ..default };
    // With a shorter step, or a weaker pull, the same groups take thousands of steps.
    for (exponent, short, weak) in [(4.0, dt(2e-4), pi3(0.01)), (6.0, dt(2e-6), pi3(1e-4))] {
        let error = led_apart(exponent, default, 500).unwrap_err();
        let StepError::Overturned {
            exponent: named,
            turn,
            ..
        } = error
        else {
            panic!("{error}");
        };
        assert!(named == exponent && turn > 1.0, "{error}");
        let text = error.to_string();
        let start = format!("attraction power={exponent} turns individual ");
        assert!(text.starts_with(&start), "{text}");
        assert!(
            text.ends_with("a smaller exponent, pi3 or dt avoids it"),
            "{text}"
        );
        assert!(!text.contains("pi4"), "{text}");
        for parameters in [short, weak] {
            led_apart(exponent, parameters, 1000).unwrap();
        }
    }
    // Discs are turned as far, and nothing is wrong with that.
    led_apart(
        8.0,
        Parameters {
            pi1: 1.0,
            ..default
        },
        500,
    )
    .unwrap();
}

#[test]
fn another_cause_is_not_replaced_by_the_attraction() {
    let mut state = touching();
    state.parameters.attraction = Attraction::Power { exponent: 8.0 };
    state.configuration.x[2] = f64::NAN;
    assert_eq!(error(state), StepError::NotFinite { id: 2 });
    let mut state = State::default();
    state.parameters.attraction = Attraction::Power { exponent: 8.0 };
    for alpha in [0.0, 1.5] {
        state.configuration.push(0.0, 0.0, alpha);
    }
    let crossed = error(state);
    assert!(
        matches!(crossed, StepError::CrossedBodies { .. }),
        "{crossed}"
    );
}

#[test]
fn a_position_that_is_not_finite_is_rejected_with_its_id() {
    for bad in [f64::NAN, f64::INFINITY] {
        for column in 0..3 {
            let mut state = touching();
            let Configuration { x, y, alpha, .. } = &mut state.configuration;
            [x, y, alpha][column][2] = bad;
            assert_eq!(error(state), StepError::NotFinite { id: 2 });
        }
    }
}

#[test]
fn a_program_without_solution_is_rejected() {
    let mut state = touching();
    state.parameters.pi4 = f64::NAN;
    let error = unchecked(&mut state).unwrap_err();
    assert!(matches!(error, StepError::NotSolved { residual } if residual > solve::ACCEPTABLE));
}
