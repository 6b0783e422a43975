//! What comes back: JSON or CBOR, a value or as it came.

use jostle_proto::CBOR;
use serde::de::DeserializeOwned;
use serde_json::value::RawValue;
use zenoh::bytes::Encoding;
use zenoh::sample::Sample;

use crate::failure::Failure;

/// What came back.
pub struct Answer {
    payload: Vec<u8>,
    encoding: Encoding,
}

impl Answer {
    /// The answer as a value, whatever it was encoded as.
    ///
    /// # Errors
    ///
    /// [`Failure::Unreadable`] when it is something else.
    pub fn read<T: DeserializeOwned>(&self) -> Result<T, Failure> {
        if self.encoding == Encoding::from(CBOR) {
            ciborium::from_reader(self.payload.as_slice()).map_err(Failure::unreadable)
        } else {
            serde_json::from_slice(&self.payload).map_err(Failure::unreadable)
        }
    }

    /// The answer as it came.
    pub fn bytes(&self) -> &[u8] {
        &self.payload
    }

    /// The JSON of the answer as it came.
    ///
    /// # Errors
    ///
    /// [`Failure::Unreadable`] when it is no JSON.
    pub fn json(&self) -> Result<&str, Failure> {
        let text = std::str::from_utf8(&self.payload).map_err(Failure::unreadable)?;
        let raw: &RawValue = serde_json::from_str(text).map_err(Failure::unreadable)?;
        Ok(raw.get())
    }
}

impl From<&Sample> for Answer {
    fn from(sample: &Sample) -> Self {
        Answer {
            payload: sample.payload().to_bytes().into_owned(),
            encoding: sample.encoding().clone(),
        }
    }
}
