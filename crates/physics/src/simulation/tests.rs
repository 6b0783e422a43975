//! Tests of the changes of a simulation, each against values that follow from its documentation.

use std::sync::{Arc, Mutex};

use super::*;
use crate::model::injection::{Pose, Region};

/// Individuals in a row along x, 2 apart, that face in the directions `alpha`.
pub(super) fn row(alpha: &[f64]) -> Simulation {
    let x = (0..alpha.len()).map(|k| 2.0 * k as f64).collect();
    let start = Start::Given {
        x,
        y: vec![0.0; alpha.len()],
        alpha: alpha.to_vec(),
    };
    let spec = Spec {
        start,
        ..Spec::new(alpha.len(), 7)
    };
    Simulation::new(&spec).unwrap()
}

/// The callback of a simulation that logs each call, and rejects sizes above `limit`.
fn logged(limit: usize) -> (ReserveMemory, Arc<Mutex<Vec<Reservation>>>) {
    let log = Arc::new(Mutex::new(Vec::new()));
    let calls = log.clone();
    let reserve = move |size| {
        calls.lock().unwrap().push(size);
        match size {
            Reservation::Grow(n) if n > limit => Err(ReserveError::TooMany { n, limit }),
            _ => Ok(()),
        }
    };
    (Box::new(reserve), log)
}

fn take(log: &Mutex<Vec<Reservation>>) -> Vec<Reservation> {
    std::mem::take(&mut log.lock().unwrap())
}

fn ids(outcome: &ChangeOutcome) -> (Vec<u32>, usize) {
    match outcome {
        ChangeOutcome::Ids { ids, n } => (ids.clone(), *n),
        other => panic!("{other:?}"),
    }
}

fn set(settings: Settings) -> Change {
    Change::Set(settings)
}

fn chosen(ids: &[u32]) -> Selection {
    Selection::Ids(ids.to_vec())
}

#[test]
fn a_new_simulation_is_its_spec_at_step_0() {
    let spec = Spec {
        publish_every: 5,
        ..Spec::new(20, 3)
    };
    let swarm = Simulation::new(&spec).unwrap();
    assert_eq!((swarm.epoch, swarm.seq, swarm.publish_every), (1, 0, 5));
    let state = &swarm.state;
    assert_eq!(
        (state.step, state.seed, state.configuration.n()),
        (0, 3, 20)
    );
    assert_eq!(state.parameters, spec.parameters);
    assert_eq!(swarm.means.count, 0);
    let other = Simulation::new(&Spec::new(20, 4)).unwrap();
    assert_ne!(other.state_hash(), swarm.state_hash());
}

#[test]
fn a_step_adds_the_order_before_it_to_the_means_and_reports_its_work() {
    let mut swarm = row(&[0.0, 0.0, 1.0]);
    let before = swarm.order();
    let expected = (5.0 + 4.0 * libm::cos(1.0)).sqrt() / 3.0;
    assert!((before.order - expected).abs() < 1e-15);
    swarm.step().unwrap();
    assert_eq!(swarm.means.count, 1);
    assert_eq!(swarm.means.mean_order(), Some(before.order));
    assert_eq!(swarm.state.step, 1);

    let mut packed = Simulation::new(&Spec::new(30, 1)).unwrap();
    for _ in 0..300 {
        let report = packed.step().unwrap();
        let Exactness {
            residual,
            degraded,
            contacts,
            iterations,
        } = packed.exactness;
        assert_eq!((residual, contacts), (report.residual, report.contacts));
        assert_eq!((degraded, iterations), (0, report.iterations));
    }
    assert!(packed.exactness.contacts > 0);
}

