//! A peer that passes queries on to a daemon, and asks for smaller pages than its clients do.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use serde_json::json;
use zenoh::Session;
use zenoh::query::Query;

use crate::support::open_peer;

/// The ends of the keys of paged replies.
const PAGED: [&str; 6] = [
    "/get/events",
    "/get/journal",
    "/get/audit",
    "/results",
    "/order",
    "/series",
];

/// The most entries of a page of a run.
const MAX_ENTRIES: usize = 40_000;

/// The tokens by which clients find a daemon and its swarms.
const TOKENS: [&str; 2] = ["jostle/*/alive/*", "jostle/@node/**"];

/// The peer.
pub struct Relay {
    /// Where it listens.
    pub endpoint: String,
    size: Arc<AtomicUsize>,
    asked: Arc<AtomicUsize>,
}

impl Relay {
    /// Starts it.
    pub async fn to(daemon: &str) -> Self {
        let mut config = zenoh::Config::default();
        for (key, value) in [
            ("mode", json!("client")),
            ("connect/endpoints", json!([daemon])),
            ("scouting/multicast/enabled", json!(false)),
        ] {
            config.insert_json5(key, &value.to_string()).unwrap();
        }
        let back = zenoh::open(config).await.unwrap();
        let front = open_peer(zenoh::Config::default()).await;
        for key in TOKENS {
            let tokens = back.liveliness().get(key).await.unwrap();
            while let Ok(token) = tokens.recv_async().await {
                let key = token.result().unwrap().key_expr().clone();
                let token = front.liveliness().declare_token(key).await.unwrap();
                // It lives as long as the session.
                std::mem::forget(token);
            }
        }
        let (size, asked) = (Arc::<AtomicUsize>::default(), Arc::<AtomicUsize>::default());
        for key in ["*/**", "*/@node/**"] {
            let queries = front.declare_queryable(key).await.unwrap();
            let (size, asked, back) = (size.clone(), asked.clone(), back.clone());
            tokio::spawn(async move {
                while let Ok(query) = queries.recv_async().await {
                    let selector = query.selector().to_string();
                    let smaller = with_pages_of(&selector, size.load(Ordering::SeqCst));
                    if is_paged(&selector) {
                        asked.fetch_add(1, Ordering::SeqCst);
                    }
                    tokio::spawn(pass_on(query, smaller, back.clone()));
                }
            });
        }
        let endpoint = front.info().locators().await[0].to_string();
        // The sessions live as long as the process.
        std::mem::forget((front, back));
        Relay {
            endpoint,
            size,
            asked,
        }
    }

    /// Asks for at most so many entries in a page.
    pub fn ask_for(&self, size: usize) {
        self.size.store(size, Ordering::SeqCst);
    }

    /// The number of pages that it asked for since the last call.
    pub fn asked(&self) -> usize {
        self.asked.swap(0, Ordering::SeqCst)
    }
}

fn is_paged(selector: &str) -> bool {
    let key = selector.split('?').next().unwrap();
    PAGED.iter().any(|it| key.ends_with(it))
}

/// A selector with a smaller `limit`, if it is of pages.
fn with_pages_of(selector: &str, size: usize) -> String {
    if !is_paged(selector) {
        return selector.to_owned();
    }
    let (key, parameters) = selector.split_once('?').unwrap_or((selector, ""));
    let given = parameters.split(';').filter(|it| !it.is_empty());
    let is_limit = |it: &&str| it.starts_with("limit=");
    let (limits, mut rest): (Vec<&str>, Vec<&str>) = given.partition(is_limit);
    // Without a limit it is the largest.
    let given = limits
        .first()
        .map_or(MAX_ENTRIES, |it| it[6..].parse().unwrap());
    let limit = format!("limit={}", given.min(size));
    rest.push(&limit);
    format!("{key}?{}", rest.join(";"))
}

async fn pass_on(query: Query, selector: String, back: Session) {
    let mut get = back.get(selector);
    if let Some(payload) = query.payload() {
        get = get.payload(payload.clone());
    }
    if let Some(attachment) = query.attachment() {
        get = get.attachment(attachment.clone());
    }
    let replies = get.await.unwrap();
    while let Ok(reply) = replies.recv_async().await {
        let passed = match reply.result() {
            Ok(sample) => {
                let reply = query.reply(sample.key_expr(), sample.payload().clone());
                reply.encoding(sample.encoding().clone()).await
            }
            Err(error) => {
                let reply = query.reply_err(error.payload().clone());
                reply.encoding(error.encoding().clone()).await
            }
        };
        // The client may have ended.
        let _ = passed;
    }
}
