//! What can be done with the type of a message.

use schemars::JsonSchema;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::walk::Arguments;

/// What is done with the type of a message.
pub trait Visitor {
    /// What it gives.
    type Output;

    /// The envelope of requests.
    fn request(self) -> Self::Output;

    /// What a daemon receives: arguments of a verb, or set-points.
    fn received<T: Arguments + Serialize>(self) -> Self::Output;

    /// What a daemon sends.
    fn sent<T: JsonSchema + DeserializeOwned + Serialize>(self) -> Self::Output;
}
