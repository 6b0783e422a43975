//! Invariants of the solver, the assembly and the model, over random parameters.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use jostle_physics::model::attraction::AttractionWorkspace;
use jostle_physics::model::random::{Purpose, Stream};
use jostle_physics::model::{Configuration, Parameters, State, body, start};
use jostle_physics::stepper::contact::Contact;
use jostle_physics::stepper::qp::Qp;
use jostle_physics::stepper::{StepReport, Stepper, solve};

use crate::{advance, drawn, program, with};

/// Reach of the contacts with which a step is checked, in body sizes. It exceeds the displacement
/// of any step, so that a contact which is missing from the stepper's list is found.
const FAR: f64 = 0.5;

/// Bound of the rounding in a sum over a group that cancels.
const ROUNDING: f64 = 1e-11;

/// A step with the state before, the program and the result.
struct Step {
    seed: u64,
    before: State,
    after: State,
    report: StepReport,
    /// The program with all contacts within [`FAR`].
    qp: Qp,
    /// Multipliers of the contacts of `qp`.
    multipliers: Vec<f64>,
    /// Displacements: n rows of x, y, alpha.
    moved: Vec<[f64; 3]>,
}

/// Takes a step, and assembles its program again from all pairs.
fn checked_step(stepper: &mut Stepper, state: &mut State) -> Step {
    let before = state.clone();
    let report = stepper
        .step(state)
        .unwrap_or_else(|error| panic!("seed {}: {error}", before.seed));
    let qp = program(&before, FAR);
    let pushed = &state.warm_start.contacts;
    let multiplier = |contact: &Contact| {
        let [first, second] = [contact.i, contact.j].map(|k| before.configuration.id[k as usize]);
        let same = |old: &&jostle_physics::model::WarmContact| {
            (old.first, old.second, old.code) == (first, second, contact.code)
        };
        pushed.iter().find(same).map_or(0.0, |old| old.multiplier)
    };
    let multipliers: Vec<f64> = qp.contacts.iter().map(multiplier).collect();
    let found = multipliers.iter().filter(|value| **value != 0.0).count();
    assert_eq!(
        found,
        pushed.len(),
        "seed {}: a contact pushes that is not within FAR",
        before.seed
    );
    let (old, new) = (&before.configuration, &state.configuration);
    assert_eq!(old.origin, new.origin, "the origin was shifted");
    let difference = |k: usize| {
        [
            new.x[k] - old.x[k],
            new.y[k] - old.y[k],
            new.alpha[k] - old.alpha[k],
        ]
    };
    let moved = (0..old.n()).map(difference).collect();
    Step {
        seed: before.seed,
        before,
        after: state.clone(),
        report,
        qp,
        multipliers,
        moved,
    }
}

/// Returns a state with random parameters over most of their ranges and a crowded start.
fn random_state(seed: u64) -> State {
    let mut stream = Stream::new(seed, 0, 0, Purpose::Selection);
    let mut between = |low: f64, high: f64| low + (high - low) * stream.uniform();
    let logarithmic = |exponent: f64| 10f64.powf(exponent);
    let pi1 = if seed.is_multiple_of(4) {
        1.0
    } else {
        1.0 + logarithmic(between(-1.0, 1.3))
    };
    let (pi3, pi4) = (
        logarithmic(between(-1.0, 1.0)),
        logarithmic(between(-0.5, 2.5)),
    );
    let mut parameters = Parameters {
        pi1,
        pi3,
        pi4,
        ..Parameters::default()
    };
    let n = between(2.0, 45.0) as usize;
    let weight = between(0.0, 2.0);
    parameters.dt = parameters.longest_step(weight).min(0.1) * between(0.05, 0.5);
    // Bodies cover a quarter of the disc: crowded, and the draw succeeds.
    let (h, r) = (parameters.half_length(), parameters.radius());
    let area = 4.0 * h * r + PI * r * r;
    let radius = (n as f64 * area / 0.25 / PI).sqrt().max(0.5);
    let mut configuration = start::disc(&parameters, n, Some(radius), seed).unwrap();
    for index in 0..n / 3 {
        configuration.inform(index, weight, between(0.0, TAU), None);
    }
    with(parameters, seed, configuration)
}

