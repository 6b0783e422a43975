//! The data folder of a lab: a swarm in each phase, and each kind of what a swarm and a daemon store.

use std::collections::BTreeMap;
use std::path::Path;

use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};
use tempfile::TempDir;

use super::folders::aged;
use crate::support::daemon_process::{self, DaemonProcess, StoreCopy};
use crate::support::playback::{recorded_file, upload_and_open};
use crate::support::{Client, NODE, PREFIX, recording, until};
use crate::{commands, experiments, when};

/// The steps of a command that is being executed when the daemon is killed: they take a minute.
pub const LONG: u64 = 20_000_000;

/// An experiment with three short runs, and one that takes longer than any test.
const HALF: &str = "name = \"half\"\nseed = 3\nduration = 1000\n[[grid]]\nn = [3, 4, 5, 400]\n";

fn short(name: &str) -> String {
    format!("name = \"{name}\"\nduration = 1\nspec = {{ n = 3 }}\n")
}

/// The key, the request with a request id, and the reply of a command.
type Request = (String, Value, Value);

/// A data folder as the earlier version left it when its daemon was killed, and what that daemon said.
pub struct Lab {
    pub folder: TempDir,
    pub statuses: BTreeMap<String, Value>,
    /// The epoch and the step of the newest checkpoint of each swarm.
    pub checkpoints: BTreeMap<String, (u64, u64)>,
    /// The commands that were executed, by swarm.
    pub journals: BTreeMap<String, Value>,
    pub controllers: Value,
    pub requests: Vec<Request>,
    /// The request of a command that is being executed.
    pub pending: (String, Value),
    /// The finished runs of each experiment.
    pub rows: BTreeMap<String, Vec<Value>>,
    pub audit: Vec<Value>,
    pub film: Value,
}

pub async fn journal(client: &Client, swarm: &str) -> Value {
    let journal = client.get(swarm, "journal?limit=1000").await;
    journal["result"]["entries"].clone()
}

pub async fn audit(client: &Client) -> Vec<Value> {
    let lines = client.node("audit?limit=1000").await["lines"].take();
    lines.as_array().unwrap().clone()
}

/// The names of the swarms.
pub async fn names(client: &Client) -> Vec<String> {
    let listed = client.node("swarms").await["swarms"].take();
    let listed = listed.as_array().unwrap().iter();
    let mut names: Vec<_> = listed
        .map(|it| it["swarm"].as_str().unwrap().to_owned())
        .collect();
    names.sort();
    names
}

/// A client that sends commands with request ids, and keeps the replies.
struct Asking<'a> {
    client: &'a Client,
    requests: Vec<Request>,
}

impl Asking<'_> {
    async fn ask(&mut self, key: String, mut request: Value) -> Value {
        request["client"] = json!("lab");
        request["request_id"] = json!(format!("r{}", self.requests.len()));
        let reply = self
            .client
            .query(&key, Some(request.to_string().as_bytes()))
            .await
            .unwrap_or_else(|error| panic!("{key} {request}: {error:?}"));
        self.requests.push((key, request, reply.clone()));
        reply
    }

    async fn create(&mut self, name: &str, spec: Value) {
        let key = keys::node_cmd(PREFIX, NODE, "create");
        let create = json!({"args": {"name": name, "spec": spec}});
        self.ask(key, create).await;
    }

    async fn ok(&mut self, swarm: &str, verb: &str, args: Value) -> Value {
        self.at(swarm, verb, json!({"args": args})).await
    }

    async fn at(&mut self, swarm: &str, verb: &str, request: Value) -> Value {
        self.ask(keys::cmd(PREFIX, swarm, verb), request).await
    }
}

impl Lab {
    /// Fills a folder, kills its daemon, and writes the folder again as of the earlier version.
    pub async fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        // An orderly end stores checkpoints of runs.
        let (mut process, client) = daemon_process::start(folder.path()).await;
        experiments::submit(&client, &short("done")).await;
        experiments::wait_for_phase(&client, "done", "finished").await;
        experiments::submit(&client, HALF).await;
        until("some runs are finished", async || {
            experiments::progress(&client, "half").await["finished"] == 3
        })
        .await;
        client.session.close().await.unwrap();
        process.stop();
        assert_eq!(process.end(), Some(0));
        let checkpoints = folder.path().join("experiments/half/checkpoints");
        assert_eq!(checkpoints.read_dir().unwrap().count(), 1);