#[test]
fn a_checkpoint_continues_to_the_same_hash_and_means() {
    let mut swarm = Simulation::new(&Spec::new(15, 2)).unwrap();
    swarm.publish_every = 9;
    swarm
        .apply_at(4, &Change::inform(Selection::Count(3), 1.0))
        .unwrap();
    for _ in 0..50 {
        swarm.step().unwrap();
    }
    let (reserve, log) = logged(15);
    let mut copy = Simulation::from_checkpoint(&swarm.checkpoint(), reserve);
    assert_eq!(copy.state_hash(), swarm.state_hash());
    assert_eq!((copy.seq, copy.publish_every, copy.epoch), (4, 9, 1));
    for simulation in [&mut swarm, &mut copy] {
        simulation.step().unwrap();
    }
    assert_eq!(copy.state_hash(), swarm.state_hash());
    assert_eq!(copy.means.mean_order(), swarm.means.mean_order());
    assert_eq!(copy.means.mean_drift(), swarm.means.mean_drift());
    assert!(take(&log).is_empty());
}

#[test]
fn a_restart_is_the_start_of_the_spec_in_the_next_epoch() {
    let spec = Spec {
        publish_every: 2,
        ..Spec::new(12, 5)
    };
    let first = Simulation::new(&spec).unwrap().state_hash();
    for (seed, expected) in [
        (None, first),
        (
            Some(6),
            Simulation::new(&Spec::new(12, 6)).unwrap().state_hash(),
        ),
    ] {
        let mut swarm = Simulation::new(&spec).unwrap();
        swarm
            .apply(&Change::inform(Selection::Count(2), 0.5))
            .unwrap();
        swarm.publish_every = 50;
        swarm.seq = 3;
        for _ in 0..20 {
            swarm.step().unwrap();
        }
        swarm.exactness.degraded = 1;
        let running = swarm.state_hash();
        let start = swarm.build_start(seed).unwrap();
        assert_eq!(swarm.state_hash(), running, "building it changes nothing");
        swarm.restart(start);
        assert_eq!(swarm.state_hash(), expected);
        assert_eq!((swarm.epoch, swarm.publish_every, swarm.seq), (2, 2, 3));
        assert_eq!((swarm.means.count, swarm.exactness.degraded), (0, 0));
        assert_eq!(swarm.spec.seed, seed.unwrap_or(5));
        // The stepper is new, too: the future is that of a new simulation.
        let mut new = Simulation::new(&swarm.spec).unwrap();
        for simulation in [&mut swarm, &mut new] {
            simulation.step().unwrap();
        }
        assert_eq!(swarm.state_hash(), new.state_hash());
    }
}

#[test]
fn a_start_that_cannot_be_built_returns_the_present_size() {
    let full = Spec {
        start: Start::Disc(Some(2.0)),
        ..Spec::new(10, 1)
    };
    let (reserve, log) = logged(20);
    let mut swarm = Simulation::with_reserve(full, reserve).unwrap();
    swarm.apply(&Change::Remove(Selection::Count(4))).unwrap();
    assert_eq!(take(&log), [Reservation::Return(6)]);
    assert!(swarm.build_start(None).is_ok());
    assert_eq!(take(&log), [Reservation::Return(10)]);
    swarm.spec.n = 1000;
    assert!(matches!(
        swarm.build_start(None),
        Err(ChangeError::Start(_))
    ));
    assert_eq!(
        take(&log),
        [Reservation::Return(1000), Reservation::Return(6)]
    );
}

#[test]
fn changes_after_the_first_have_a_sequence_number_of_their_own() {
    let draw = Change::inform(Selection::Count(1), 0.0);
    let mut swarm = Simulation::new(&Spec::new(100, 1)).unwrap();
    let together = swarm
        .apply_all_at(10, &[draw.clone(), draw.clone(), draw.clone()])
        .unwrap();
    assert_eq!(swarm.seq, 12);
    for (seq, (kind, outcome)) in (10..).zip(&together) {
        let mut alone = Simulation::new(&Spec::new(100, 1)).unwrap();
        assert_eq!(&alone.apply_at(seq, &draw).unwrap(), outcome);
        assert_eq!(*kind, ChangeKind::Inform);
    }
    assert_eq!(swarm.apply_all_at(20, &[]).unwrap(), []);
    assert_eq!(swarm.seq, 12);
}

