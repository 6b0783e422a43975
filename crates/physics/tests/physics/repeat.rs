//! Same bytes: one state has one future, wherever and however often it is computed.

use std::thread;

use jostle_physics::model::attraction::AttractionWorkspace;
use jostle_physics::model::random::{Purpose, Stream};
use jostle_physics::model::simd::Level;
use jostle_physics::model::{Parameters, State, WarmContact};
use jostle_physics::stepper::Stepper;
use jostle_physics::stepper::solve::Backend;

use crate::{advance, drawn};

/// Steps until a drawn group of 74 has closed up and pushes: t = 20.
const SETTLING: u64 = 1000;

fn hex(state: &State) -> String {
    state
        .hash()
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

/// A group of `n` in contact, from the seed alone.
fn settled(n: usize, stepper: &mut Stepper) -> State {
    let mut state = drawn(Parameters::default(), n, 1);
    state
        .configuration
        .inform(3, 0.5, 1.0, Some(SETTLING + 150));
    advance(stepper, &mut state, SETTLING);
    let pushing = state.warm_start.contacts.len();
    assert!(2 * pushing > n, "{pushing} push");
    state
}

/// The hash of one run to the last bit. It may change with the model's version or the solver,
/// never with the machine, the thread or the build.
#[test]
fn two_hundred_steps_in_contact_end_in_the_golden_state() {
    let mut stepper = Stepper::new();
    let mut state = settled(74, &mut stepper);
    advance(&mut stepper, &mut state, 200);
    assert_eq!(hex(&state), GOLDEN);
}

const GOLDEN: &str = "292b6ba2b9ad2ed2dc620e00971bb26eabf39745c25908e915a84b49aadbc538";

/// How far a restored state is followed.
const AHEAD: usize = 200;

/// Steps on from `state`, and again with a new stepper each from the first `points` states on
/// the way: [`AHEAD`] steps after any of them the hash is that of the one run straight through.
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
        let state = settled(n, &mut stepper);
        restore(state, 100, stepper, Stepper::new);
    }
}

/// A settled group that remembers nearly every contact of its next step as one that pushed, and
/// how hard at random over eight decades, so that this step needs the fallback. It has to be large:
/// of a few hundred none is at a loss.
fn at_a_loss(stepper: &mut Stepper) -> State {
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
    let mut confused = (0..20).map(|seed| {
        let mut stream = Stream::new(seed, 0, 0, Purpose::Selection);
        let mut state = settled.clone();
        let remembered = contacts.iter().map(|contact| WarmContact {
            first: state.configuration.id[contact.i as usize],
            second: state.configuration.id[contact.j as usize],
            code: contact.code,
            multiplier: libm::pow(10.0, -8.0 * stream.uniform()),
        });
        state.warm_start.contacts = remembered.collect();
        state.warm_start.contacts.retain(|_| stream.uniform() < 0.9);
        state
    });
    let is_at_a_loss = |state: &State| stepper.step(&mut state.clone()).unwrap().fallback > 0;
    confused.find(is_at_a_loss).expect("nearly all are")
}

#[test]
fn a_state_restored_into_a_step_of_the_referee_has_the_same_future() {
    let mut stepper = Stepper::new();
    let state = at_a_loss(&mut stepper);
    restore(state, 10, stepper, Stepper::new);
}

#[test]
fn the_referee_alone_remembers_nothing() {
    let state = settled(74, &mut Stepper::new());
    let fallback = || Stepper::with_backend(Backend::Fallback);
    restore(state, 3, fallback(), fallback);
}

/// Vector lanes decide how long a step takes and nothing else. The groups are solved by the small
/// factor and by the large one, of discs and of bodies that turn.
#[test]
fn every_level_of_the_processor_takes_the_same_steps() {
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
            "too few push"
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

/// The workspace may not know what it did before: one that has seen another swarm changes nothing.
#[test]
fn a_used_stepper_and_another_thread_change_nothing() {
    let mut here = settled(74, &mut Stepper::new());
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

/// The solver's memory decides last bits, so it must be in the state: without it the hash
/// differs from the first step on.
#[test]
fn a_state_without_its_memory_has_another_hash() {
    let mut stepper = Stepper::new();
    let mut state = settled(74, &mut stepper);
    let mut forgetful = State {
        warm_start: Default::default(),
        ..state.clone()
    };
    assert_ne!(forgetful.hash(), state.hash());
    stepper.step(&mut state).unwrap();
    stepper.step(&mut forgetful).unwrap();
    let apart = |a: &[f64], b: &[f64]| {
        a.iter()
            .zip(b)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max)
    };
    assert!(
        apart(&state.configuration.x, &forgetful.configuration.x) < 1e-8,
        "only last bits differ"
    );
}
