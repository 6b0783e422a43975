//! Replies, errors and events as clients read them.

use std::fmt::Debug;

use jostle_proto::verbs::{
    BatchResult, CreateResult, EmptyResult, IdsResult, ResetResult, RunResult, Scheduled,
    SetResult, StepResult,
};
use jostle_proto::{
    Error, Event, Events, Hello, Journal, NodeReply, NodeStatus, OrderSample, Parameters, Reply,
    Schemas, Spec, State, Status, Swarms,
};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

/// Every message there is, chosen by the first byte.
const READERS: [fn(&[u8]); 23] = [
    read::<Error>,
    read::<Event>,
    read::<OrderSample>,
    read::<State>,
    read::<Reply<BatchResult>>,
    read::<Reply<CreateResult>>,
    read::<Reply<EmptyResult>>,
    read::<Reply<IdsResult>>,
    read::<Reply<ResetResult>>,
    read::<Reply<RunResult>>,
    read::<Reply<Scheduled>>,
    read::<Reply<SetResult>>,
    read::<Reply<StepResult>>,
    read::<Reply<Status>>,
    read::<Reply<Parameters>>,
    read::<Reply<Events>>,
    read::<Reply<Journal>>,
    read::<NodeReply<Hello>>,
    read::<NodeReply<NodeStatus>>,
    read::<NodeReply<Schemas>>,
    read::<NodeReply<Swarms>>,
    // A spec is part of a request too, so it alone rejects unknown fields.
    read_strictly::<Spec>,
    read::<Value>,
];

/// A message that is read is equal after it is written and read again, also with a field of a later
/// version.
pub fn check(data: &[u8]) {
    if let [kind, text @ ..] = data {
        READERS[usize::from(*kind) % READERS.len()](text);
    }
}

fn read<T: DeserializeOwned + Serialize + PartialEq + Debug>(text: &[u8]) {
    let Ok(message) = serde_json::from_slice::<T>(text) else {
        return;
    };
    read_strictly::<T>(text);
    let mut newer: Value = serde_json::to_value(&message).expect("it can be written");
    if let Value::Object(fields) = &mut newer
        && std::any::type_name::<T>() != std::any::type_name::<Value>()
    {
        fields.insert("of_a_later_version".into(), Value::Bool(true));
        let newer = newer.to_string();
        let read: Result<T, _> = serde_json::from_str(&newer);
        assert_eq!(read.ok(), Some(message), "{newer}");
    }
}

fn read_strictly<T: DeserializeOwned + Serialize + PartialEq + Debug>(text: &[u8]) {
    let Ok(message) = serde_json::from_slice::<T>(text) else {
        return;
    };
    let written = serde_json::to_vec(&message).expect("it can be written");
    let again: T = serde_json::from_slice(&written).expect("what was written can be read");
    assert_eq!(again, message);
}
