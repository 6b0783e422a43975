//! The parameters behind the question mark of a selector.

use jostle_convert::Place;
use jostle_proto::ErrorCode;
use jostled::api::incoming;
use jostled::convert::commands::{CommandError, wait};
use zenoh::query::Parameters;

/// A wait has one condition, a page is within its limits, and a rejection has a message.
pub fn check(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    let parameters = Parameters::from(text);
    match wait::read(parameters.iter()) {
        Ok((_, patience)) => assert!(patience <= wait::MAX_WAIT),
        Err(error) => is_worded(&error),
    }
    match incoming::page(parameters.iter()) {
        Ok((_, limit)) => assert!((1..=1000).contains(&limit)),
        Err(error) => is_worded(&error),
    }
}

fn is_worded(error: &CommandError) {
    let error = error.to_wire(None, &Place::default());
    assert_eq!(error.code, ErrorCode::InvalidArgument);
    assert!(error.message.chars().count() < 1000, "{}", error.message);
    assert!(error.details.contains_key("field"), "{error:?}");
}
