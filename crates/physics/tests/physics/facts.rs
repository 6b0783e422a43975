//! What the solver, the assembly and the model must satisfy, whatever the parameters.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use jostle_physics::model::attraction::AttractionWorkspace;
use jostle_physics::model::random::{Purpose, Stream};
use jostle_physics::model::{Configuration, Parameters, State, body, start};
use jostle_physics::stepper::contact::Contact;
use jostle_physics::stepper::qp::Qp;
use jostle_physics::stepper::{StepReport, Stepper, solve};

use crate::{advance, drawn, program, with};

/// How far contacts are looked for when a step is judged: much further than any step goes, so a
/// contact that the stepper should have listed and did not is seen here.
const FAR: f64 = 0.5;

/// What rounding may leave of a sum over a group that should cancel.
const ROUNDING: f64 = 1e-11;

/// One judged step: the state before, its program, and what the step made of it.
struct Step {
    seed: u64,
    before: State,
    after: State,
    report: StepReport,
    qp: Qp,
    multipliers: Vec<f64>,
    /// Actual displacements.
    moved: Vec<[f64; 3]>,
}

fn judged_step(stepper: &mut Stepper, state: &mut State) -> Step {
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
        "seed {}: a push from nowhere",
        before.seed
    );
    let (old, new) = (&before.configuration, &state.configuration);
    assert_eq!(old.origin, new.origin, "these groups stay near home");
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

/// Random parameters over most of their ranges, and a crowded start.
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
    // Crowded, yet with places to find: a quarter of the disc is covered.
    let (h, r) = (parameters.half_length(), parameters.radius());
    let area = 4.0 * h * r + PI * r * r;
    let radius = (n as f64 * area / 0.25 / PI).sqrt().max(0.5);
    let mut configuration = start::disc(&parameters, n, Some(radius), seed).unwrap();
    for index in 0..n / 3 {
        configuration.inform(index, weight, between(0.0, TAU), None);
    }
    with(parameters, seed, configuration)
}

/// Judges some steps of many random groups, from the start and once they push.
fn judge(check: impl Fn(&Step)) {
    let (mut steps, mut pushes) = (0, 0);
    for seed in 1..=60 {
        let mut state = random_state(seed);
        let mut stepper = Stepper::new();
        for round in 0..12 {
            let step = judged_step(&mut stepper, &mut state);
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
        "too few push for these facts to mean anything: {pushes}"
    );
}

#[test]
fn every_step_solves_its_program_and_moves_as_it_says() {
    judge(|step| {
        let Step {
            seed,
            qp,
            multipliers,
            moved,
            report,
            ..
        } = step;
        // Rounding of positions up to a few tens.
        let scale = 1e-14;
        let mut displacement = Vec::new();
        let residual = qp.residual(multipliers, &mut displacement);
        // Contacts beyond the stepper's own list count here too.
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
fn pushing_only_takes_from_the_free_motion() {
    let squares = |weights: [f64; 3], all: &[[f64; 3]]| -> f64 {
        all.iter()
            .map(|one| {
                (0..3)
                    .map(|axis| weights[axis] * one[axis] * one[axis])
                    .sum::<f64>()
            })
            .sum()
    };
    let judged = std::cell::Cell::new(0);
    judge(|step| {
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
        judged.set(judged.get() + usize::from(step.report.active > 0));
        let slack = multipliers.iter().sum::<f64>() * solve::TARGET + 1e-13;
        let (pushed, free) = (squares(qp.weights, moved), squares(qp.weights, &qp.free));
        assert!(pushed <= free + slack, "seed {seed}: {pushed} above {free}");
    });
    assert!(
        judged.get() > 20,
        "only {} steps without overlap",
        judged.get()
    );
}

#[test]
fn pushes_are_internal_and_carry_no_moment() {
    judge(|step| {
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
        // Spread out, nobody is near anybody.
        let spread = |column: &mut Vec<f64>| column.iter_mut().for_each(|value| *value *= 30.0);
        spread(&mut state.configuration.x);
        spread(&mut state.configuration.y);
        let step = judged_step(&mut Stepper::new(), &mut state);
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

/// Steps a group and its image under a map of the plane; the images must be each other's.
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
        // Both are exact to the target in their gaps; a displacement may differ by somewhat more.
        assert!(worst < 1e-8, "{name}, seed {seed}: {worst:e}");
    }
}

fn mapped(
    state: &State,
    place: impl Fn(f64, f64) -> (f64, f64),
    angle: impl Fn(f64) -> f64,
) -> State {
    let mut image = state.clone();
    let configuration = &mut image.configuration;
    for k in 0..configuration.n() {
        (configuration.x[k], configuration.y[k]) = place(configuration.x[k], configuration.y[k]);
        configuration.alpha[k] = angle(configuration.alpha[k]);
        if configuration.weight[k] > 0.0 {
            configuration.direction[k] = angle(configuration.direction[k]);
        }
    }
    image
}

#[test]
fn nothing_depends_on_place_bearing_handedness_or_numbering() {
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
        // What is remembered names individuals that are now others: start without it.
        image.warm_start = Default::default();
        image
    });
}

#[test]
fn a_far_group_is_moved_by_whole_cells_and_steps_as_at_home() {
    let home = drawn(Parameters::default(), 20, 3);
    let mut far = home.clone();
    far.configuration
        .x
        .iter_mut()
        .for_each(|x| *x += 3.0 * 1024.0);
    far.configuration.y.iter_mut().for_each(|y| *y -= 1024.0);
    let (mut near, mut stepper) = (home, Stepper::new());
    stepper.step(&mut near).unwrap();
    stepper.step(&mut far).unwrap();
    assert_eq!(far.configuration.origin, [3, -1]);
    for k in 0..20 {
        assert!((near.configuration.x[k] - far.configuration.x[k]).abs() < 1e-9);
        assert!((near.configuration.y[k] - far.configuration.y[k]).abs() < 1e-9);
    }
}

/// `tan((α - α_p)/2)` decays as `exp(-c_p t)`; the error of the steps is proportional to dt.
#[test]
fn one_informed_individual_turns_as_the_solution_says() {
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
        "they touch"
    );
    advance(&mut stepper, &mut state, 100);
    assert!(
        (state.configuration.x[0] - stopped.x[0]).abs() < 1e-9,
        "and stay"
    );
    assert!(
        (state.warm_start.contacts[0].multiplier - 0.02).abs() < 1e-9,
        "each takes the other's push"
    );
}

/// The rate is `∓π3 / (1 + h² π4)`: half of the pull's turning goes into pushing apart.
#[test]
fn two_side_by_side_turn_into_each_other_slowly_and_part() {
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
fn without_attraction_two_side_by_side_slide_along_without_turning() {
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

/// A body pressed into another in passing would be missed by a list as far as free bodies go.
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
    let step = judged_step(&mut Stepper::new(), &mut state);
    assert_eq!(step.report.contacts, 2);
    let residual = step.qp.residual(&step.multipliers, &mut Vec::new());
    assert!(residual <= solve::TARGET, "{residual:e}");
}

/// Overlap is what linearisation leaves, of order dt².
#[test]
fn overlap_stays_small_and_nobody_crosses() {
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
fn who_is_informed_for_a_time_is_not_afterwards() {
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