#[test]
fn changes_are_counted_so_that_equal_ones_draw_anew() {
    let mut swarm = Simulation::new(&Spec::new(50, 1)).unwrap();
    let five = Change::inform(Selection::Count(5), 0.0);
    let first = swarm.apply(&five).unwrap();
    assert_eq!(swarm.seq, 1);
    // Rejected: it has no number.
    let all = Change::Remove(Selection::Count(50));
    assert!(swarm.apply(&all).is_err());
    assert_eq!(swarm.seq, 1);
    assert_ne!(swarm.apply(&five).unwrap(), first);
    assert_eq!(swarm.seq, 2);
    assert_eq!(swarm.apply_at(1, &five).unwrap(), first);
}

#[test]
fn parameters_that_were_set_without_a_check_fail_the_step() {
    type Break = fn(&mut Parameters);
    let breaks: [(&str, Break); 6] = [
        ("pi1", |it| it.pi1 = f64::NAN),
        ("pi2", |it| it.pi2 = f64::NAN),
        ("pi3", |it| it.pi3 = -1.0),
        ("pi4", |it| it.pi4 = f64::INFINITY),
        ("noise", |it| it.noise = f64::NAN),
        ("dt", |it| it.dt = 1e3),
    ];
    for (field, to) in breaks {
        let mut swarm = Simulation::new(&Spec::new(20, 1)).unwrap();
        swarm.step().unwrap();
        let good = swarm.state.parameters;
        to(&mut swarm.state.parameters);
        let hash = swarm.state_hash();
        for _ in 0..2 {
            let error = swarm.step().unwrap_err();
            assert!(matches!(error, StepError::Parameters(_)), "{error:?}");
            assert!(error.to_string().contains(field), "{error}");
            assert_eq!(swarm.state_hash(), hash);
        }
        swarm.state.parameters = good;
        swarm.step().unwrap();
    }
}

#[test]
fn a_rejected_change_is_named_by_its_index_and_rolled_back_with_those_before() {
    let (reserve, log) = logged(10);
    let mut swarm = Simulation::with_reserve(Spec::new(8, 1), reserve).unwrap();
    let saved = swarm.save();
    let hash = swarm.state_hash();
    let add = |count| Change::Inject {
        place: Placement::Border(count),
        informed: None,
    };
    let settings = Settings {
        publish_every: Some(7),
        ..Settings::default()
    };
    let rejected = swarm.apply_all_at(1, &[set(settings), add(2), add(1), add(1)]);
    let (index, error) = rejected.unwrap_err();
    assert_eq!(index, 2);
    let ChangeError::Reserve(ReserveError::TooMany { n: 11, limit: 10 }) = error else {
        panic!("{error:?}");
    };
    assert_eq!((swarm.seq, swarm.publish_every), (2, 7));
    assert_eq!(take(&log), [Reservation::Grow(10), Reservation::Grow(11)]);
    swarm.rollback(saved);
    assert_eq!((swarm.seq, swarm.publish_every), (0, 1));
    assert_eq!(swarm.state_hash(), hash);
    assert_eq!(take(&log), [Reservation::Return(8)]);
}

#[test]
fn an_informed_individual_has_the_weight_direction_and_end_that_were_given() {
    let mut swarm = row(&[0.0; 4]);
    let inform = |selection, weight, for_time| Change::Inform {
        selection,
        direction: 0.75,
        weight,
        for_time,
    };
    let pi2 = swarm.state.parameters.pi2;
    let all = swarm.apply(&inform(chosen(&[1, 3]), None, None)).unwrap();
    assert_eq!(ids(&all), (vec![1, 3], 4));
    swarm.state.step = 100;
    swarm
        .apply(&inform(chosen(&[0]), Some(0.25), Some(0.06)))
        .unwrap();
    let configuration = &swarm.state.configuration;
    assert_eq!(configuration.weight, [0.25, pi2, 0.0, pi2]);
    assert_eq!(configuration.direction, [0.75, 0.75, 0.0, 0.75]);
    // 0.06 are 3 steps of 0.02.
    assert_eq!(configuration.lapses_at, [Some(103), None, None, None]);

    let among = swarm
        .apply(&Change::Uninform(Selection::Fraction(1.0)))
        .unwrap();
    assert_eq!(ids(&among), (vec![0, 1, 3], 4));
    assert_eq!(swarm.state.configuration.weight, [0.0; 4]);

    for (direction, weight) in [(f64::NAN, None), (0.0, Some(-1.0)), (0.0, Some(1e9))] {
        let change = Change::Inform {
            selection: chosen(&[2]),
            direction,
            weight,
            for_time: None,
        };
        let hash = swarm.state_hash();
        for error in [
            swarm.check(&change).unwrap_err(),
            swarm.apply(&change).unwrap_err(),
        ] {
            assert!(matches!(error, ChangeError::Parameters(_)), "{error:?}");
        }
        assert_eq!(swarm.state_hash(), hash);
    }
    assert!(swarm.check(&inform(chosen(&[2]), Some(0.5), None)).is_ok());
}

