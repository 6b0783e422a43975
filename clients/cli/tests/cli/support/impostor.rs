//! Something that speaks zenoh and is no daemon.

use std::sync::{Arc, Mutex};

use serde_json::Value;
use zenoh::Wait;
use zenoh::query::Query;

use crate::support::{Ended, Running};

/// A reply, an error or, as an error of null, not a word.
pub type Answered = Result<Value, Value>;

/// The payloads that came.
pub type Received = Arc<Mutex<Vec<Vec<u8>>>>;

/// Something that looks like daemons from afar and answers little.
pub struct Impostor {
    /// Where it listens.
    pub endpoint: String,
    session: zenoh::Session,
}

impl Impostor {
    /// Holds the tokens of these keys, and is asked on `silent` without ever answering.
    pub async fn start(tokens: &[&str], silent: &str, nonsense: &str) -> Self {
        let mut config = zenoh::Config::default();
        for (key, value) in [
            ("listen/endpoints", r#"["tcp/127.0.0.1:0"]"#),
            ("scouting/multicast/enabled", "false"),
            ("scouting/gossip/enabled", "false"),
        ] {
            config.insert_json5(key, value).unwrap();
        }
        let session = zenoh::open(config).await.unwrap();
        for token in tokens {
            let token = session.liveliness().declare_token(*token).await.unwrap();
            // It lives as long as the session.
            std::mem::forget(token);
        }
        let held = Mutex::new(Vec::new());
        let hold = move |query| held.lock().unwrap().push(query);
        session
            .declare_queryable(silent)
            .callback(hold)
            .background()
            .await
            .unwrap();
        session
            .declare_queryable(nonsense)
            .callback(|query| {
                let key = query.key_expr().clone();
                query.reply(key, "nonsense").wait().unwrap();
            })
            .background()
            .await
            .unwrap();
        let endpoint = session.info().locators().await[0].to_string();
        Impostor { endpoint, session }
    }

    /// Answers queries on a key one after the other, and all further ones as the last; what it
    /// was sent.
    pub async fn answer(&self, key: &str, answers: Vec<Answered>) -> Received {
        let received = Received::default();
        let (seen, left) = (received.clone(), Mutex::new(answers));
        let reply = move |query: Query| {
            let payload = query
                .payload()
                .map(|payload| payload.to_bytes().into_owned());
            seen.lock().unwrap().push(payload.unwrap_or_default());
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

    /// Goes away.
    pub async fn stop(self) {
        self.session.close().await.unwrap();
    }
}