        let points = "recording-part=1*return(50)->off";
        let (process, client) = recording::start_daemon(folder.path(), points).await;
        experiments::wait_for_phase(&client, "half", "running").await;
        experiments::submit(&client, &short("next")).await;
        let mut asking = Asking {
            client: &client,
            requests: Vec::new(),
        };
        still(&mut asking).await;
        driven(&mut asking).await;
        moving(&mut asking).await;
        filmed(&mut asking).await;
        let tape = recorded_file(&client).await;
        upload_and_open(&client, "tape", &tape).await.unwrap();
        let pending = stepping(&mut asking).await;
        // No command is executed after this one, so that all are durable.
        let mut swarms = names(&client).await;
        swarms.retain(|it| it != "tape");
        for name in &swarms {
            let last = json!({"text": "the last"});
            asking.ok(name, "annotate", last).await;
        }
        let requests = asking.requests;
        Self::of(
            folder.path(),
            (process, client),
            swarms,
            (requests, pending),
        )
        .await
    }

    /// Observes the daemon, kills it, and writes its folder again.
    async fn of(
        folder: &Path,
        (mut process, client): (DaemonProcess, Client),
        swarms: Vec<String>,
        (requests, pending): (Vec<Request>, (String, Value)),
    ) -> Self {
        let (mut statuses, mut journals) = (BTreeMap::new(), BTreeMap::new());
        for name in &swarms {
            statuses.insert(name.clone(), client.get(name, "status").await);
            journals.insert(name.clone(), journal(&client, name).await);
        }
        let mut rows = BTreeMap::new();
        for name in ["done", "half", "next"] {
            rows.insert(name.to_owned(), experiments::rows(&client, name, 100).await);
        }
        let controllers = client.get("driven", "controllers").await["result"].take();
        let film = recording::recording_status(&client, "film").await;
        let audit = audit(&client).await;
        process.kill();
        // What is under way when the daemon is killed.
        assert_eq!(statuses["running"]["result"]["scheduled"], 1);
        assert!(statuses["stepping"]["step"].as_u64() < Some(LONG));
        assert_eq!(
            [&rows["done"], &rows["half"], &rows["next"]].map(Vec::len),
            [1, 3, 0]
        );
        let folder = aged(folder, |record| record);
        let store = StoreCopy::of(folder.path());
        let newest = |name: &String| (name.clone(), store.newest_checkpoint(name));
        let checkpoints = swarms.iter().map(newest).collect();
        Lab {
            folder,
            statuses,
            checkpoints,
            journals,
            controllers,
            requests,
            pending,
            rows,
            audit,
            film,
        }
    }
}

/// Swarms that stand: paused, protected, faulted, one whose commands wait for their steps, and one whose
/// conditions wait.
async fn still(asking: &mut Asking<'_>) {
    asking.create("paused", json!({"n": 12, "seed": 3})).await;
    asking.ok("paused", "step", json!({"steps": 700})).await;
    let inform = json!({"select": {"ids": [1, 3]}, "direction": 1.0});
    asking.ok("paused", "inform", inform.clone()).await;
    asking.ok("paused", "step", json!({"steps": 40})).await;
    asking.ok("paused", "set", json!({"pi3": 2.0})).await;
    asking.ok("paused", "fork", json!({"name": "copy"})).await;

    asking.create("protected", json!({"n": 5, "seed": 1})).await;
    asking.ok("protected", "step", json!({"steps": 100})).await;
    asking.ok("protected", "protect", json!({"on": true})).await;

    asking.create("faulted", commands::faulting_spec()).await;
    commands::fault_soon(asking.client, "faulted").await;

    asking
        .create("scheduled", json!({"n": 12, "seed": 3}))
        .await;
    asking.ok("scheduled", "step", json!({"steps": 10})).await;
    for (step, verb, args) in [
        (30, "set", json!({"pi3": 2.0})),
        (40, "inform", inform),
        (50, "remove", json!({"select": {"ids": [11]}})),
    ] {
        let request = json!({"at_step": step, "args": args});
        asking.at("scheduled", verb, request).await;
    }

    asking.create("waiting", when::spec()).await;
    asking.ok("waiting", "inform", when::inform()).await;
    asking
        .ok("waiting", "when", when::pause(when::CONDITION))
        .await;
    let never = json!({"condition": "order > 1", "event": "never"});
    asking.ok("waiting", "when", never).await;
    asking.ok("waiting", "step", json!({"steps": 20})).await;
}

/// A swarm in lock-step with a controller.
async fn driven(asking: &mut Asking<'_>) {
    asking.create("driven", json!({"n": 6, "seed": 2})).await;
    let join = json!({"controller": "ada", "select": {"ids": [0, 1]}});
    asking.ok("driven", "join", join).await;
    let points = json!({"ids": [0, 1], "direction": [0.3, -0.2], "weight": [2.0, 0.5]});
    let advance = json!({"controller": "ada", "steps": 10, "set": points});
    let request = json!({"expect_step": 0, "args": advance});
    asking.at("driven", "advance", request).await;
}

/// A swarm that runs, 50 steps in a second, with a command for a step to come.
async fn moving(asking: &mut Asking<'_>) {
    let spec = json!({"n": 8, "seed": 4, "rate": 1});
    asking.create("running", spec).await;
    let later = json!({"at_step": 1200, "args": {"pi1": 3.0, "make_room": true}});
    asking.at("running", "set", later).await;
    asking.ok("running", "run", json!({})).await;
    asking.client.wait_for_step("running", 30).await;
    asking.ok("running", "set", json!({"pi3": 2.0})).await;
}

/// A swarm that is stepping: its client waits no longer.
async fn stepping(asking: &mut Asking<'_>) -> (String, Value) {
    asking.create("stepping", json!({"n": 5, "seed": 6})).await;
    let key = keys::cmd(PREFIX, "stepping", "step");
    let args = json!({"steps": LONG});
    let mut request = json!({"client": "lab", "request_id": "long", "timeout_secs": 0.05});
    request["args"] = args;
    let error = asking.client.cmd("stepping", "step", request.clone());
    assert_eq!(error.await.unwrap_err().code, ErrorCode::DeadlineExceeded);
    request["timeout_secs"] = json!(60);
    (key, request)
}

/// A swarm that is recorded, with a first part that is complete and steps after it.
async fn filmed(asking: &mut Asking<'_>) {
    asking.create("filmed", json!({"n": 5, "seed": 7})).await;
    let begin = json!({"swarm": "filmed", "recording": "film", "every": 5});
    recording::ok(asking.client, json!({"begin": begin})).await;
    asking.ok("filmed", "step", json!({"steps": 20})).await;
    recording::has(asking.client, "film", "parts", 1).await;
    asking.ok("filmed", "step", json!({"steps": 32})).await;
}
