//! Recordings by a daemon.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use jostle_proto::{ErrorCode, keys};
use jostle_results::recording::{About, Format, Recorder, Written, parts};
use serde_json::{Value, json};

use super::daemon_process::{DaemonProcess, daemon};
use super::{Client, NODE, PREFIX, QueryResult, until};

pub async fn send(client: &Client, request: &Value) -> QueryResult {
    let key = keys::node_cmd(PREFIX, NODE, "record");
    client
        .query(&key, Some(request.to_string().as_bytes()))
        .await
}

pub async fn ok(client: &Client, request: Value) -> Value {
    let answer = send(client, &request).await;
    answer.unwrap_or_else(|error| panic!("{request}: {error:?}"))["result"].take()
}

pub async fn error_of(client: &Client, request: Value) -> (ErrorCode, String) {
    let error = send(client, &request).await.unwrap_err();
    (error.code, error.message)
}

pub async fn begin(client: &Client, swarm: &str, recording: &str) -> Value {
    let begin = json!({"swarm": swarm, "recording": recording});
    ok(client, json!({"begin": begin})).await
}

pub async fn stop(client: &Client, recording: &str) -> Value {
    ok(client, json!({"stop": {"recording": recording}})).await
}

/// The status of a recording, from the list.
pub async fn recording_status(client: &Client, recording: &str) -> Value {
    let mut list = client.node("recordings").await;
    let list = list["recordings"].as_array_mut().unwrap();
    let found = list.iter_mut().find(|it| it["recording"] == recording);
    found.unwrap_or_else(|| panic!("no {recording}")).take()
}

/// Waits until a recording has `count` `frames` or `parts`. Returns its status.
pub async fn has(client: &Client, recording: &str, what: &str, count: u64) -> Value {
    let mut last = Value::Null;
    until(&format!("{count} {what} of {recording}"), async || {
        last = recording_status(client, recording).await;
        last[what].as_u64() >= Some(count)
    })
    .await;
    last
}

/// A swarm that publishes every step, fifty of them a second.
pub async fn run(client: &Client, swarm: &str, n: u64) {
    let spec = json!({"n": n, "publish_every": 1, "rate": 1});
    client.create(swarm, spec).await;
    client.ok(swarm, "run", json!({})).await;
}

pub fn folder_of(data: &Path, recording: &str) -> PathBuf {
    data.join("recordings").join(recording)
}

/// The content of the files of a recording, each of which must be complete.
pub fn read(data: &Path, recording: &str) -> Written {
    let folder = folder_of(data, recording);
    let recorder = Recorder::resume(&folder, Format::Mcap, About::new()).unwrap();
    recorder.written()
}

pub fn assert_holds(data: &Path, status: &Value) {
    let recording = status["recording"].as_str().unwrap();
    let written = read(data, recording);
    assert_eq!(status["frames"], written.frames, "{status}");
    assert_eq!(status["parts"], written.parts, "{status}");
    assert_eq!(status["bytes"], written.bytes, "{status}");
}

/// The paths and the bytes of the complete parts.
pub fn files(data: &Path, recording: &str) -> BTreeMap<PathBuf, Vec<u8>> {
    let parts = parts(&folder_of(data, recording)).unwrap().into_iter();
    parts
        .map(|part| (part.clone(), fs::read(part).unwrap()))
        .collect()
}

pub async fn start_daemon(data: &Path, points: &str) -> (DaemonProcess, Client) {
    let process = DaemonProcess::start(daemon(data).env("FAILPOINTS", points)).unwrap();
    let client = Client::open(&process.endpoint).await;
    (process, client)
}
