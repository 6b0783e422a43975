//! Requests as a transport received them.

use std::sync::Arc;

use jostle_proto::Request;

use crate::api::admission::Permit;
use crate::convert::Payload;
use crate::convert::commands::{selector, truncate};
use crate::convert::error::CommandError;

/// Encodings in which requests are read; no encoding is JSON.
const JSON_ENCODINGS: [&str; 5] = [
    "application/json",
    "text/json",
    "text/plain",
    "zenoh/string",
    "zenoh/bytes",
];

/// The connection to the client that sent a request.
pub trait Peer: Send + Sync {
    /// Sends a reply under `key`. It may block while the client accepts nothing.
    fn reply(&self, key: &str, reply: Result<Payload, Payload>);

    /// Whether the key expression of the request matches `key`.
    fn matches(&self, key: &str) -> bool;
}

/// What a key addresses.
#[derive(Clone, Debug)]
pub enum Target {
    /// The `state` of a swarm.
    State(Arc<str>),
    /// `get/**` of a swarm.
    Get(Arc<str>),
    /// `cmd/**` of a swarm.
    Command(Arc<str>),
    /// `cmd/delete` of any swarm, also of one that no longer exists.
    Deletion,
    /// `get/**` of the daemon.
    NodeGet,
    /// `cmd/**` of the daemon.
    NodeCommand,
    /// `experiment/**` of the daemon.
    Experiment,
}

/// A request. Clones are the same request; each may be replied to under another key.
#[derive(Clone)]
pub struct Incoming {
    received: Arc<Received>,
    _permit: Option<Arc<Permit>>,
}

/// The parts of a request.
pub struct Received {
    /// What its key addresses.
    pub target: Target,
    /// The key expression.
    pub key: String,
    /// Whether the key expression contains a wildcard.
    pub is_wild: bool,
    /// The parameters of the selector.
    pub parameters: Vec<(String, String)>,
    /// The payload; empty if there is none.
    pub payload: Vec<u8>,
    /// The encoding of the payload, if there is one.
    pub encoding: Option<String>,
    /// The client's token; empty if there is none.
    pub token: Vec<u8>,
    /// Where replies go.
    pub peer: Box<dyn Peer>,
}

impl Incoming {
    /// A request that was admitted with `permit`.
    pub fn new(received: Received, permit: Permit) -> Self {
        Incoming {
            received: Arc::new(received),
            _permit: Some(Arc::new(permit)),
        }
    }

    /// The same request without its permit: while it waits for a condition, it does not count
    /// against the limit of its queryable.
    #[must_use]
    pub fn without_permit(&self) -> Incoming {
        Incoming {
            received: self.received.clone(),
            _permit: None,
        }
    }

    /// What its key addresses.
    pub fn target(&self) -> &Target {
        &self.received.target
    }

    /// The key expression.
    pub fn key(&self) -> &str {
        &self.received.key
    }

    /// Whether the key expression contains a wildcard.
    pub fn is_wild(&self) -> bool {
        self.received.is_wild
    }

    /// Whether the key expression matches `key`.
    pub fn matches(&self, key: &str) -> bool {
        self.received.peer.matches(key)
    }

    /// Whether it has a payload.
    pub fn has_payload(&self) -> bool {
        !self.received.payload.is_empty()
    }

    /// The client's token; empty if there is none.
    pub fn token(&self) -> &[u8] {
        &self.received.token
    }

    /// The verb of a command; the whole key if there is none.
    pub fn verb(&self) -> String {
        let key = self.key();
        truncate(key.split_once("/cmd/").map_or(key, |(_, verb)| verb))
    }

    /// The parameters of the selector.
    pub fn parameters(&self) -> impl Iterator<Item = (&str, &str)> {
        let parameters = self.received.parameters.iter();
        parameters.map(|(name, value)| (name.as_str(), value.as_str()))
    }

    /// Rejects parameters, except those of zenoh, which begin with `_`.
    ///
    /// # Errors
    ///
    /// [`CommandError::Parameter`].
    pub fn no_parameters(&self) -> Result<(), CommandError> {
        selector(self.parameters(), &[]).map(drop)
    }

    /// Whether a query of states requests JSON.
    ///
    /// # Errors
    ///
    /// [`CommandError::Field`] for an unknown format, [`CommandError::Parameter`].
    pub fn wants_json(&self) -> Result<bool, CommandError> {
        match selector(self.parameters(), &["format"])?.first() {
            None | Some((_, "cbor")) => Ok(false),
            Some((_, "json")) => Ok(true),
            Some(_) => Err(CommandError::Field {
                field: "format",
                problem: "is not json or cbor",
            }),
        }
    }

    /// Parses the payload, of at most `max_bytes`.
    ///
    /// # Errors
    ///
    /// [`CommandError::TooLong`], [`CommandError::Encoding`], [`CommandError::Request`] and
    /// [`CommandError::Parameter`].
    pub fn request(&self, max_bytes: usize) -> Result<Request, CommandError> {
        self.no_parameters()?;
        let Received {
            payload, encoding, ..
        } = &*self.received;
        if payload.len() > max_bytes {
            return Err(CommandError::TooLong {
                bytes: payload.len(),
                max_bytes,
            });
        }
        if let Some(encoding) = encoding
            && !JSON_ENCODINGS.contains(&encoding.as_str())
        {
            return Err(CommandError::Encoding(truncate(encoding)));
        }
        Ok(Request::from_json(payload)?)
    }

    /// Sends a reply under `key`.
    pub fn reply(&self, key: &str, reply: Result<Payload, Payload>) {
        self.received.peer.reply(key, reply);
    }
}
