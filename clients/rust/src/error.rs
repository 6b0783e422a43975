//! Why a request failed.

use jostle_proto::ErrorCode;

/// Why a request failed. Messages end with a remedy.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The daemon replied with an error.
    #[error("{}", .0.message)]
    Rejected(Box<jostle_proto::Error>),
    /// A field of [`ConnectOptions`](crate::ConnectOptions) is invalid.
    #[error("invalid {option}: {problem}")]
    Option {
        /// The field.
        option: &'static str,
        /// What is wrong with its value, and the remedy.
        problem: String,
    },
    /// Nothing listens at the endpoint, or the connection was lost.
    #[error("no daemon answers at {endpoint} ({cause}): start one with `jostled serve`")]
    NoDaemon {
        /// The endpoint.
        endpoint: String,
        /// The error of zenoh.
        cause: String,
    },
    /// The host of the endpoint has no address.
    #[error("no address is known of the host {host} in {endpoint}: use another endpoint")]
    UnknownHost {
        /// The endpoint.
        endpoint: String,
        /// The name in it.
        host: String,
    },
    /// A process accepts the connection and does not reply.
    #[error(
        "something accepts connections at {endpoint} but sent no reply in {secs} s: it may hang; \
         look at its process"
    )]
    Mute {
        /// The endpoint.
        endpoint: String,
        /// The timeout, seconds.
        secs: f64,
    },
    /// A process listens at the endpoint and rejects this client.
    #[error("{endpoint} does not accept this client: give credentials that its daemon knows")]
    NotAdmitted {
        /// The endpoint.
        endpoint: String,
        /// The person in the credentials, if any.
        person: Option<String>,
    },
    /// The certificate of the daemon is for other names than that of the endpoint.
    #[error("the certificate of {endpoint} does not name {host}: use one of {}", .names.join(", "))]
    WrongName {
        /// The endpoint.
        endpoint: String,
        /// The name or address in it.
        host: String,
        /// The names in the certificate.
        names: Vec<String>,
    },
    /// A zenoh session answers, but no daemon is known under the prefix.
    #[error("no daemon is known at {endpoint} under the prefix {prefix:?}: start one there")]
    NoNode {
        /// The endpoint.
        endpoint: String,
        /// The first chunk of the keys.
        prefix: String,
    },
    /// The node does not exist.
    #[error("no node {node}: use one of {}", .there.join(", "))]
    UnknownNode {
        /// The node.
        node: String,
        /// The nodes that exist.
        there: Vec<String>,
    },
    /// A request to a daemon, of which there are several, and none was named.
    #[error("several daemons: set ConnectOptions::node to one of {}", .there.join(", "))]
    ManyNodes {
        /// The nodes that exist.
        there: Vec<String>,
    },
    /// No daemon hosts the swarm.
    #[error("no swarm {swarm}: there are {}", .there.join(", "))]
    NoSwarm {
        /// The swarm.
        swarm: String,
        /// The swarms that exist.
        there: Vec<String>,
    },
    /// The daemon came back after an interruption, without the swarm that was followed.
    #[error("the daemon is back, but without {swarm}: create the swarm again")]
    NotRecovered {
        /// The swarm.
        swarm: String,
    },
    /// The receiver exists but sent no reply.
    #[error(
        "{target} exists but does not reply: it is shutting down, or its access control drops the \
         request; retry, or use credentials that permit it"
    )]
    Silent {
        /// A swarm or a node.
        target: String,
    },
    /// No reply within the timeout; the request may still be executed.
    #[error(
        "{target} did not reply in {secs} s: it may still execute the request; raise the timeout"
    )]
    TimedOut {
        /// A swarm or a node.
        target: String,
        /// The timeout, seconds.
        secs: f64,
    },
    /// The request is longer than the daemon accepts.
    #[error("the request has {bytes} bytes, and the daemon accepts {limit}: split it")]
    TooLarge {
        /// The length of the request.
        bytes: u64,
        /// The daemon's limit.
        limit: u64,
    },
    /// A message cannot be decoded.
    #[error("undecodable message ({problem}): daemon and client may need the same version")]
    Decode {
        /// What is wrong with it.
        problem: String,
    },
    /// An operation of the zenoh session failed, or arguments cannot be encoded.
    #[error("internal error: {problem}")]
    Internal {
        /// What happened.
        problem: String,
    },
}

impl Error {
    /// Whether a later retry may succeed without any other action: the daemon is unreachable or
    /// busy, did not reply in time, or access control rejected the request.
    pub fn is_transient(&self) -> bool {
        match self {
            Error::Rejected(error) => {
                matches!(error.code, ErrorCode::Busy | ErrorCode::PermissionDenied)
            }
            Error::NoDaemon { .. }
            | Error::UnknownHost { .. }
            | Error::Mute { .. }
            | Error::NoNode { .. }
            | Error::NotAdmitted { .. }
            | Error::WrongName { .. }
            | Error::Silent { .. }
            | Error::TimedOut { .. } => true,
            _ => false,
        }
    }

    /// Whether the swarm or what the request names does not exist.
    pub fn is_not_found(&self) -> bool {
        match self {
            Error::Rejected(error) => error.code == ErrorCode::NotFound,
            Error::UnknownNode { .. } | Error::NoSwarm { .. } | Error::NotRecovered { .. } => true,
            _ => false,
        }
    }

    pub(crate) fn rejected(error: jostle_proto::Error) -> Self {
        Error::Rejected(Box::new(error))
    }

    #[expect(clippy::needless_pass_by_value, reason = "for `map_err`")]
    pub(crate) fn decode(error: impl ToString) -> Self {
        let problem = error.to_string();
        Error::Decode { problem }
    }

    #[expect(clippy::needless_pass_by_value, reason = "for `map_err`")]
    pub(crate) fn internal(error: impl ToString) -> Self {
        let problem = error.to_string();
        Error::Internal { problem }
    }
}
