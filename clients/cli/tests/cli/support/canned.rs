//! A peer that replies to every query with the fixtures of the contract, and records all queries.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use jostle_proto::CBOR;
use serde_json::{Value, json};
use zenoh::Wait;
use zenoh::query::Query;

use crate::support::{Running, TIMEOUT, open_peer};

/// The prefixes under which it is a node with swarms.
const PREFIXES: [&str; 2] = ["jostle", "other"];

/// The swarms that it claims to have.
const SWARMS: [&str; 5] = ["demo", "twin", "test-1", "test-2", "pair"];

/// Differences from the fixtures: a fixture or the end of a key, the place in the reply, the value. The
/// fixtures have pages with a next page, and a status of another step than the state.
const CHANGES: [(&str, &str, &str); 5] = [
    ("get/journal", "/result/newest", "3"),
    ("get/journal", "/result/next", "null"),
    ("get/events", "/result/newest", "7"),
    ("status.reply", "/step", "51"),
    ("experiment/small/order", "/next", "null"),
];

/// The end of a key, a JSON pointer into the reply, and the JSON that replaces the value there.
pub type Change = (&'static str, &'static str, Value);

/// A received query.
#[derive(Clone, Debug)]
pub struct Sent {
    /// Key and parameters.
    pub selector: String,
    /// The payload, which is JSON.
    pub payload: Option<Value>,
    /// The attachment.
    pub token: Option<String>,
    /// When it was received.
    pub at: Instant,
}

/// How it replies.
enum Replies {
    /// With the fixtures and these changes; and the number of metrics reported so far.
    Fixtures(Vec<Change>, u32),
    /// With this error.
    Error(Value),
    /// Never: the queries are kept.
    Never(Vec<Query>),
}

/// The peer.
pub struct Canned {
    /// Where it listens.
    pub endpoint: String,
    session: zenoh::Session,
    sent: Arc<Mutex<Vec<Sent>>>,
    replies: Arc<Mutex<Replies>>,
}

impl Canned {
    /// Starts it; it replies with the fixtures.
    pub async fn start() -> Self {
        Self::start_with(zenoh::Config::default()).await
    }

    /// Starts it for the user with this password alone.
    pub async fn start_for(person: &str, password: &str) -> Self {
        let passwords = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(passwords.path(), format!("{person}:{password}\n")).unwrap();
        let mut config = zenoh::Config::default();
        for (key, value) in [
            ("user", "canned"),
            ("password", "canned"),
            ("dictionary_file", passwords.path().to_str().unwrap()),
        ] {
            let key = format!("transport/auth/usrpwd/{key}");
            config
                .insert_json5(&key, &json!(value).to_string())
                .unwrap();
        }
        Self::start_with(config).await
    }

    async fn start_with(config: zenoh::Config) -> Self {
        let session = open_peer(config).await;
        for prefix in PREFIXES {
            let node = ["alive", "claim/1/serving"].map(|it| format!("{prefix}/@node/test/{it}"));
            let swarms = SWARMS.map(|swarm| format!("{prefix}/{swarm}/alive/test"));
            for key in swarms.into_iter().chain(node) {
                let token = session.liveliness().declare_token(key).await.unwrap();
                // It lives as long as the session.
                std::mem::forget(token);
            }
        }
        let sent = Arc::new(Mutex::new(Vec::new()));
        let replies = Arc::new(Mutex::new(Replies::Fixtures(Vec::new(), 0)));
        for key in ["*/**", "*/@node/**"] {
            let (sent, replies) = (sent.clone(), replies.clone());
            let reply = move |query: Query| {
                sent.lock().unwrap().push(Sent::of(&query));
                answer(query, &mut replies.lock().unwrap());
            };
            let queryable = session.declare_queryable(key).callback(reply);
            queryable.background().await.unwrap();
        }
        let endpoint = session.info().locators().await[0].to_string();
        Canned {
            endpoint,
            session,
            sent,
            replies,
        }
    }

    /// Replies with the fixtures and these changes.
    pub fn reply_with(&self, changes: &[Change]) {
        *self.replies.lock().unwrap() = Replies::Fixtures(changes.to_owned(), 0);
    }

    /// Replies with an error.
    pub fn refuse(&self, error: Value) {
        *self.replies.lock().unwrap() = Replies::Error(error);
    }

    /// Never replies.
    pub fn hold(&self) {
        *self.replies.lock().unwrap() = Replies::Never(Vec::new());
    }

    /// The queries received since the last call.
    pub fn take(&self) -> Vec<Sent> {
        std::mem::take(&mut *self.sent.lock().unwrap())
    }

