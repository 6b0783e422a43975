//! A row of a swarm's journal.

use jostle_convert::Place;
use jostle_proto::Request;
use jostled::convert::commands;
use jostled::persistence::writer::{read_record, record};
use jostled::swarm::journal::Record;
use serde_json::value::RawValue;

/// A row is read or rejected with a message. One that is read is written as the same row, and the command
/// in it is parsed or rejected as on recovery.
pub fn check(data: &[u8]) {
    let read = match read_record(data) {
        Ok(read) => read,
        Err(error) => return assert!(!error.to_string().is_empty()),
    };
    let (kind, written) = record(&read);
    let again = read_record(&written).expect("what was written can be read");
    // The bytes are compared, since NaN is not equal to itself.
    assert_eq!(record(&again), (kind, written));
    let Record::Input { sender, .. } = read else {
        return;
    };
    let Ok(args) = RawValue::from_string(sender.args.clone()) else {
        return;
    };
    let request = Request {
        args: Some(args),
        ..Request::default()
    };
    if let Err(error) = commands::read_journaled(sender.verb, &request) {
        assert!(!error.to_wire(None, &Place::default()).message.is_empty());
    }
}
