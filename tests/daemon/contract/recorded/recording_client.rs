//! A daemon process of the scenario, and a client that records what it receives.

use std::fs;
use std::path::PathBuf;

use jostle_proto::keys;
use serde_json::{Value, json};
use tempfile::TempDir;
use zenoh::bytes::Encoding;
use zenoh::handlers::FifoChannelHandler;
use zenoh::query::Reply;

use super::documents::{Document, Recorded};
use crate::contract::proto;
use crate::support::daemon_process::DaemonProcess;
use crate::support::process::jostled;
use crate::support::streams::{Subscriber, subscribe};
use crate::support::{Client, PREFIX, TIMEOUT, hold_token};

/// The node of the fixtures.
pub const FIXTURE_NODE: &str = "lab";

/// A client of a daemon of the node [`FIXTURE_NODE`], which ends when dropped.
pub struct RecordingClient<'a> {
    pub client: Client,
    pub endpoint: String,
    /// The daemon's data folder.
    pub data: PathBuf,
    token: Option<String>,
    recorded: &'a Recorded,
    _daemon: Option<(DaemonProcess, TempDir)>,
}

/// The replies to a query that was sent.
pub type Pending = FifoChannelHandler<Reply>;

/// The arguments that a fixture has.
pub fn args(fixture: &str) -> Value {
    let path = proto().join("fixtures").join(format!("{fixture}.json"));
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

/// A request that does not time out while the machine is busy, unless it says when it does.
fn with_timeout(request: Value) -> Value {
    let mut request = match request.get("args") {
        Some(_) => request,
        None => json!({"args": request}),
    };
    if request.get("timeout_secs").is_none() {
        request["timeout_secs"] = json!(TIMEOUT.as_secs_f64());
    }
    request
}

impl<'a> RecordingClient<'a> {
    pub async fn start(recorded: &'a Recorded) -> Self {
        Self::start_with(recorded, "", &[]).await
    }

    /// A daemon that fails at these points.
    pub async fn failing(recorded: &'a Recorded, points: &str) -> Self {
        Self::start_with(recorded, points, &[]).await
    }

    /// A daemon with further arguments.
    pub async fn start_with(recorded: &'a Recorded, points: &str, arguments: &[&str]) -> Self {
        let (process, folder) = Self::start_daemon(points, arguments);
        let client = Client::open(&process.endpoint).await;
        Self::with_daemon(recorded, process, client, folder)
    }

    /// A daemon process, and its data folder.
    pub fn start_daemon(points: &str, arguments: &[&str]) -> (DaemonProcess, TempDir) {
        let folder = tempfile::tempdir().unwrap();
        (Self::start_process(&folder, points, arguments), folder)
    }

    /// A daemon process on a data folder.
    pub fn start_process(folder: &TempDir, points: &str, arguments: &[&str]) -> DaemonProcess {
        let mut command = jostled(&[
            "serve",
            "--listen",
            "tcp/127.0.0.1:0",
            "--node",
            FIXTURE_NODE,
        ]);
        command.args(arguments).arg("--data-dir").arg(folder.path());
        DaemonProcess::start(command.env("FAILPOINTS", points)).unwrap()
    }

    /// A daemon on a data folder, and its client.
    pub fn with_daemon(
        recorded: &'a Recorded,
        process: DaemonProcess,
        client: Client,
        folder: TempDir,
    ) -> Self {
        let data = folder.path().to_owned();
        let mut recorder = Self::client(recorded, client, None, data);
        recorder.endpoint.clone_from(&process.endpoint);
        recorder._daemon = Some((process, folder));
        recorder
    }

    /// A client that sends this token to a daemon that runs on when the client is closed.
    pub fn client(
        recorded: &'a Recorded,
        client: Client,
        token: Option<String>,
        data: PathBuf,
    ) -> Self {
        RecordingClient {
            client,
            endpoint: String::new(),
            data,
            token,
            recorded,
            _daemon: None,
        }
    }

    pub async fn stop(self) {
        self.client.session.close().await.unwrap();
    }

    /// Sends a query and does not wait for its replies.
    pub async fn send(&self, selector: &str, request: Option<&Value>) -> Pending {
        let mut query = self.client.session.get(selector).timeout(3 * TIMEOUT);
        if let Some(request) = request {
            let payload = request.to_string();
            hold_token(&self.client.session, selector, payload.as_bytes()).await;
            query = query.payload(payload).encoding(Encoding::APPLICATION_JSON);
        }
        if let Some(token) = &self.token {
            query = query.attachment(token);
        }
        query.await.unwrap()
    }

    /// Records the reply to a query under a name, unless that is empty. The name says whether an
    /// error is expected.
    pub async fn record_reply(&self, name: &str, pending: &Pending) -> Value {
        let document = self.receive(name, pending).await;
        if !name.is_empty() {
            self.recorded.add(name, &document, &self.data);
        }
        serde_json::from_slice(&document.bytes).unwrap_or(Value::Null)
    }

    /// The reply to a query, which is not recorded.
    pub async fn receive(&self, name: &str, pending: &Pending) -> Document {
        let reply = pending.recv_async().await;
        let reply = reply.unwrap_or_else(|_| panic!("{name}: no reply"));
        let is_error = name.starts_with("error.");
        let (is_expected, payload, encoding) = match reply.result() {
            Ok(sample) => (!is_error, sample.payload(), sample.encoding()),
            Err(error) => (is_error, error.payload(), error.encoding()),
        };
        let bytes = payload.to_bytes().into_owned();
        assert!(is_expected, "{name}: {}", String::from_utf8_lossy(&bytes));
        let encoding = encoding.clone();
        Document { encoding, bytes }
    }

    /// Records a document that was sent.
    pub fn record_document(&self, name: &str, document: &Document) {
        self.recorded.add(name, document, &self.data);
    }

    pub async fn query(&self, name: &str, selector: &str, request: Option<&Value>) -> Value {
        let pending = self.send(selector, request).await;
        self.record_reply(name, &pending).await
    }

    /// A command to a swarm.
    pub async fn cmd(&self, name: &str, swarm: &str, verb: &str, request: Value) -> Value {
        let (key, request) = (keys::cmd(PREFIX, swarm, verb), with_timeout(request));
        self.query(name, &key, Some(&request)).await
    }

    /// A query to a swarm.
    pub async fn get(&self, name: &str, swarm: &str, noun: &str) -> Value {
        let key = keys::get(PREFIX, swarm, noun);
        self.query(name, &key, None).await
    }

    /// A command to the daemon.
    pub async fn node_cmd(&self, name: &str, verb: &str, request: Value) -> Value {
        let (key, request) = (
            keys::node_cmd(PREFIX, FIXTURE_NODE, verb),
            with_timeout(request),
        );
        self.query(name, &key, Some(&request)).await
    }

    /// A query to the daemon.
    pub async fn node_get(&self, name: &str, noun: &str) -> Value {
        let key = keys::node_get(PREFIX, FIXTURE_NODE, noun);
        self.query(name, &key, None).await
    }

    pub async fn create(&self, name: &str, spec: Value) -> Value {
        let request = json!({"name": name, "spec": spec});
        self.node_cmd("", "create", request).await
    }

    pub async fn subscribe(&self, key: String) -> Subscriber {
        subscribe(&self.client, key).await
    }

    /// Records the first sample that is meant.
    pub async fn sample(
        &self,
        name: &str,
        samples: &Subscriber,
        is_expected: impl Fn(&Value) -> bool,
    ) -> Value {
        loop {
            let sample = tokio::time::timeout(TIMEOUT, samples.recv_async()).await;
            let sample = sample.unwrap_or_else(|_| panic!("{name} is not published"));
            let sample = sample.unwrap();
            let bytes = sample.payload().to_bytes().into_owned();
            let value: Value = serde_json::from_slice(&bytes).unwrap();
            if is_expected(&value) {
                let encoding = sample.encoding().clone();
                self.record_document(name, &Document { encoding, bytes });
                return value;
            }
        }
    }

    /// Records the next event of a kind.
    pub async fn event(&self, name: &str, samples: &Subscriber, kind: &str) -> Value {
        let is_expected = |event: &Value| event["event"]["kind"] == kind;
        self.sample(name, samples, is_expected).await
    }
}
