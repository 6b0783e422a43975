use super::*;

#[test]
fn a_body_of_four_widths_has_size_one() {
    let parameters = Parameters::default();
    assert!((parameters.radius() - 0.2).abs() < 1e-16);
    assert!((parameters.half_length() - 0.6).abs() < 1e-15);
    // The body size is the mean of length and width.
    let (h, r) = (parameters.half_length(), parameters.radius());
    assert!(((2.0 * (h + r) + 2.0 * r) / 2.0 - 1.0).abs() < 1e-15);
    assert!((parameters.rho2() - 0.1).abs() < 1e-16);
    assert!((parameters.turning_rate_scale(0.5) - 1.5).abs() < 1e-15);
    assert!((parameters.reach(0.0) - 3.0 * 0.02 * 1.6).abs() < 1e-15);
    let disc = Parameters {
        pi1: 1.0,
        ..parameters
    };
    assert_eq!((disc.radius(), disc.half_length()), (0.5, 0.0));
}

#[test]
fn every_field_is_rejected_outside_its_range_and_accepted_at_its_ends() {
    let field_of = |parameters: Parameters, weight: f64| match parameters.check(weight) {
        Err(ParametersError::OutOfRange { field, .. }) => field,
        Err(ParametersError::StepTooLong { .. }) => "too long",
        Err(ParametersError::Clash { field, .. }) => field,
        Ok(()) => "",
    };
    let fine = Parameters {
        dt: 1e-9,
        ..Parameters::default()
    };
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -1.0, 1.1e6] {
        assert_eq!(field_of(Parameters { pi1: bad, ..fine }, 0.0), "pi1");
        assert_eq!(field_of(Parameters { pi2: bad, ..fine }, 0.0), "pi2");
        assert_eq!(field_of(Parameters { pi3: bad, ..fine }, 0.0), "pi3");
        assert_eq!(field_of(Parameters { pi4: bad, ..fine }, 0.0), "pi4");
        assert_eq!(field_of(fine, bad), "weight");
        let expected = if bad == 1.1e6 { "too long" } else { "dt" };
        assert_eq!(field_of(Parameters { dt: bad, ..fine }, 0.0), expected);
    }
    assert_eq!(field_of(Parameters { pi3: 0.0, ..fine }, 0.0), "pi3");
    assert_eq!(field_of(Parameters { pi4: 0.0, ..fine }, 0.0), "pi4");
    assert_eq!(field_of(Parameters { dt: 0.0, ..fine }, 0.0), "dt");
    assert_eq!(field_of(Parameters { pi1: 0.999, ..fine }, 0.0), "pi1");
    assert_eq!(
        field_of(
            Parameters {
                pi1: 32.001,
                ..fine
            },
            0.0
        ),
        "pi1"
    );
    for pi1 in [1.0, 32.0] {
        assert_eq!(
            field_of(
                Parameters {
                    pi1,
                    pi2: 0.0,
                    pi4: 1e6,
                    ..fine
                },
                0.0
            ),
            ""
        );
    }
}

#[test]
fn the_numbers_of_an_attraction_law_have_ranges() {
    type Law = fn(f64) -> Attraction;
    let laws: [(&str, Law, &[f64], &[f64]); 3] = [
        (
            "attraction.accuracy",
            |value| Attraction::All {
                accuracy: Some(value),
            },
            &[-1e-6, 0.0, 0.99e-9, 1.01e-3],
            &[1e-9, 2.5e-6, 1e-3],
        ),
        (
            "attraction.radius",
            |radius| Attraction::Metric { radius },
            &[-1.0, 0.0, 1.1e6],
            &[1e-9, 3.0, 1e6],
        ),
        (
            "attraction.exponent",
            |exponent| Attraction::Power { exponent },
            &[-8.1, 8.1],
            &[-8.0, 0.0, 8.0],
        ),
    ];
    let check = |attraction| {
        let parameters = Parameters {
            attraction,
            ..Parameters::default()
        };
        parameters.check(0.0)
    };
    for (name, law, bad, fine) in laws {
        for &bad in bad.iter().chain(&[f64::NAN, f64::INFINITY]) {
            let error = check(law(bad));
            assert!(
                matches!(error, Err(ParametersError::OutOfRange { field, .. }) if field == name),
                "{error:?}"
            );
        }
        for &fine in fine {
            assert_eq!(check(law(fine)), Ok(()));
        }
    }
    assert!(check(Attraction::Topological { neighbours: 0 }).is_err());
    assert_eq!(check(Attraction::Topological { neighbours: 1 }), Ok(()));
    assert_eq!(check(Attraction::Voronoi), Ok(()));
}

#[test]
fn noise_has_a_range_and_velocities_are_not_linearised_twice() {
    for noise in [-1e-9, f64::NAN, f64::INFINITY, 1.1e6] {
        let parameters = Parameters {
            noise,
            ..Parameters::default()
        };
        assert!(parameters.check(0.0).is_err());
    }
    let clash = Parameters {
        stepping: Stepping::Velocity,
        relinearise: true,
        ..Parameters::default()
    };
    assert!(matches!(
        clash.check(0.0),
        Err(ParametersError::Clash { .. })
    ));
    for (stepping, relinearise) in [(Stepping::Velocity, false), (Stepping::Position, true)] {
        let fine = Parameters {
            stepping,
            relinearise,
            ..clash
        };
        assert_eq!(fine.check(0.0), Ok(()));
    }
}

#[test]
fn a_tip_may_travel_one_width_in_a_step_and_no_further() {
    let at = |dt, weight| {
        Parameters {
            dt,
            ..Parameters::default()
        }
        .check(weight)
    };
    let largest = Parameters::default().longest_step(0.0);
    assert!((largest - 0.4 / 1.6).abs() < 1e-15);
    assert_eq!(at(largest, 0.0), Ok(()));
    let dt = largest * 1.0001;
    assert_eq!(
        at(dt, 0.0),
        Err(ParametersError::StepTooLong { dt, largest })
    );
    assert!(at(largest, 0.5).is_err(), "a larger weight turns faster");
}
