//! Same bytes: one state has one future, wherever and however often it is computed.

use std::thread;

use jostled::model::{Parameters, State};
use jostled::stepper::Stepper;

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

/// A group of 74 in contact, from the seed alone.
fn settled(stepper: &mut Stepper) -> State {
    let mut state = drawn(Parameters::default(), 74, 1);
    state
        .configuration
        .inform(3, 0.5, 1.0, Some(SETTLING + 150));
    advance(stepper, &mut state, SETTLING);
    assert!(
        state.memory.contacts.len() > 40,
        "{} push",
        state.memory.contacts.len()
    );
    state
}

/// The hash of one run to the last bit. It may change with the model's version or the solver,
/// never with the machine, the thread or the build.
#[test]
fn two_hundred_steps_in_contact_end_in_the_golden_state() {
    let mut stepper = Stepper::new();
    let mut state = settled(&mut stepper);
    advance(&mut stepper, &mut state, 200);
    assert_eq!(hex(&state), GOLDEN);
}

const GOLDEN: &str = "c47dec14770d027d360f7da7454b2fdd9ad75566faa2eee7752fb852e926e5e7";

#[test]
fn a_hundred_restored_states_have_the_same_future() {
    let mut stepper = Stepper::new();
    let mut state = settled(&mut stepper);
    // One stepper runs straight through; each restored state gets a new one.
    let mut restored = Vec::new();
    let mut future = Vec::new();
    for step in 0..300 {
        if step < 100 {
            restored.push(state.clone());
        }
        stepper.step(&mut state).unwrap();
        if step >= 199 {
            future.push(state.hash());
        }
    }
    for (start, mut state) in restored.into_iter().enumerate() {
        advance(&mut Stepper::new(), &mut state, 200);
        assert_eq!(
            state.hash(),
            future[start],
            "restored {start} steps after the settling"
        );
    }
}

/// The workspace may not know what it did before: one that has seen another swarm changes nothing.
#[test]
fn a_used_stepper_and_another_thread_change_nothing() {
    let mut here = settled(&mut Stepper::new());
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
    let mut state = settled(&mut stepper);
    let mut forgetful = State {
        memory: Default::default(),
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
