//! What the test binaries share: a daemon in this process, daemons as processes, and clients.

#![allow(dead_code, reason = "each binary uses a part")]

pub mod bad_requests;
pub mod daemon_process;
pub mod excess;
pub mod http;
pub mod limited_daemon;
pub mod needs;
pub mod playback;
pub mod process;
pub mod programs;
pub mod recording;
pub mod reference_model;
pub mod small_disk;
pub mod streams;
pub mod supervisor;
pub mod tls;
pub mod websocket;

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

use jostle_proto::{Error, ErrorCode, keys};
use jostled::app::{self, Server};
use jostled::cli::settings;
use jostled::config::Config;
use serde_json::{Value, json};
use tempfile::TempDir;
use zenoh::Session;
use zenoh::bytes::Encoding;
use zenoh::query::Reply;

pub const NODE: &str = "test";
pub const PREFIX: &str = "jostle";

/// The timeout of what takes a moment on an idle machine; other tests use this one.
pub const TIMEOUT: Duration = Duration::from_secs(20);

pub struct Daemon {
    pub server: Server,
    pub client: Client,
    folder: TempDir,
}

impl Daemon {
    pub async fn start() -> Self {
        Self::with(&[]).await
    }

    /// A daemon with these settings beside those that tests need.
    pub async fn with(settings: &[(&str, &str)]) -> Self {
        Self::on(settings, tempfile::tempdir().unwrap()).await
    }

    async fn on(settings: &[(&str, &str)], folder: TempDir) -> Self {
        let base = [
            ("listen", "tcp/127.0.0.1:0"),
            ("node", NODE),
            ("http", "127.0.0.1:0"),
            ("data_dir", folder.path().to_str().unwrap()),
        ];
        let flags = BTreeMap::from_iter(base.iter().chain(settings).copied());
        let resolved = settings::from_flags(flags).unwrap();
        let server = app::start(&Config::new(&resolved).unwrap()).await.unwrap();
        let client = Client::open(&server.endpoints[0]).await;
        Daemon {
            server,
            client,
            folder,
        }
    }

    /// Stops it and starts another with its data.
    pub async fn restart(self) -> Self {
        // The daemon ends first: a controller that ends before it leaves its swarm.
        self.server.stop().await;
        self.client.session.close().await.unwrap();
        Self::on(&[], self.folder).await
    }

    pub fn data_dir(&self) -> &Path {
        self.folder.path()
    }

    pub async fn another_client(&self) -> Client {
        Client::open(&self.server.endpoints[0]).await
    }

    pub async fn stop(self) {
        self.client.session.close().await.unwrap();
        self.server.stop().await;
    }
}

pub struct Client {
    pub session: Session,
}

pub type QueryResult = Result<Value, Error>;

impl Client {
    pub async fn open(endpoint: &str) -> Self {
        Self::try_open(endpoint).await.unwrap()
    }

    /// A client, or an error if the daemon has ended.
    pub async fn try_open(endpoint: &str) -> zenoh::Result<Self> {
        let mut config = zenoh::Config::default();
        for (key, value) in [
            ("mode", json!("client")),
            ("connect/endpoints", json!([endpoint])),
            ("scouting/multicast/enabled", json!(false)),
            ("scouting/gossip/enabled", json!(false)),
            ("adminspace/enabled", json!(false)),
        ] {
            config.insert_json5(key, &value.to_string()).unwrap();
        }
        let session = zenoh::open(config).await?;
        Ok(Client { session })
    }

    /// Every reply to a query, its JSON or CBOR read as a value.
    pub async fn query_all(&self, selector: &str, payload: Option<&[u8]>) -> Vec<QueryResult> {
        // A replay of many steps takes a minute on a busy machine.
        let mut query = self.session.get(selector).timeout(6 * TIMEOUT);
        if let Some(payload) = payload {
            hold_token(&self.session, selector, payload).await;
            query = query.payload(payload).encoding(Encoding::APPLICATION_JSON);
        }
        let replies = query.await.unwrap();
        let mut answers = Vec::new();
        while let Ok(reply) = replies.recv_async().await {
            answers.push(result_of(reply));
        }
        answers
    }

    /// The one reply to a query.
    pub async fn query(&self, selector: &str, payload: Option<&[u8]>) -> QueryResult {
        let mut answers = self.query_all(selector, payload).await;
        assert_eq!(answers.len(), 1, "{selector}: {answers:?}");
        answers.remove(0)
    }

    pub async fn cmd(&self, swarm: &str, verb: &str, request: Value) -> QueryResult {
        let key = keys::cmd(PREFIX, swarm, verb);
        self.query(&key, Some(request.to_string().as_bytes())).await
    }

    pub async fn ok(&self, swarm: &str, verb: &str, request: Value) -> Value {
        let context = format!("{verb} {request}");
        match self.cmd(swarm, verb, request).await {
            Ok(reply) => reply,
            Err(error) => panic!("{context}: {error:?}"),
        }
    }

    pub async fn err(&self, swarm: &str, verb: &str, request: Value) -> (ErrorCode, String) {
        let context = format!("{verb} {request}");
        match self.cmd(swarm, verb, request).await {
            Ok(reply) => panic!("{context}: {reply}"),
            Err(error) => (error.code, error.message),
        }
    }

