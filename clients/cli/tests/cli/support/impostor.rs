//! A zenoh peer that is no daemon.

use std::sync::{Arc, Mutex};

use serde_json::Value;
use zenoh::Wait;
use zenoh::query::Query;

use crate::support::{Ended, Running, open_peer};

/// A reply, an error or, as an error of null, no reply.
pub type Answered = Result<Value, Value>;

/// The received payloads, and the selectors of queries without one.
pub type Received = Arc<Mutex<Vec<Vec<u8>>>>;

/// A peer with the tokens of daemons and few replies.
pub struct Impostor {
    /// Where it listens.
    pub endpoint: String,
    session: zenoh::Session,
}

impl Impostor {
    /// Declares the tokens of these keys, and never replies to queries on `silent`.
    pub async fn start(tokens: &[&str], silent: &str, nonsense: &str) -> Self {
        let session = open_peer(zenoh::Config::default()).await;
        // Commands are sent to a daemon only.
        for token in tokens.iter().chain(&["jostle/@node/a/claim/1/serving"]) {
            let token = session.liveliness().declare_token(*token).await.unwrap();
            // It lives as long as the session.
            std::mem::forget(token);
        }
        let held = Mutex::new(Vec::new());
        let hold = move |query| held.lock().unwrap().push(query);
        let queryable = session.declare_queryable(silent).callback(hold);
        queryable.background().await.unwrap();
        let queryable = session
            .declare_queryable(nonsense)
            .callback(|query: Query| {
                let key = query.key_expr().clone();
                query.reply(key, "nonsense").wait().unwrap();
            });
        queryable.background().await.unwrap();
        let endpoint = session.info().locators().await[0].to_string();
        Impostor { endpoint, session }
    }

    /// Replies to queries on a key with these in order, and to all further ones with the last. Returns
    /// what it received.
    pub async fn answer(&self, key: &str, answers: Vec<Answered>) -> Received {
        let received = Received::default();
        let (seen, left) = (received.clone(), Mutex::new(answers));
        let reply = move |query: Query| {
            let payload = query.payload().map(|it| it.to_bytes().into_owned());
            let payload = payload.filter(|bytes| !bytes.is_empty());
            let selector = || query.selector().to_string().into_bytes();
            seen.lock().unwrap().push(payload.unwrap_or_else(selector));
            let mut left = left.lock().unwrap();
            let answer = if left.len() > 1 {
                left.remove(0)
            } else {
                left[0].clone()
            };
            match answer {
                Ok(reply) => query
                    .reply(query.key_expr(), reply.to_string())
                    .wait()
                    .unwrap(),
                Err(Value::Null) => {}
                Err(error) => query.reply_err(error.to_string()).wait().unwrap(),
            }
        };
        let queryable = self.session.declare_queryable(key).callback(reply);
        queryable.background().await.unwrap();
        received
    }

    /// Runs a command line against it.
    pub async fn jostle(&self, line: &str) -> Ended {
        Running::begin(&self.endpoint, line, "").end().await
    }

    /// Closes the session.
    pub async fn stop(self) {
        self.session.close().await.unwrap();
    }
}
