use super::*;
use crate::model::body::worst_gap;
use crate::model::start::disc;

const DRAW: Draw = Draw { seed: 3, seq: 4 };

fn group() -> (Parameters, Configuration) {
    let parameters = Parameters::default();
    (parameters, disc(&parameters, 30, None, 5).unwrap())
}

#[test]
fn individuals_appear_at_absolute_positions_after_the_group_has_travelled() {
    let (parameters, mut configuration) = group();
    configuration.origin = [2, -1];
    let pose = Pose {
        x: 2048.0 + 8.5,
        y: -1024.0 - 9.25,
        alpha: 1.0,
    };
    let ids = at(&parameters, &mut configuration, &[pose], 0.5, 2.0, Some(7)).unwrap();
    assert_eq!(ids, [30]);
    assert_eq!((configuration.x[30], configuration.y[30]), (8.5, -9.25));
    assert_eq!(
        (configuration.weight[30], configuration.direction[30]),
        (0.5, 2.0)
    );
    assert_eq!(configuration.lapses_at[30], Some(7));
}

#[test]
fn the_error_names_an_overlapping_pose_and_nothing_changes() {
    let (parameters, mut configuration) = group();
    let before = configuration.clone();
    let free = Pose {
        x: 20.0,
        y: 20.0,
        alpha: 0.0,
    };
    let mut inject = |poses: &[Pose]| at(&parameters, &mut configuration, poses, 0.0, 0.0, None);
    let occupied = Pose {
        x: before.x[3],
        y: before.y[3],
        alpha: 0.1,
    };
    let error = inject(&[free, occupied]).unwrap_err();
    assert!(matches!(error, InjectionError::Overlap { index: 1, gap } if gap < 0.0));
    let error = inject(&[free, Pose { y: 20.3, ..free }]).unwrap_err();
    assert!(
        matches!(error, InjectionError::Overlap { index: 1, gap } if (gap + 0.1).abs() < 1e-12)
    );
    for bad in [f64::NAN, f64::INFINITY, 2e6] {
        for pose in [
            Pose { x: bad, ..free },
            Pose { y: bad, ..free },
            Pose { alpha: bad, ..free },
        ] {
            assert!(matches!(
                inject(&[free, pose]),
                Err(InjectionError::Pose { index: 1, .. })
            ));
        }
    }
    assert!(matches!(
        inject(&[]),
        Err(InjectionError::Count { count: 0, .. })
    ));
    assert_eq!(configuration, before);
}

#[test]
fn every_injection_checks_weights_directions_and_ids() {
    let (parameters, mut configuration) = group();
    configuration.next_id = u32::MAX - 3;
    let before = configuration.clone();
    let region = Region {
        x: 0.0,
        y: 0.0,
        radius: 50.0,
    };
    for (count, weight, direction) in [
        (3, 0.5, 0.0),
        (1, f64::NAN, 0.0),
        (1, -0.1, 0.0),
        (1, 0.5, f64::NAN),
        (1, 1e3, 0.0),
        (0, 0.5, 0.0),
    ] {
        let poses = vec![
            Pose {
                x: 30.0,
                y: 0.0,
                alpha: 0.0
            };
            count
        ];
        assert!(
            at(
                &parameters,
                &mut configuration,
                &poses,
                weight,
                direction,
                None
            )
            .is_err()
        );
        assert!(
            at_border(
                &parameters,
                &mut configuration,
                count,
                weight,
                direction,
                DRAW
            )
            .is_err()
        );
        assert!(
            within(
                &parameters,
                &mut configuration,
                count,
                region,
                weight,
                direction,
                DRAW
            )
            .is_err()
        );
    }
    assert_eq!(configuration, before);
    assert!(at_border(&parameters, &mut configuration, 2, 0.5, 0.0, DRAW).is_ok());
}

#[test]
fn individuals_at_the_border_nearly_touch_another() {
    for pi1 in [1.0, 4.0, 32.0] {
        let parameters = Parameters {
            pi1,
            ..Parameters::default()
        };
        let mut configuration = disc(&parameters, 30, None, 5).unwrap();
        let ids = at_border(&parameters, &mut configuration, 10, 0.0, 0.0, DRAW).unwrap();
        assert_eq!(ids, (30..40).collect::<Vec<u32>>());
        assert!(worst_gap(&parameters, &configuration).unwrap() >= 0.0);
        let body = Body::new(&parameters);
        for k in 30..40 {
            let nearest = (0..40).filter(|&j| j != k).map(|j| {
                body.nearness(pose(&configuration, k), pose(&configuration, j))
                    .gap
            });
            assert!(nearest.fold(f64::INFINITY, f64::min) <= BORDER_GAP);
        }
    }
}

#[test]
fn at_the_border_of_one_individual_the_bodies_nearly_touch() {
    let parameters = Parameters::default();
    let mut configuration = disc(&parameters, 1, None, 5).unwrap();
    at_border(&parameters, &mut configuration, 1, 0.0, 0.0, DRAW).unwrap();
    let gap = worst_gap(&parameters, &configuration).unwrap();
    assert!((0.0..=BORDER_GAP).contains(&gap), "{gap}");
}

#[test]
fn a_region_is_filled_without_overlap_or_the_error_has_the_numbers() {
    let (parameters, mut configuration) = group();
    let region = Region {
        x: 20.0,
        y: 0.0,
        radius: 2.0,
    };
    let mut inject = |count| {
        within(
            &parameters,
            &mut configuration,
            count,
            region,
            0.5,
            1.0,
            DRAW,
        )
    };
    let error = inject(60).unwrap_err();
    let InjectionError::NoRoom {
        placed,
        count: 60,
        tries: TRIES,
    } = error
    else {
        panic!("{error}");
    };
    assert!((8..25).contains(&placed), "{placed}");
    assert_eq!(inject(6).unwrap().len(), 6);
    assert!(worst_gap(&parameters, &configuration).unwrap() >= 0.0);
    for k in 30..36 {
        assert!((configuration.x[k] - 20.0).hypot(configuration.y[k]) <= 2.0);
        assert_eq!(configuration.weight[k], 0.5);
    }
}

#[test]
fn an_invalid_region_is_rejected() {
    let (parameters, mut configuration) = group();
    let before = configuration.clone();
    for (x, radius) in [
        (f64::NAN, 1.0),
        (0.0, 0.0),
        (0.0, f64::NAN),
        (0.0, -1.0),
        (3e6, 1.0),
    ] {
        let region = Region { x, y: 0.0, radius };
        let error = within(&parameters, &mut configuration, 1, region, 0.0, 0.0, DRAW);
        assert!(matches!(error, Err(InjectionError::Parameters(_))));
    }
    assert_eq!(configuration, before);
}