#[test]
fn settings_change_what_they_name_and_are_returned_with_the_values_before() {
    let mut swarm = row(&[0.0; 2]);
    let parameters = swarm.state.parameters;
    let settings = Settings {
        pi2: Some(0.125),
        noise: Some(0.5),
        ..Settings::default()
    };
    let now = Parameters {
        pi2: 0.125,
        noise: 0.5,
        ..parameters
    };
    let values = |parameters| SettingValues {
        parameters,
        publish_every: 1,
        measures: Vec::new(),
        max_idle_secs: None,
    };
    let outcome = swarm.apply(&set(settings)).unwrap();
    let expected = ChangeOutcome::Set {
        before: values(parameters),
        now: values(now),
        scaled_by: 1.0,
    };
    assert_eq!(outcome, expected);
    assert_eq!(swarm.state.parameters, now);

    // A body is 2 π1/(π1 + 1) long: 16/9 for π1 = 8, less than the 2 between the centres.
    let longer = Settings {
        pi1: Some(8.0),
        publish_every: Some(3),
        ..Settings::default()
    };
    match swarm.apply(&set(longer)).unwrap() {
        ChangeOutcome::Set { now, scaled_by, .. } => {
            assert_eq!(
                (now.parameters.pi1, now.publish_every, scaled_by),
                (8.0, 3, 1.0)
            );
        }
        other => panic!("{other:?}"),
    }
    assert_eq!((swarm.state.parameters.pi1, swarm.publish_every), (8.0, 3));

    let invalid = set(Settings {
        pi1: Some(0.5),
        ..Settings::default()
    });
    assert!(matches!(
        swarm.check(&invalid),
        Err(ChangeError::Parameters(_))
    ));
    assert!(matches!(
        swarm.apply(&invalid),
        Err(ChangeError::Parameters(_))
    ));
    assert_eq!(swarm.state.parameters.pi1, 8.0);
}

#[test]
fn crossed_bodies_stay_under_the_closest_rule() {
    let mut swarm = row(&[0.0, std::f64::consts::FRAC_PI_2]);
    let rule = |contacts| {
        set(Settings {
            contacts: Some(contacts),
            ..Settings::default()
        })
    };
    for contacts in [
        ContactRule::Clamped,
        ContactRule::Endpoints,
        ContactRule::Closest,
    ] {
        swarm.apply(&rule(contacts)).unwrap();
    }
    swarm.state.configuration.x[1] = swarm.state.configuration.x[0];
    for contacts in [ContactRule::Endpoints, ContactRule::Clamped] {
        let rejected = swarm.apply(&rule(contacts)).unwrap_err();
        assert!(
            matches!(rejected, ChangeError::AxesCross { pairs: 1 }),
            "{rejected:?}"
        );
    }
    swarm.apply(&rule(ContactRule::Closest)).unwrap();
}

