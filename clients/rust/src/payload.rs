//! Replies and samples as received: JSON or CBOR.

use std::ops::Deref;

use jostle_proto::{CBOR, JSON};
use serde::de::DeserializeOwned;
use serde_json::value::RawValue;
use zenoh::bytes::Encoding;
use zenoh::sample::Sample;

use crate::error::Error;

/// A reply or a sample as received.
#[derive(Clone, Debug)]
pub struct Payload {
    bytes: Vec<u8>,
    encoding: Encoding,
}

impl Payload {
    pub(crate) fn of_json(text: &str) -> Self {
        Payload {
            bytes: text.as_bytes().to_vec(),
            encoding: Encoding::from(JSON),
        }
    }

    /// Decodes it, from JSON or CBOR.
    ///
    /// # Errors
    ///
    /// [`Error::Decode`].
    pub fn read<T: DeserializeOwned>(&self) -> Result<T, Error> {
        if self.encoding == Encoding::from(CBOR) {
            ciborium::from_reader(self.bytes.as_slice()).map_err(Error::decode)
        } else {
            serde_json::from_slice(&self.bytes).map_err(Error::decode)
        }
    }

    /// Its bytes.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Its JSON.
    ///
    /// # Errors
    ///
    /// [`Error::Decode`] if it is not JSON.
    pub fn json(&self) -> Result<&str, Error> {
        let raw: &RawValue = serde_json::from_slice(&self.bytes).map_err(Error::decode)?;
        Ok(raw.get())
    }
}

impl From<&Sample> for Payload {
    fn from(sample: &Sample) -> Self {
        Payload {
            bytes: sample.payload().to_bytes().into_owned(),
            encoding: sample.encoding().clone(),
        }
    }
}

/// A decoded message and its payload, which may have fields of a newer version of the contract.
#[derive(Clone, Debug)]
pub struct Message<T> {
    /// The decoded message.
    pub value: T,
    /// The message as received.
    pub payload: Payload,
}

impl<T: DeserializeOwned> TryFrom<Payload> for Message<T> {
    type Error = Error;

    fn try_from(payload: Payload) -> Result<Self, Error> {
        let value = payload.read()?;
        Ok(Message { value, payload })
    }
}

impl<T> Deref for Message<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}
