//! Motions of one and two individuals, compared with closed-form solutions.

use std::f64::consts::PI;

use jostle_physics::model::{Parameters, State, start};
use jostle_physics::stepper::Stepper;

use crate::{advance, with};

/// `tan((α - α_p)/2)` decays as `exp(-c_p t)`. The error of the steps is proportional to `dt`.
#[test]
fn one_informed_individual_turns_by_the_closed_form() {
    let error = |dt: f64| {
        let parameters = Parameters {
            pi3: 2.0,
            dt,
            ..Parameters::default()
        };
        let mut configuration = start::given(&parameters, &[0.0], &[0.0], &[2.5]).unwrap();
        configuration.inform(0, 0.5, 0.3, None);
        let mut state = with(parameters, 1, configuration);
        advance(&mut Stepper::new(), &mut state, (2.0 / dt).round() as u64);
        // The weight 0.5 is in units of c_s = π3 = 2, so c_p = 1.
        let exact = 0.3 + 2.0 * ((1.1f64).tan() * (-2.0f64).exp()).atan();
        (state.configuration.alpha[0] - exact).abs()
    };
    let errors = [0.02, 0.01, 0.005].map(error);
    assert!(errors[0] < 0.01, "{errors:?}");
    for pair in errors.windows(2) {
        assert!((1.9..2.1).contains(&(pair[0] / pair[1])), "{errors:?}");
    }
}

/// Returns a state of two individuals at `poses` (x, y, alpha).
fn two(parameters: Parameters, poses: [[f64; 3]; 2]) -> State {
    let column = |axis: usize| [poses[0][axis], poses[1][axis]];
    with(
        parameters,
        1,
        start::given(&parameters, &column(0), &column(1), &column(2)).unwrap(),
    )
}

#[test]
fn two_discs_head_on_stop_each_other() {
    let parameters = Parameters {
        pi1: 1.0,
        ..Parameters::default()
    };
    let mut state = two(parameters, [[0.0, 0.0, 0.0], [1.03, 0.0, PI]]);
    let mut stepper = Stepper::new();
    advance(&mut stepper, &mut state, 2);
    let stopped = state.configuration.clone();
    assert!(
        (stopped.x[1] - stopped.x[0] - 1.0).abs() < 1e-9,
        "the discs are not in contact"
    );
    advance(&mut stepper, &mut state, 100);
    assert!(
        (state.configuration.x[0] - stopped.x[0]).abs() < 1e-9,
        "the discs move on"
    );
    assert!(
        (state.warm_start.contacts[0].multiplier - 0.02).abs() < 1e-9,
        "the multiplier is not dt"
    );
}

/// Two flush bodies with equal headings turn towards each other at the rates `±π3 / (1 + h² π4)`;
/// the free rates are `±π3`. The contact pushes them apart.
#[test]
fn two_bodies_side_by_side_turn_and_part_at_the_predicted_rate() {
    for (pi3, pi4) in [(1.0, 10.0), (0.3, 50.0)] {
        let parameters = Parameters {
            pi3,
            pi4,
            ..Parameters::default()
        };
        let (h, width) = (parameters.half_length(), 2.0 * parameters.radius());
        let mut state = two(parameters, [[0.0, 0.0, 0.0], [0.0, width, 0.0]]);
        advance(&mut Stepper::new(), &mut state, 1);
        let configuration = &state.configuration;
        let rate = pi3 / (1.0 + h * h * pi4);
        assert!(
            (configuration.alpha[0] / 0.02 - rate).abs() < 1e-6,
            "{:?} {rate}",
            configuration.alpha
        );
        assert!((configuration.alpha[1] / 0.02 + rate).abs() < 1e-6);
        let apart = configuration.y[1] - configuration.y[0] - width;
        assert!((apart - 2.0 * h * rate * 0.02).abs() < 1e-9, "{apart}");
    }
}

#[test]
fn without_attraction_two_bodies_side_by_side_do_not_turn() {
    let parameters = Parameters {
        pi3: 1e-12,
        ..Parameters::default()
    };
    let mut state = two(
        parameters,
        [[0.0, 0.0, 0.0], [0.5, 2.0 * parameters.radius(), 0.0]],
    );
    advance(&mut Stepper::new(), &mut state, 100);
    let configuration = &state.configuration;
    assert!(
        configuration.alpha.iter().all(|alpha| alpha.abs() < 1e-9),
        "{:?}",
        configuration.alpha
    );
    assert!((configuration.x[0] - 2.0).abs() < 1e-9 && (configuration.x[1] - 2.5).abs() < 1e-9);
}
