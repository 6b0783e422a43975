//! What the page asks and orders goes over the bus, as everybody's does: it is checked, answered,
//! named and written down in the same places.

use std::time::Duration;

use axum::body::Bytes;
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use jostle_proto::{Error, ErrorCode};
use tokio::task::spawn_blocking;
use zenoh::bytes::Encoding;
use zenoh::key_expr::KeyExpr;
use zenoh::{Session, Wait};

use crate::transport::zenoh::session_pool::SessionPool;

/// Longer than any `timeout_secs` that a page gives; the daemon answers before.
const PATIENCE: Duration = Duration::from_secs(70);

/// The daemon's own session, and whose keys it asks.
#[derive(Clone)]
pub struct Bus {
    /// The session.
    pub session: Session,
    /// The sessions that subscribe to swarms.
    pub pool: SessionPool,
    /// The first chunk of every key.
    pub prefix: String,
    /// The daemon's name.
    pub node: String,
}

/// What was answered.
pub struct Answer {
    is_ok: bool,
    encoding: &'static str,
    /// The payload.
    pub bytes: Bytes,
}

impl Bus {
    /// The whole key of `rest`, in which `@node/` is this node's.
    fn key(&self, rest: &str) -> String {
        match rest.strip_prefix("@node/") {
            Some(rest) => format!("{}/@node/{}/{rest}", self.prefix, self.node),
            None => format!("{}/{rest}", self.prefix),
        }
    }

    /// Asks under one key, with the parameters of a selector behind its `?`, a request in JSON if
    /// there is one, and the token of whoever asks.
    ///
    /// # Errors
    ///
    /// What there is to tell when nobody answers.
    pub async fn ask(
        &self,
        rest: &str,
        parameters: &str,
        request: Option<Bytes>,
        token: Option<&str>,
    ) -> Result<Answer, Error> {
        let key = self.key(rest);
        let is_one_key = KeyExpr::new(key.as_str()).is_ok_and(|key| !key.is_wild());
        if !is_one_key {
            let told = format!("{rest:?} is not one key");
            return Err(told_of(ErrorCode::InvalidArgument, told));
        }
        let selector = match parameters {
            "" => key,
            parameters => format!("{key}?{parameters}"),
        };
        let (session, token) = (self.session.clone(), token.map(str::to_owned));
        let sending = move || {
            let mut query = session.get(selector).timeout(PATIENCE);
            if let Some(request) = request {
                query = query
                    .payload(request.to_vec())
                    .encoding(Encoding::APPLICATION_JSON);
            }
            if let Some(token) = token {
                query = query.attachment(token);
            }
            query.wait()
        };
        let silence = || {
            let told = format!("nothing answers under {rest:?}: look at the list of swarms");
            told_of(ErrorCode::NotFound, told)
        };
        // zenoh blocks the thread that sends while it removes what a session has declared.
        let answers = spawn_blocking(sending).await.map_err(|_| silence())?;
        let answers = answers.map_err(|_| silence())?;
        let answer = answers.recv_async().await.map_err(|_| silence())?;
        let (is_ok, payload, encoding) = match answer.result() {
            Ok(sample) => (true, sample.payload(), sample.encoding()),
            Err(error) => (false, error.payload(), error.encoding()),
        };
        let encoding = match *encoding == Encoding::APPLICATION_CBOR {
            true => jostle_proto::CBOR,
            false => jostle_proto::JSON,
        };
        let bytes = Bytes::from(payload.to_bytes().into_owned());
        Ok(Answer {
            is_ok,
            encoding,
            bytes,
        })
    }
}

impl Answer {
    /// The payload, if it is no error.
    pub fn ok(self) -> Option<Bytes> {
        self.is_ok.then_some(self.bytes)
    }
}

impl IntoResponse for Answer {
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

/// An error that the daemon itself did not answer with.
pub fn told_of(code: ErrorCode, message: impl Into<String>) -> Error {
    Error {
        code,
        message: message.into(),
        details: serde_json::Map::new().into_iter().collect(),
        step: None,
    }
}

/// An error as HTTP has it.
pub fn refuse(error: &Error) -> Response {
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