#[test]
fn injected_individuals_are_counted_placed_and_reserved_for() {
    let (reserve, log) = logged(20);
    let mut swarm = Simulation::with_reserve(Spec::new(3, 1), reserve).unwrap();
    let far = Pose {
        x: 100.0,
        y: 50.0,
        alpha: 0.5,
    };
    let region = Region {
        x: -100.0,
        y: 0.0,
        radius: 5.0,
    };
    let mut inject = |place, informed| swarm.apply_at(1, &Change::Inject { place, informed });
    let outcome = inject(Placement::At(vec![far]), Some((1.25, None))).unwrap();
    assert_eq!(ids(&outcome), (vec![3], 4));
    let outcome = inject(Placement::Within(2, region), Some((0.25, Some(0.75)))).unwrap();
    assert_eq!(ids(&outcome), (vec![4, 5], 6));
    let outcome = inject(Placement::Border(1), None).unwrap();
    assert_eq!(ids(&outcome), (vec![6], 7));
    let grown = [4, 6, 7].map(Reservation::Grow);
    assert_eq!(take(&log), grown);
    // No room at an occupied place: what was reserved is returned.
    let taken = inject(Placement::At(vec![far]), None).unwrap_err();
    assert!(matches!(taken, ChangeError::Injection(_)), "{taken:?}");
    assert_eq!(take(&log), [Reservation::Grow(8), Reservation::Return(7)]);

    let configuration = &swarm.state.configuration;
    let pi2 = swarm.state.parameters.pi2;
    assert_eq!(configuration.weight[3..], [pi2, 0.75, 0.75, 0.0]);
    assert_eq!(configuration.direction[3..6], [1.25, 0.25, 0.25]);
    assert_eq!(configuration.origin, [0, 0]);
    let place = |k: usize| (configuration.x[k], configuration.y[k]);
    assert_eq!((place(3), configuration.alpha[3]), ((100.0, 50.0), 0.5));
    for k in [4, 5] {
        let (x, y) = place(k);
        assert!(libm::hypot(x + 100.0, y) <= 5.0, "{x} {y}");
    }
}

#[test]
fn removal_leaves_the_others_and_never_none() {
    let (reserve, log) = logged(5);
    let mut swarm = Simulation::with_reserve(Spec::new(5, 1), reserve).unwrap();
    let outcome = swarm.apply(&Change::Remove(chosen(&[1, 3]))).unwrap();
    assert_eq!(ids(&outcome), (vec![1, 3], 3));
    assert_eq!(swarm.state.configuration.id, [0, 2, 4]);
    assert_eq!(take(&log), [Reservation::Return(3)]);
    let all = swarm
        .apply(&Change::Remove(Selection::Fraction(1.0)))
        .unwrap_err();
    assert!(matches!(all, ChangeError::NoneLeft(3)), "{all:?}");
    assert!(take(&log).is_empty());
    // A callback that is set later is the one that is called.
    let (reserve, other) = logged(1);
    swarm.set_reserve(reserve);
    let rejected = swarm.apply(&Change::Inject {
        place: Placement::Border(1),
        informed: None,
    });
    assert!(matches!(rejected, Err(ChangeError::Reserve(_))));
    assert_eq!(
        (take(&log), take(&other)),
        (vec![], vec![Reservation::Grow(4)])
    );
}

#[test]
fn steps_last_at_least_the_time_and_rounding_adds_none() {
    for (time, steps) in [
        (0.0, 0),
        (0.06, 3),
        (0.061, 4),
        (0.02, 1),
        (0.0201, 2),
        (1e300, 1 << 53),
        (2e7, 1_000_000_000),
        (1e9, 50_000_000_000),
        (1e9 + 0.01, 50_000_000_001),
    ] {
        assert_eq!(steps_in(time, 0.02), steps, "{time}");
    }
    for steps in [1 << 30, 99_999_999_999, 1 << 40, (1 << 47) - 1] {
        for dt in [0.02, 0.01, 0.03, 0.0007, 1.0] {
            assert_eq!(steps_in(steps as f64 * dt, dt), steps, "{dt}");
        }
    }
}

#[test]
fn a_time_of_informed_individuals_ends_as_in_the_hashes_of_journals() {
    for (for_time, lapses_at) in [(0.06, 3), (1e9, 50_000_000_000 - 50)] {
        let mut simulation = Simulation::new(&Spec::new(3, 1)).unwrap();
        let inform = Change::Inform {
            selection: Selection::Ids(vec![1]),
            direction: 0.0,
            weight: None,
            for_time: Some(for_time),
        };
        simulation.apply(&inform).unwrap();
        let lapses = &simulation.state.configuration.lapses_at;
        assert_eq!(lapses[1], Some(lapses_at));
    }
}
