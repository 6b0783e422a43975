//! Replies and samples as received: JSON or CBOR.

use std::ops::Deref;
use std::time::SystemTime;

use jostle_proto::{Attachment, CBOR, JSON, State};
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
    attachment: Option<Vec<u8>>,
    received: Option<SystemTime>,
}

impl Payload {
    pub(crate) fn of_json(text: &str) -> Self {
        Payload {
            bytes: text.as_bytes().to_vec(),
            encoding: Encoding::from(JSON),
            attachment: None,
            received: None,
        }
    }

    /// That of a sample that a subscriber received at this time.
    pub(crate) fn received(sample: &Sample, at: SystemTime) -> Self {
        Payload {
            received: Some(at),
            ..Payload::from(sample)
        }
    }

    /// Decodes it, from JSON or CBOR.
    ///
    /// # Errors
    ///
    /// [`Error::Decode`].
    pub fn read<T: DeserializeOwned>(&self) -> Result<T, Error> {
        if self.is_cbor() {
            ciborium::from_reader(self.bytes.as_slice()).map_err(Error::decode)
        } else {
            serde_json::from_slice(&self.bytes).map_err(Error::decode)
        }
    }

    pub(crate) fn is_cbor(&self) -> bool {
        self.encoding == Encoding::from(CBOR)
    }

    /// Its bytes.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// What is attached to a sample: an [`Attachment`] in CBOR, if it is a state.
    pub fn attachment(&self) -> Option<&[u8]> {
        self.attachment.as_deref()
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
            attachment: sample.attachment().map(|it| it.to_bytes().into_owned()),
            received: None,
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

/// What is attached to a published state: `None` in a reply, and from an older daemon.
impl Message<State> {
    /// The times of the state, and the set-points in it.
    #[must_use]
    pub fn attachment(&self) -> Option<Attachment> {
        Attachment::from_cbor(self.payload.attachment()?).ok()
    }

    /// When the step that led to the state was taken, by the daemon's clock; also `None` if the daemon
    /// does not know that, as before the first step.
    #[must_use]
    pub fn stepped_at(&self) -> Option<SystemTime> {
        self.attachment()?.stepped_at()
    }

    /// When the daemon published the state, by its clock.
    #[must_use]
    pub fn published_at(&self) -> Option<SystemTime> {
        self.attachment()?.published_at()
    }

    /// When this process received the state, by its clock, which is before it left the queue of the
    /// stream.
    #[must_use]
    pub fn received_at(&self) -> Option<SystemTime> {
        self.payload.received
    }

    /// The seconds from the publication of the state until it was received. Between two machines it
    /// includes the difference of their clocks, and may be negative.
    #[must_use]
    pub fn latency(&self) -> Option<f64> {
        let (published, received) = (self.published_at()?, self.received_at()?);
        Some(match received.duration_since(published) {
            Ok(latency) => latency.as_secs_f64(),
            Err(error) => -error.duration().as_secs_f64(),
        })
    }
}

impl<T> Deref for Message<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}
