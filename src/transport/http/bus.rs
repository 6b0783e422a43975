//! Forwards the requests of the page to the bus, so that they take the same path as those of other
//! clients.

use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use jostle_convert::Place;
use jostle_proto::{Error, ErrorCode};
use tokio::sync::mpsc;
use tokio::task::spawn_blocking;
use zenoh::bytes::Encoding;
use zenoh::key_expr::KeyExpr;
use zenoh::{Session, Wait};

use crate::convert::error::CommandError;
use crate::swarm::recovery_progress::RecoveryProgress;
use crate::transport::open_requests::{OpenRequests, PARAMETER};
use crate::transport::zenoh::session_pool::SessionPool;

/// Longer than any deadline of a request, so that the daemon replies first.
const QUERY_TIMEOUT: Duration = Duration::from_secs(3660);

/// The daemon's own session and the prefix of its keys.
#[derive(Clone)]
pub struct Bus {
    /// The session for queries.
    pub session: Session,
    /// The sessions for subscriptions.
    pub pool: SessionPool,
    /// The first chunk of every key.
    pub prefix: String,
    /// The daemon's name.
    pub node: String,
    /// The swarms that are not recovered yet.
    pub recovery: Arc<RecoveryProgress>,
    /// The requests that wait for a reply.
    pub open: OpenRequests,
}

/// A reply.
pub struct Reply {
    is_ok: bool,
    encoding: &'static str,
    /// The payload.
    pub bytes: Bytes,
}

impl Bus {
    /// The response `busy` if the swarms are not recovered yet.
    pub fn recovering(&self) -> Option<Response> {
        let swarms_left = self.recovery.swarms_left()?;
        Some(error(
            &CommandError::Recovering { swarms_left }.to_wire(None, &Place::default()),
        ))
    }

    /// The whole key of `rest`, in which `@node/` is this node's.
    fn key(&self, rest: &str) -> String {
        match rest.strip_prefix("@node/") {
            Some(rest) => format!("{}/@node/{}/{rest}", self.prefix, self.node),
            None => format!("{}/{rest}", self.prefix),
        }
    }

    /// Sends a query to one key, with selector parameters, an optional request in JSON and the token
    /// of the sender. The error is the response: `invalid_argument` for a wildcard, `not_found` without
    /// a reply, `busy` if that may be because a swarm is not recovered yet.
    ///
    /// If the future is dropped once it was polled, because the client has disconnected, the query is sent
    /// all the same, and [`OpenRequests`] has that its client is gone.
    pub async fn query(
        &self,
        rest: &str,
        parameters: &str,
        request: Option<Bytes>,
        token: Option<&str>,
    ) -> Result<Reply, Response> {
        let key = self.key(rest);
        let is_one_key = KeyExpr::new(key.as_str()).is_ok_and(|key| !key.is_wild());
        if !is_one_key {
            let message = format!("{rest:?} is not a single key");
            return Err(reject(ErrorCode::InvalidArgument, message));
        }
        let open = self.open.begin();
        let own = format!("{PARAMETER}={}", open.name());
        let selector = match parameters {
            "" => format!("{key}?{own}"),
            parameters => format!("{key}?{parameters};{own}"),
        };
        let (session, token) = (self.session.clone(), token.map(str::to_owned));
        // Not a channel of zenoh: that logs an error for each reply to a client that has disconnected.
        let (first, mut replies) = mpsc::channel(1);
        let sending = move || {
            let mut query = session.get(selector).timeout(QUERY_TIMEOUT);
            if let Some(request) = request {
                query = query
                    .payload(request.to_vec())
                    .encoding(Encoding::APPLICATION_JSON);
            }
            if let Some(token) = token {
                query = query.attachment(token);
            }
            let first = move |reply| {
                // An error means that the client has disconnected.
                let _ = first.try_send(reply);
            };
            query.callback(first).wait()
        };
        // Before it is sent: the recovery may end before the reply.
        let recovering = self.recovering();
        // zenoh blocks the thread that sends while it removes what a session has declared.
        let reply = match spawn_blocking(sending).await {
            Ok(Ok(())) => replies.recv().await,
            _ => None,
        };
        let reply = reply.ok_or_else(|| {
            if let Some(busy) = recovering {
                return busy;
            }
            let message = format!("no reply to {rest:?}: check the list of swarms");
            reject(ErrorCode::NotFound, message)
        })?;
        let (is_ok, payload, encoding) = match reply.result() {
            Ok(sample) => (true, sample.payload(), sample.encoding()),
            Err(error) if error.payload().to_bytes().starts_with(b"{") => {
                (false, error.payload(), error.encoding())
            }
            // It is zenoh's own: a daemon behind a router has not replied.
            Err(_) => {
                let message = format!("no reply to {rest:?} in time: retry");
                return Err(reject(ErrorCode::DeadlineExceeded, message));
            }
        };
        let encoding = match *encoding == Encoding::APPLICATION_CBOR {
            true => jostle_proto::CBOR,
            false => jostle_proto::JSON,
        };
        let bytes = Bytes::from(payload.to_bytes().into_owned());
        Ok(Reply {
            is_ok,
            encoding,
            bytes,
        })
    }
}

impl Reply {
    /// The payload, unless it is an error.
    pub fn ok(self) -> Option<Bytes> {
        self.is_ok.then_some(self.bytes)
    }
}

impl IntoResponse for Reply {
    fn into_response(self) -> Response {
        let status = match self.is_ok {
            true => StatusCode::OK,
            false => match serde_json::from_slice::<Error>(&self.bytes) {
                Ok(error) => status(error.code),
                Err(_) => StatusCode::INTERNAL_SERVER_ERROR,
            },
        };
        (status, [(CONTENT_TYPE, self.encoding)], self.bytes).into_response()
    }
}

/// The response for an error of the HTTP server itself.
pub fn reject(code: ErrorCode, message: impl Into<String>) -> Response {
    error(&Error {
        code,
        message: message.into(),
        details: serde_json::Map::new(),
        step: None,
    })
}

fn error(error: &Error) -> Response {
    let text = serde_json::to_string(error).unwrap_or_default();
    let kind = [(CONTENT_TYPE, jostle_proto::JSON)];
    (status(error.code), kind, text).into_response()
}

fn status(code: ErrorCode) -> StatusCode {
    match code {
        ErrorCode::NotFound => StatusCode::NOT_FOUND,
        ErrorCode::InvalidArgument => StatusCode::BAD_REQUEST,
        ErrorCode::AlreadyExists
        | ErrorCode::Conflict
        | ErrorCode::Contested
        | ErrorCode::IncorrectState => StatusCode::CONFLICT,
        ErrorCode::PermissionDenied => StatusCode::FORBIDDEN,
        ErrorCode::ResourceExhausted | ErrorCode::Busy => StatusCode::TOO_MANY_REQUESTS,
        ErrorCode::StorageFull => StatusCode::INSUFFICIENT_STORAGE,
        ErrorCode::DeadlineExceeded => StatusCode::GATEWAY_TIMEOUT,
        ErrorCode::Faulted => StatusCode::UNPROCESSABLE_ENTITY,
        ErrorCode::Internal => StatusCode::INTERNAL_SERVER_ERROR,
    }
}