    /// Waits until `count` queries were received since [`Canned::take`], or the command line has ended.
    pub async fn until_sent(&self, count: usize, running: &mut Running) {
        let deadline = Instant::now() + TIMEOUT;
        while self.sent.lock().unwrap().len() < count && running.is_running() {
            assert!(Instant::now() < deadline, "{count} queries did not come");
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }

    /// Ends it.
    pub async fn stop(self) {
        *self.replies.lock().unwrap() = Replies::Fixtures(Vec::new(), 0);
        self.session.close().await.unwrap();
    }
}

impl Sent {
    fn of(query: &Query) -> Self {
        let payload = query.payload().map(|it| it.to_bytes().into_owned());
        let payload = payload.filter(|bytes| !bytes.is_empty());
        let token = query.attachment().map(|it| it.to_bytes().into_owned());
        Sent {
            selector: without_id(&query.selector().to_string()),
            payload: payload.map(|bytes| serde_json::from_slice(&bytes).unwrap()),
            token: token.map(|bytes| String::from_utf8(bytes).unwrap()),
            at: Instant::now(),
        }
    }
}

/// A selector, with the id of a wait replaced by `ID`.
fn without_id(selector: &str) -> String {
    let is_wait = selector.contains("/get/wait?condition=");
    match selector.split_once(";id=").filter(|_| is_wait) {
        Some((before, after)) => {
            let rest = after.split_once(';').map_or("", |(_, rest)| rest);
            format!("{before};id=ID;{rest}")
        }
        None => selector.to_owned(),
    }
}

fn answer(query: Query, replies: &mut Replies) {
    let key = query.key_expr().clone();
    match replies {
        Replies::Fixtures(changes, metrics) => match fixture(&key, &Sent::of(&query), changes) {
            Reply::Json(mut value) => {
                if key.ends_with("get/metrics") {
                    advance(&mut value["result"], *metrics);
                    *metrics += 1;
                }
                query.reply(key, value.to_string()).wait().unwrap();
            }
            Reply::Cbor(bytes) => query.reply(key, bytes).encoding(CBOR).wait().unwrap(),
            Reply::None => query
                .reply_err(error("not_found").to_string())
                .wait()
                .unwrap(),
        },
        Replies::Error(error) => query.reply_err(error.to_string()).wait().unwrap(),
        Replies::Never(held) => held.push(query),
    }
}

/// Metrics some times two seconds later: each swarm has computed 0.1 s for each of its contacts.
fn advance(metrics: &mut Value, times: u32) {
    let add = |number: &mut Value, more: f64| *number = json!(number.as_f64().unwrap() + more);
    add(&mut metrics["uptime_secs"], 2.0 * f64::from(times));
    for swarm in metrics["swarms"].as_array_mut().unwrap() {
        let contacts = swarm["contacts"].as_f64().unwrap();
        add(&mut swarm["step_secs"], 0.1 * contacts * f64::from(times));
    }
}

/// An error of a kind, as the contract's fixture has it.
pub fn error(code: &str) -> Value {
    read(&format!("error.{code}"))
}

/// Where a fixture is.
pub fn path(name: &str) -> PathBuf {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../proto/fixtures");
    fixtures.join(name)
}

/// A fixture in JSON.
pub fn read(name: &str) -> Value {
    let path = path(&format!("{name}.json"));
    let text = std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    serde_json::from_slice(&text).unwrap()
}

enum Reply {
    Json(Value),
    Cbor(Vec<u8>),
    None,
}

/// The reply to a query on a key.
fn fixture(key: &str, sent: &Sent, changes: &[Change]) -> Reply {
    let cbor = |name: &str| Reply::Cbor(std::fs::read(path(name)).unwrap());
    let payload = sent.payload.as_ref();
    let name = match key.split('/').skip(1).collect::<Vec<_>>()[..] {
        [_, "state"] => return cbor("state.cbor"),
        [_, "get", "snapshot"] => return cbor("snapshot.reply.cbor"),
        [_, "get", "wait"] => "status.reply".to_owned(),
        [.., "cmd", "no-such-verb-of-the-doctor"] => return Reply::None,
        [_, "cmd", _] if payload.is_some_and(|it| it["at_step"].is_u64()) => {
            "scheduled.reply".to_owned()
        }
        [_, "cmd", "step"] if payload.is_some_and(|it| it["args"]["return"] == "state") => {
            return cbor("step.reply.state.cbor");
        }
        ["@node", _, "get", noun] => format!("node.{noun}.reply"),
        ["@node", _, "experiment", _, "series"] if sent.selector.contains(";of=individuals") => {
            "experiment.series.individuals".to_owned()
        }
        ["@node", _, "experiment", _, noun] => format!("experiment.{noun}"),
        ["@node", _, "cmd", verb] | [_, "cmd", verb] => format!("{verb}.reply"),
        [_, "get", "experiment"] => "experiment.file.reply".to_owned(),
        [_, "get", noun] => format!("{noun}.reply"),
        _ => panic!("{key} is no key of the contract"),
    };
    let mut value = read(&name);
    let always = CHANGES.map(|(end, pointer, text)| {
        let value = serde_json::from_str(text).unwrap();
        (end, pointer, value)
    });
    for (end, pointer, now) in always.iter().chain(changes) {
        if name == *end || key.ends_with(end) {
            *value.pointer_mut(pointer).expect(pointer) = now.clone();
        }
    }
    Reply::Json(value)
}
