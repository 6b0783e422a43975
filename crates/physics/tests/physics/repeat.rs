//! Reproducibility: the future of a state is the same to the bit, on any thread, stepper and
//! processor level.

use std::thread;

use jostle_physics::model::attraction::AttractionWorkspace;
use jostle_physics::model::random::{Purpose, Stream};
use jostle_physics::model::simd::Level;
use jostle_physics::model::{Parameters, State, WarmContact};
use jostle_physics::stepper::Stepper;
use jostle_physics::stepper::solve::Backend;

use crate::{advance, drawn};

/// Steps until a drawn group of 74 is packed and in contact: t = 20.
const SETTLING: u64 = 1000;

fn hex(state: &State) -> String {
    state
        .hash()
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

/// Returns a group of `n` in contact, always drawn with the same seed.
fn settled_state(n: usize, stepper: &mut Stepper) -> State {
    let mut state = drawn(Parameters::default(), n, 1);
    state
        .configuration
        .inform(3, 0.5, 1.0, Some(SETTLING + 150));
    advance(stepper, &mut state, SETTLING);
    let pushing = state.warm_start.contacts.len();
    assert!(2 * pushing > n, "only {pushing} contacts push");
    state
}

/// The hash of one run. It may change with the model's version or the solver. It must not change
/// with the processor, the number of threads or the build.
#[test]
fn two_hundred_steps_in_contact_end_in_the_golden_state() {
    let mut stepper = Stepper::new();
    let mut state = settled_state(74, &mut stepper);
    advance(&mut stepper, &mut state, 200);
    assert_eq!(hex(&state), GOLDEN);
}

const GOLDEN: &str = "292b6ba2b9ad2ed2dc620e00971bb26eabf39745c25908e915a84b49aadbc538";

/// Steps taken from each restored state.
const AHEAD: usize = 200;

/// Steps `state` with the stepper `straight`, and again each of its first `points` states with a
/// stepper from `new`. Asserts that [`AHEAD`] steps after each restored state the hash equals that
/// of the uninterrupted run.
fn restore(mut state: State, points: usize, mut straight: Stepper, new: impl Fn() -> Stepper) {
    let (mut restored, mut future) = (Vec::new(), Vec::new());
    for taken in 0..points + AHEAD {
        if taken >= AHEAD {
            future.push(state.hash());
        }
        if taken < points {
            restored.push(state.clone());
        }
        straight.step(&mut state).unwrap();
    }
    for (start, mut state) in restored.into_iter().enumerate() {
        advance(&mut new(), &mut state, AHEAD as u64);
        assert_eq!(state.hash(), future[start], "restored at {start}");
    }
}

#[test]
fn a_hundred_restored_states_have_the_same_future() {
    for n in [74, 200] {
        let mut stepper = Stepper::new();
        let state = settled_state(n, &mut stepper);
        restore(state, 100, stepper, Stepper::new);
    }
}

/// Returns a settled group whose next step needs the fallback. Its warm start contains nearly every
/// contact of that step, with random multipliers over eight decades. The group has to be large:
/// with a few hundred individuals the exact solver needs no fallback.
fn state_that_needs_the_fallback(stepper: &mut Stepper) -> State {
    let mut settled = drawn(Parameters::default(), 800, 1);
    advance(stepper, &mut settled, SETTLING);
    let mut pull = Vec::new();
    AttractionWorkspace::default().compute(
        settled.parameters.attraction,
        &settled.configuration,
        &mut pull,
    );
    stepper.assemble(&settled, &pull).unwrap();
    let contacts = &stepper.program().0.contacts.clone();
    let mut candidates = (0..20).map(|seed| {
        let mut stream = Stream::new(seed, 0, 0, Purpose::Selection);
        let mut state = settled.clone();
        let warm = contacts.iter().map(|contact| WarmContact {
            first: state.configuration.id[contact.i as usize],
            second: state.configuration.id[contact.j as usize],
            code: contact.code,
            multiplier: libm::pow(10.0, -8.0 * stream.uniform()),
        });
        state.warm_start.contacts = warm.collect();
        state.warm_start.contacts.retain(|_| stream.uniform() < 0.9);
        state
    });
    let needs_fallback = |state: &State| stepper.step(&mut state.clone()).unwrap().fallback > 0;
    candidates
        .find(needs_fallback)
        .expect("nearly every candidate needs the fallback")
}

#[test]
fn a_state_restored_before_a_fallback_step_has_the_same_future() {
    let mut stepper = Stepper::new();
    let state = state_that_needs_the_fallback(&mut stepper);
    restore(state, 10, stepper, Stepper::new);
}

#[test]
fn restored_states_have_the_same_future_with_the_fallback_alone() {
    let state = settled_state(74, &mut Stepper::new());
    let fallback = || Stepper::with_backend(Backend::Fallback);
    restore(state, 3, fallback(), fallback);
}

/// The SIMD level affects only the time of a step. The groups use the dense solver for few contacts
/// and the sparse factorisation, with discs and with elongated bodies.
#[test]
fn every_simd_level_takes_the_same_steps() {
    for (pi1, n) in [(1.0, 60), (4.0, 5), (4.0, 20), (4.0, 74), (8.0, 200)] {
        let parameters = Parameters {
            pi1,
            ..Parameters::default()
        };
        let mut start = drawn(parameters, n, 7);
        start.configuration.inform(1, 0.5, 1.0, None);
        let run = |level| {
            let (mut state, mut stepper) = (start.clone(), Stepper::with_level(level));
            advance(&mut stepper, &mut state, SETTLING);
            state
        };
        let plain = run(Level::BASELINE);
        assert!(
            n < 20 || 2 * plain.warm_start.contacts.len() > n,
            "too few contacts push"
        );
        for level in Level::available() {
            assert_eq!(
                run(level).hash(),
                plain.hash(),
                "{level:?}, pi1 {pi1}, n {n}"
            );
        }
    }
}

/// No result may depend on the history of the workspace: a stepper that has stepped another swarm
/// gives the same future.
#[test]
fn a_used_stepper_and_another_thread_change_nothing() {
    let mut here = settled_state(74, &mut Stepper::new());
    let there = here.clone();
    let mut used = Stepper::new();
    advance(
        &mut used,
        &mut drawn(
            Parameters {
                pi1: 1.0,
                ..Parameters::default()
            },
            90,
            2,
        ),
        300,
    );
    advance(&mut used, &mut here, 200);
    let far = thread::spawn(move || {
        let mut state = there;
        advance(&mut Stepper::new(), &mut state, 200);
        state
    });
    assert_eq!(far.join().unwrap(), here);
}

/// The warm start affects the last bits of a step and must be part of the state: a state without it
/// has another hash. After a step the positions agree to 1e-8.
#[test]
fn a_state_without_its_warm_start_has_another_hash() {
    let mut stepper = Stepper::new();
    let mut state = settled_state(74, &mut stepper);
    let mut cold = State {
        warm_start: Default::default(),
        ..state.clone()
    };
    assert_ne!(cold.hash(), state.hash());
    stepper.step(&mut state).unwrap();
    stepper.step(&mut cold).unwrap();
    let apart = |a: &[f64], b: &[f64]| {
        a.iter()
            .zip(b)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max)
    };
    assert!(
        apart(&state.configuration.x, &cold.configuration.x) < 1e-8,
        "positions differ by more than rounding"
    );
}