/// Calls `check` for 12 steps of each of 60 random groups, with more steps between them, so that
/// the later ones have many contacts.
fn check_steps(check: impl Fn(&Step)) {
    let (mut steps, mut pushes) = (0, 0);
    for seed in 1..=60 {
        let mut state = random_state(seed);
        let mut stepper = Stepper::new();
        for round in 0..12 {
            let step = checked_step(&mut stepper, &mut state);
            steps += 1;
            pushes += step.report.active;
            check(&step);
            if round % 3 == 2 {
                advance(&mut stepper, &mut state, 40);
            }
        }
    }
    println!("{steps} steps with {pushes} pushes");
    assert!(
        pushes > 5 * steps,
        "too few contacts push: {pushes} in {steps} steps"
    );
}

#[test]
fn every_step_solves_its_program_and_moves_by_the_solution() {
    check_steps(|step| {
        let Step {
            seed,
            qp,
            multipliers,
            moved,
            report,
            ..
        } = step;
        // Rounding of coordinates of a few tens.
        let scale = 1e-14;
        let mut displacement = Vec::new();
        let residual = qp.residual(multipliers, &mut displacement);
        // Contacts that are not in the stepper's list count too.
        assert!(
            residual <= solve::TARGET,
            "seed {seed}: {residual:e}, reported {:e}",
            report.residual
        );
        assert!(
            report.residual <= solve::TARGET && !report.degraded,
            "seed {seed}"
        );
        for (moved, solved) in moved.iter().zip(&displacement) {
            assert!(
                (0..3).all(|axis| (moved[axis] - solved[axis]).abs() <= scale),
                "seed {seed}"
            );
        }
        for (contact, &multiplier) in qp.contacts.iter().zip(multipliers) {
            let slack = contact.linearised_gap(&displacement);
            assert!(
                multiplier >= 0.0 && slack >= -solve::TARGET,
                "seed {seed}: {multiplier} {slack}"
            );
            assert!(
                multiplier.min(slack) <= solve::TARGET,
                "seed {seed}: {multiplier} {slack}"
            );
        }
    });
}

#[test]
fn contacts_do_not_increase_the_weighted_norm_of_the_displacement() {
    let squares = |weights: [f64; 3], all: &[[f64; 3]]| -> f64 {
        all.iter()
            .map(|one| {
                (0..3)
                    .map(|axis| weights[axis] * one[axis] * one[axis])
                    .sum::<f64>()
            })
            .sum()
    };
    let checked = std::cell::Cell::new(0);
    check_steps(|step| {
        let Step {
            seed,
            qp,
            multipliers,
            moved,
            ..
        } = step;
        if qp.contacts.iter().any(|contact| contact.gap < 0.0) {
            return;
        }
        checked.set(checked.get() + usize::from(step.report.active > 0));
        let slack = multipliers.iter().sum::<f64>() * solve::TARGET + 1e-13;
        let (pushed, free) = (squares(qp.weights, moved), squares(qp.weights, &qp.free));
        assert!(pushed <= free + slack, "seed {seed}: {pushed} above {free}");
    });
    assert!(
        checked.get() > 20,
        "only {} steps without overlap",
        checked.get()
    );
}

#[test]
fn contact_forces_are_internal_and_carry_no_moment() {
    check_steps(|step| {
        let Step {
            seed,
            qp,
            moved,
            before,
            ..
        } = step;
        for about in [[0.0, 0.0], [3.0, -7.0]] {
            let (mut force, mut moment) = ([0.0, 0.0], 0.0);
            for (k, (moved, free)) in moved.iter().zip(&qp.free).enumerate() {
                let push: [f64; 3] =
                    [0, 1, 2].map(|axis| qp.weights[axis] * (moved[axis] - free[axis]));
                force = [force[0] + push[0], force[1] + push[1]];
                let arm = [
                    before.configuration.x[k] - about[0],
                    before.configuration.y[k] - about[1],
                ];
                moment += arm[0] * push[1] - arm[1] * push[0] + push[2];
            }
            let worst = force[0].abs().max(force[1].abs()).max(moment.abs());
            assert!(worst < ROUNDING, "seed {seed}: {force:?} {moment}");
        }
    });
}

