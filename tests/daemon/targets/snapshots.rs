//! A snapshot, as `restore` reads it.

use jostle_physics::stepper::Stepper;
use jostle_proto::{Snapshot, to_cbor};
use jostled::convert::{durable, validate};
use jostled::persistence::checkpoints::read_snapshot;

/// Groups larger than this are not stepped here.
const MAX_STEPPED: usize = 64;

/// Bytes are a snapshot or are refused in words. What restoring accepts is written as the same
/// snapshot, and can be stepped or ends in an error.
pub fn hold(data: &[u8]) {
    if let Err(problem) = read_snapshot(data) {
        assert!(!problem.is_empty());
    }
    let Ok(mut snapshot) = Snapshot::from_cbor(data) else {
        return;
    };
    // Made-up bytes do not have the hashes that they name: they are given these.
    let Ok((_, state)) = jostle_convert::snapshot::state(&snapshot) else {
        return;
    };
    snapshot.state_hash = jostle_convert::hexadecimal(&state.hash());
    let sealed = snapshot.sealed();
    let checkpoint = match read_snapshot(&to_cbor(&sealed)) {
        Ok(checkpoint) => checkpoint,
        Err(problem) => return assert!(!problem.is_empty()),
    };
    if let Err(error) = validate::check(&checkpoint) {
        return assert!(!error.to_string().is_empty());
    }
    let written = durable::snapshot(&sealed.swarm, &checkpoint);
    assert_eq!(written.state_hash, sealed.state_hash);
    assert!(read_snapshot(&to_cbor(&written.sealed())).is_ok());
    let mut state = checkpoint.simulation.state;
    if state.configuration.n() <= MAX_STEPPED {
        let mut stepper = Stepper::new();
        let _ = (0..3).try_for_each(|_| stepper.step(&mut state).map(drop));
    }
}
