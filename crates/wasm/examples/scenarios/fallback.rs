//! Steps that the fallback solver takes.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_convert::snapshot;
use jostle_physics::model::attraction::AttractionWorkspace;
use jostle_physics::model::{State, WarmContact};
use jostle_physics::simulation::{Simulation, Spec};
use jostle_physics::stepper::Stepper;
use jostle_proto::snapshot::SnapshotPhase;
use serde_json::json;

use crate::numbers::Numbers;
use crate::scenario::Scenario;

/// Steps until a drawn group is packed.
const SETTLING: u64 = 1000;

/// How many of the scenarios there must be.
const SCENARIOS: usize = 2;

/// Returns a packed group whose warm start is random over eight decades: with it the exact solver misses
/// its target.
///
/// # Panics
///
/// If too few such groups need the fallback solver: what the scenarios are for would be missing.
pub fn all() -> impl Iterator<Item = Scenario> {
    let mut simulation = Simulation::new(&Spec::new(800, 1)).expect("a group of 800");
    for _ in 0..SETTLING {
        simulation.step().expect("a step of a drawn group");
    }
    let packed = simulation.checkpoint();
    let contacts = contacts_of(&packed.state);
    let needing: Vec<Scenario> = (0..20)
        .filter_map(|seed| {
            let mut checkpoint = packed.clone();
            checkpoint.state.warm_start.contacts = disturbed(&contacts, seed);
            let report = Stepper::new().step(&mut checkpoint.state.clone()).ok()?;
            (report.fallback > 0).then_some(checkpoint)
        })
        .take(SCENARIOS)
        .map(|checkpoint| {
            let doing = SnapshotPhase::Paused {
                reason: String::new(),
            };
            let sealed = snapshot::to_proto("packed", &checkpoint, doing).sealed();
            let encoded = STANDARD.encode(jostle_proto::to_cbor(&sealed));
            let mut scenario = Scenario::new(&json!({"restore": {"snapshot": encoded}}));
            scenario.step(3, 1);
            scenario
        })
        .collect();
    assert_eq!(
        needing.len(),
        SCENARIOS,
        "groups that need the fallback solver"
    );
    needing.into_iter()
}

/// Returns all contacts of the next step's program, without multipliers.
fn contacts_of(state: &State) -> Vec<WarmContact> {
    let mut pull = Vec::new();
    let law = state.parameters.attraction;
    AttractionWorkspace::default().compute(law, &state.configuration, &mut pull);
    let mut stepper = Stepper::new();
    stepper.assemble(state, &pull).expect("a program");
    let contacts = stepper.program().0.contacts.iter();
    let ids = &state.configuration.id;
    contacts
        .map(|contact| WarmContact {
            first: ids[contact.i as usize],
            second: ids[contact.j as usize],
            code: contact.code,
            multiplier: 0.0,
        })
        .collect()
}

/// Returns most of the contacts, with random multipliers.
fn disturbed(contacts: &[WarmContact], seed: u64) -> Vec<WarmContact> {
    let mut numbers = Numbers::new("fallback", seed);
    let mut kept: Vec<WarmContact> = contacts.to_vec();
    for contact in &mut kept {
        contact.multiplier = libm::pow(10.0, -8.0 * numbers.share());
    }
    kept.retain(|_| !numbers.chance(10));
    kept
}
