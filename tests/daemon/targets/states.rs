//! States in CBOR, alone and within the reply to a `step`.

use jostle_proto::verbs::StepResult;
use jostle_proto::{Reply, State, to_cbor};

/// A state that is read is equal, to the bit, after it is written and read again.
pub fn check(data: &[u8]) {
    match State::from_cbor(data) {
        Ok(state) => {
            let written = state.to_cbor();
            let again = State::from_cbor(&written).expect("what was written can be read");
            // The bytes are compared, since NaN is not equal to itself.
            assert_eq!(again.to_cbor(), written);
        }
        Err(problem) => assert!(!problem.is_empty()),
    }
    if let Ok(reply) = ciborium::from_reader::<Reply<StepResult>, _>(data) {
        let written = to_cbor(&reply);
        let again: Reply<StepResult> =
            ciborium::from_reader(&written[..]).expect("what was written can be read");
        assert_eq!(to_cbor(&again), written);
    }
}