#[test]
fn attraction_cancels_over_the_group() {
    for seed in 1..=60 {
        let state = random_state(seed);
        let mut pull = Vec::new();
        let parameters = &state.parameters;
        AttractionWorkspace::default().compute(
            parameters.attraction,
            &state.configuration,
            &mut pull,
        );
        let sum = pull
            .iter()
            .fold([0.0, 0.0], |sum, one| [sum[0] + one[0], sum[1] + one[1]]);
        assert!(
            sum[0].abs().max(sum[1].abs()) < 1e-13,
            "seed {seed}: {sum:?}"
        );
        assert!(
            pull.iter().all(|one| one[0].hypot(one[1]) <= 1.0 + 1e-15),
            "seed {seed}"
        );
    }
}

#[test]
fn without_contact_the_step_is_the_free_one_to_the_bit() {
    for seed in 1..=40 {
        let mut state = random_state(seed);
        // Spread the group so that no two bodies are near each other.
        let spread = |column: &mut Vec<f64>| column.iter_mut().for_each(|value| *value *= 30.0);
        spread(&mut state.configuration.x);
        spread(&mut state.configuration.y);
        let step = checked_step(&mut Stepper::new(), &mut state);
        if !step.qp.contacts.is_empty() {
            continue;
        }
        let (old, new) = (&step.before.configuration, &step.after.configuration);
        for (k, free) in step.qp.free.iter().enumerate() {
            let expected = [
                old.x[k] + free[0],
                old.y[k] + free[1],
                old.alpha[k] + free[2],
            ];
            assert_eq!([new.x[k], new.y[k], new.alpha[k]], expected, "seed {seed}");
        }
        assert_eq!((step.report.residual, step.report.contacts), (0.0, 0));
    }
}

/// Asserts that a step commutes with `image`: the step of the image is the image of the step.
fn commutes(name: &str, image: impl Fn(&State) -> State) {
    for seed in 1..=40 {
        let mut state = random_state(seed);
        let mut stepper = Stepper::new();
        advance(&mut stepper, &mut state, 60);
        let mut mapped = image(&state);
        stepper.step(&mut state).unwrap();
        Stepper::new().step(&mut mapped).unwrap();
        let expected = image(&state);
        let columns = |state: &State| {
            let Configuration { x, y, alpha, .. } = state.configuration.clone();
            [x, y, alpha].concat()
        };
        let worst = columns(&mapped)
            .iter()
            .zip(columns(&expected))
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max);
        // Gaps are exact to the target; displacements can differ by more.
        assert!(worst < 1e-8, "{name}, seed {seed}: {worst:e}");
    }
}

/// Returns the state with positions mapped by `position`, and headings and directions by `angle`.
fn mapped(
    state: &State,
    position: impl Fn(f64, f64) -> (f64, f64),
    angle: impl Fn(f64) -> f64,
) -> State {
    let mut image = state.clone();
    let configuration = &mut image.configuration;
    for k in 0..configuration.n() {
        (configuration.x[k], configuration.y[k]) = position(configuration.x[k], configuration.y[k]);
        configuration.alpha[k] = angle(configuration.alpha[k]);
        if configuration.weight[k] > 0.0 {
            configuration.direction[k] = angle(configuration.direction[k]);
        }
    }
    image
}

#[test]
fn steps_commute_with_translation_rotation_reflection_and_renumbering() {
    commutes("translation", |state| {
        mapped(state, |x, y| (x + 30.0, y - 20.0), |angle| angle)
    });
    let (sin, cos) = 0.7f64.sin_cos();
    commutes("rotation", |state| {
        mapped(
            state,
            |x, y| (cos * x - sin * y, sin * x + cos * y),
            |angle| angle + 0.7,
        )
    });
    commutes("reflection", |state| {
        mapped(state, |x, y| (x, -y), |angle| -angle)
    });
    commutes("renumbering", |state| {
        let mut image = state.clone();
        let Configuration {
            x,
            y,
            alpha,
            weight,
            direction,
            ..
        } = &mut image.configuration;
        [x, y, alpha, weight, direction]
            .into_iter()
            .for_each(|column| column.reverse());
        // The warm start refers to individuals by id, and the ids now have other poses: clear it.
        image.warm_start = Default::default();
        image
    });
}

