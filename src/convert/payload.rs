//! Encoded messages.

use jostle_proto as proto;
use serde::Serialize;

/// Initial capacity of a payload: most messages are no longer.
const INITIAL_CAPACITY: usize = 512;

/// Maximum size of a reply that is cached with its state.
const MAX_CACHED_BYTES: usize = 4096;

#[derive(Clone, Debug)]
pub struct Payload {
    pub bytes: Vec<u8>,
    /// Their encoding: [`proto::JSON`] or [`proto::CBOR`].
    pub encoding: &'static str,
    /// The JSON that a retry of the request gets instead, if the bytes are too large for the cache.
    pub to_cache: Option<Vec<u8>>,
}

impl Payload {
    fn new(bytes: Vec<u8>, encoding: &'static str) -> Self {
        Payload {
            bytes,
            encoding,
            to_cache: None,
        }
    }

    pub fn json<T: Serialize>(message: &T) -> Self {
        let mut bytes = Vec::with_capacity(INITIAL_CAPACITY);
        // All numbers are finite and all keys are strings, so this cannot fail.
        serde_json::to_writer(&mut bytes, message).expect("messages are JSON");
        Payload::new(bytes, proto::JSON)
    }

    pub fn cbor<T: Serialize>(message: &T) -> Self {
        Payload::new(proto::to_cbor(message), proto::CBOR)
    }

    /// Encodes a reply as CBOR. If it is large, `leave_out` removes the state from the cached
    /// reply.
    pub(super) fn with_state<T: Serialize>(
        mut reply: proto::Reply<T>,
        leave_out: impl FnOnce(&mut T),
    ) -> Self {
        let mut payload = Payload::cbor(&reply);
        if payload.bytes.len() > MAX_CACHED_BYTES {
            leave_out(&mut reply.result);
            payload.to_cache = Some(Payload::json(&reply).bytes);
        }
        payload
    }

    /// The payload that a retry of the request gets.
    pub fn cached(&self) -> Payload {
        match &self.to_cache {
            Some(bytes) => Payload::new(bytes.clone(), proto::JSON),
            None => self.clone(),
        }
    }
}
