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
    /// Not a runtime that zenoh works with.
    #[error(
        "zenoh needs a multi-thread runtime of tokio: use #[tokio::main(flavor = \"multi_thread\")] or \
         #[tokio::test(flavor = \"multi_thread\")], or tokio::runtime::Builder::new_multi_thread()"
    )]
    Runtime,
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
        "{target} exists but does not reply: it is suspended or shutting down, or its access control \
         drops the request; retry, or use credentials that permit it"
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
    /// Whether a later retry may succeed without any other action: the daemon is unreachable, recovers its
    /// swarms or is busy, or did not reply in time. A wrong name, of a swarm, a daemon, a host or in a
    /// certificate, and credentials or a role that do not permit it stay wrong.
    pub fn is_transient(&self) -> bool {
        match self {
            Error::Rejected(error) => error.code == ErrorCode::Busy,
            Error::NoDaemon { .. }
            | Error::Mute { .. }
            | Error::NoNode { .. }
            | Error::Silent { .. }
            | Error::TimedOut { .. } => true,
            Error::Option { .. }
            | Error::Runtime
            | Error::UnknownHost { .. }
            | Error::NotAdmitted { .. }
            | Error::WrongName { .. }
            | Error::UnknownNode { .. }
            | Error::ManyNodes { .. }
            | Error::NoSwarm { .. }
            | Error::NotRecovered { .. }
            | Error::TooLarge { .. }
            | Error::Decode { .. }
            | Error::Internal { .. } => false,
        }
    }

    /// Whether it is derived from a missing reply.
    pub(crate) fn is_silence(&self) -> bool {
        matches!(
            self,
            Error::Silent { .. }
                | Error::NoNode { .. }
                | Error::NoSwarm { .. }
                | Error::UnknownNode { .. }
        )
    }

    /// Whether the daemon has executed nothing, and may later.
    pub(crate) fn is_busy(&self) -> bool {
        matches!(self, Error::Rejected(error) if error.code == ErrorCode::Busy)
    }

    /// Whether the daemon has not yet recovered its swarms after a start.
    pub(crate) fn is_recovering(&self) -> bool {
        let Error::Rejected(error) = self else {
            return false;
        };
        let reason = error.details.get("reason");
        error.code == ErrorCode::Busy && reason.is_some_and(|it| it == "recovering")
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

#[cfg(test)]
mod tests {
    use serde_json::{Map, json};

    use super::*;

    fn text() -> String {
        "a".to_owned()
    }

    /// Every error, by whether a retry may succeed without any other action.
    #[test]
    fn only_what_may_pass_by_itself_is_transient() {
        let rejected = |code| {
            Error::rejected(jostle_proto::Error {
                code,
                message: text(),
                details: Map::new(),
                step: None,
            })
        };
        let (endpoint, there) = (text, Vec::new);
        let transient = [
            rejected(ErrorCode::Busy),
            Error::NoDaemon {
                endpoint: endpoint(),
                cause: text(),
            },
            Error::Mute {
                endpoint: endpoint(),
                secs: 1.0,
            },
            Error::NoNode {
                endpoint: endpoint(),
                prefix: text(),
            },
            Error::Silent { target: text() },
            Error::TimedOut {
                target: text(),
                secs: 1.0,
            },
        ];
        for error in transient {
            assert!(error.is_transient(), "{error:?}");
        }
        let lasting = [
            Error::Option {
                option: "node",
                problem: text(),
            },
            Error::Runtime,
            Error::UnknownHost {
                endpoint: endpoint(),
                host: text(),
            },
            Error::NotAdmitted {
                endpoint: endpoint(),
                person: None,
            },
            Error::WrongName {
                endpoint: endpoint(),
                host: text(),
                names: there(),
            },
            Error::UnknownNode {
                node: text(),
                there: there(),
            },
            Error::ManyNodes { there: there() },
            Error::NoSwarm {
                swarm: text(),
                there: there(),
            },
            Error::NotRecovered { swarm: text() },
            Error::TooLarge { bytes: 2, limit: 1 },
            Error::Decode { problem: text() },
            Error::Internal { problem: text() },
        ];
        let codes = [
            ErrorCode::NotFound,
            ErrorCode::AlreadyExists,
            ErrorCode::InvalidArgument,
            ErrorCode::IncorrectState,
            ErrorCode::ResourceExhausted,
            ErrorCode::Conflict,
            ErrorCode::Contested,
            ErrorCode::PermissionDenied,
            ErrorCode::StorageFull,
            ErrorCode::DeadlineExceeded,
            ErrorCode::Faulted,
            ErrorCode::Internal,
        ];
        for error in lasting.into_iter().chain(codes.map(rejected)) {
            assert!(!error.is_transient(), "{error:?}");
        }
    }

    #[test]
    fn only_busy_with_the_reason_is_of_a_recovery() {
        let error = |code, details| {
            Error::rejected(jostle_proto::Error {
                code,
                message: text(),
                details: serde_json::from_value(details).unwrap_or_default(),
                step: None,
            })
        };
        let recovering = json!({"reason": "recovering", "swarms_left": 3});
        assert!(error(ErrorCode::Busy, recovering.clone()).is_recovering());
        assert!(!error(ErrorCode::Busy, json!({"reason": "handover"})).is_recovering());
        assert!(!error(ErrorCode::Busy, json!({})).is_recovering());
        assert!(!error(ErrorCode::Internal, recovering).is_recovering());
    }
}