#[test]
fn a_group_far_from_the_origin_is_recentred_by_whole_cells() {
    let mut near = drawn(Parameters::default(), 20, 3);
    let mut far = near.clone();
    far.configuration
        .x
        .iter_mut()
        .for_each(|x| *x += 3.0 * 1024.0);
    far.configuration.y.iter_mut().for_each(|y| *y -= 1024.0);
    let mut stepper = Stepper::new();
    stepper.step(&mut near).unwrap();
    stepper.step(&mut far).unwrap();
    assert_eq!(far.configuration.origin, [3, -1]);
    for k in 0..20 {
        assert!((near.configuration.x[k] - far.configuration.x[k]).abs() < 1e-9);
        assert!((near.configuration.y[k] - far.configuration.y[k]).abs() < 1e-9);
    }
}

/// The overlap of the first two discs pushes the second one into the third, whose gap exceeds the
/// reach of the first list.
#[test]
fn a_contact_beyond_the_first_list_is_found_when_the_step_closes_it() {
    let parameters = Parameters {
        pi1: 1.0,
        ..Parameters::default()
    };
    let (x, y) = ([0.0, 0.8, 1.88], [0.0; 3]);
    let configuration = start::given(&parameters, &x, &y, &[FRAC_PI_2; 3]).unwrap();
    assert!(
        1.88 - 0.8 - 1.0 > parameters.reach(0.0),
        "the third is beyond the first list"
    );
    let mut state = with(parameters, 1, configuration);
    let step = checked_step(&mut Stepper::new(), &mut state);
    assert_eq!(step.report.contacts, 2);
    let residual = step.qp.residual(&step.multipliers, &mut Vec::new());
    assert!(residual <= solve::TARGET, "{residual:e}");
}

/// The linearisation leaves an overlap of order dt².
#[test]
fn overlap_stays_small_and_no_axes_cross() {
    let mut overlaps = [0.0f64; 2];
    for (overlap, dt) in overlaps.iter_mut().zip([0.02, 0.005]) {
        for seed in 1..=4 {
            let mut state = drawn(
                Parameters {
                    dt,
                    ..Parameters::default()
                },
                30,
                seed,
            );
            let mut stepper = Stepper::new();
            for _ in 0..(30.0 / dt) as u64 {
                stepper.step(&mut state).unwrap();
                let gaps = body::gaps(&state.parameters, &state.configuration);
                assert_eq!(gaps.crossed, 0);
                *overlap = overlap.max(-gaps.worst_gap.unwrap_or(0.0));
            }
        }
    }
    println!("worst overlap at dt = 0.02 and 0.005: {overlaps:?}");
    assert!(
        overlaps[0] < 4e-3 && overlaps[1] < overlaps[0] / 4.0,
        "{overlaps:?}"
    );
}

#[test]
fn an_informed_individual_lapses_at_its_step() {
    let mut state = drawn(Parameters::default(), 5, 1);
    state.configuration.inform(2, 0.5, 1.0, Some(3));
    state.configuration.inform(4, 0.5, 1.0, None);
    let mut stepper = Stepper::new();
    for step in 1..=4 {
        let report = stepper.step(&mut state).unwrap();
        assert_eq!(report.lapsed, if step == 3 { vec![2] } else { vec![] });
        assert_eq!(state.configuration.weight[2] > 0.0, step < 3);
    }
    assert_eq!(
        (
            state.configuration.direction[2],
            state.configuration.lapses_at[2]
        ),
        (0.0, None)
    );
    assert_eq!(state.configuration.weight[4], 0.5);
    assert!((state.time() - 0.08).abs() < 1e-15);
}