    pub async fn create(&self, name: &str, spec: Value) -> Value {
        let request = json!({"name": name, "spec": spec});
        let key = keys::node_cmd(PREFIX, NODE, "create");
        let answer = self.query(&key, Some(request.to_string().as_bytes())).await;
        answer.unwrap_or_else(|error| panic!("{request}: {error:?}"))
    }

    pub async fn get(&self, swarm: &str, noun: &str) -> Value {
        self.query(&keys::get(PREFIX, swarm, noun), None)
            .await
            .unwrap()
    }

    pub async fn node(&self, noun: &str) -> Value {
        let key = keys::node_get(PREFIX, NODE, noun);
        self.query(&key, None).await.unwrap()["result"].take()
    }

    pub async fn hash(&self, swarm: &str) -> String {
        let status = self.get(swarm, "status").await;
        status["result"]["state_hash"].as_str().unwrap().to_owned()
    }

    /// Steps to `step` and returns the hash there.
    pub async fn hash_at(&self, swarm: &str, step: u64) -> String {
        let request = json!({"until_step": step, "rate": null});
        self.ok(swarm, "run", request).await;
        self.wait_for_step(swarm, step).await["result"]["state_hash"]
            .as_str()
            .unwrap()
            .to_owned()
    }

    /// Waits for a step.
    pub async fn wait_for_step(&self, swarm: &str, step: u64) -> Value {
        let key = keys::get(PREFIX, swarm, "wait");
        let deadline = Instant::now() + 3 * TIMEOUT;
        loop {
            match self.query(&format!("{key}?step={step}"), None).await {
                Ok(reply) => return reply,
                Err(error) if error.code == ErrorCode::DeadlineExceeded => {
                    assert!(Instant::now() < deadline, "{error:?}");
                }
                Err(error) => panic!("{error:?}"),
            }
        }
    }
}

/// Declares the token of the controller in a `join`, as a client of its own does. The session holds it until
/// it is closed.
pub async fn hold_token(session: &Session, selector: &str, request: &[u8]) {
    let swarm = selector.strip_prefix(PREFIX).and_then(|it| {
        let swarm = it.strip_prefix('/')?;
        swarm.strip_suffix("/cmd/join")
    });
    let request: Value = serde_json::from_slice(request).unwrap_or_default();
    let controller = request.get("args").unwrap_or(&request)["controller"].as_str();
    if let (Some(swarm), Some(controller)) = (swarm, controller)
        && keys::is_name(swarm)
        && keys::is_name(controller)
    {
        let key = keys::ctl_alive(PREFIX, swarm, controller);
        let token = session.liveliness().declare_token(key).await.unwrap();
        std::mem::forget(token);
    }
}

/// The payload of a reply, or its error.
pub fn result_of(reply: Reply) -> QueryResult {
    match reply.into_result() {
        Ok(sample) => Ok(read(sample.encoding(), &sample.payload().to_bytes())),
        Err(error) => {
            assert_eq!(error.encoding(), &Encoding::APPLICATION_JSON, "{error:?}");
            Err(serde_json::from_slice(&error.payload().to_bytes()).unwrap())
        }
    }
}

pub fn read(encoding: &Encoding, bytes: &[u8]) -> Value {
    if *encoding == Encoding::APPLICATION_JSON {
        return serde_json::from_slice(bytes).unwrap();
    }
    assert_eq!(*encoding, Encoding::APPLICATION_CBOR);
    // JSON has no typed arrays, so states are read by their type.
    match jostle_proto::State::from_cbor(bytes) {
        Ok(state) => serde_json::to_value(state).unwrap(),
        Err(_) => {
            type Stepped = jostle_proto::Reply<jostle_proto::verbs::StepResult>;
            type Whole = jostle_proto::Reply<jostle_proto::Snapshot>;
            type Advanced = jostle_proto::Reply<jostle_proto::verbs::AdvanceResult>;
            if let Ok(reply) = ciborium::from_reader::<Advanced, _>(bytes) {
                return serde_json::to_value(reply).unwrap();
            }
            if let Ok(order) = ciborium::from_reader::<jostle_proto::OrderPage, _>(bytes) {
                return serde_json::to_value(order).unwrap();
            }
            if let Ok(series) = ciborium::from_reader::<jostle_proto::SeriesPage, _>(bytes) {
                return serde_json::to_value(series).unwrap();
            }
            match ciborium::from_reader::<Stepped, _>(bytes) {
                Ok(reply) => serde_json::to_value(reply).unwrap(),
                Err(_) => {
                    let reply: Whole = ciborium::from_reader(bytes).unwrap();
                    serde_json::to_value(reply).unwrap()
                }
            }
        }
    }
}

/// Waits until `holds`, at most [`TIMEOUT`].
pub async fn until(what: &str, holds: impl AsyncFnMut() -> bool) {
    until_within(TIMEOUT, what, holds).await;
}

/// Waits until `holds`, at most `timeout`.
pub async fn until_within(timeout: Duration, what: &str, mut holds: impl AsyncFnMut() -> bool) {
    let deadline = Instant::now() + timeout;
    while !holds().await {
        assert!(Instant::now() < deadline, "{what}: not within {timeout:?}");
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}
