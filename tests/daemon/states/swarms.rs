//! Swarms: the effect of each change of state on everything that can be observed.

use std::fs;
use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::{ErrorCode, Reply, Snapshot, keys};
use serde_json::{Value, json};
use tokio::task::JoinHandle;

use super::{End, Observation, Served, Table};
use crate::support::http::health;
use crate::support::recording::{folder_of, has, stop};
use crate::support::small_disk::SmallDisk;
use crate::support::streams::{Subscriber, subscribe};
use crate::support::{Client, NODE, PREFIX, QueryResult, until};

/// The step of the paused swarm at a change.
const STEPS: u64 = 60;

/// How a swarm is prepared.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    /// A controller has joined in lock-step.
    Stands,
    /// It runs, and a controller has joined in mode `free_running`.
    Runs,
}

/// A swarm that differs in everything from how it was made.
struct Prepared {
    name: &'static str,
    made: Observation,
    before: Observation,
    /// A query that waits for a fault, and its result.
    waiter: Option<JoinHandle<Vec<QueryResult>>>,
    waited: Value,
    /// A request that was executed, and its reply.
    sent: (Value, Value),
}

async fn node(client: &Client, verb: &str, args: Value) -> QueryResult {
    let key = keys::node_cmd(PREFIX, NODE, verb);
    client.query(&key, Some(args.to_string().as_bytes())).await
}

pub async fn snapshot(client: &Client, swarm: &str) -> Snapshot {
    let key = keys::get(PREFIX, swarm, "snapshot");
    let replies = client.session.get(key).await.unwrap();
    let sample = replies.recv_async().await.unwrap().into_result().unwrap();
    let reply: Reply<Snapshot> = ciborium::from_reader(&*sample.payload().to_bytes()).unwrap();
    reply.result
}

pub async fn restore(client: &Client, name: &str, snapshot: &Snapshot) -> QueryResult {
    let snapshot = STANDARD.encode(jostle_proto::to_cbor(snapshot));
    let args = json!({"name": name, "snapshot": snapshot});
    node(client, "restore", args).await
}

/// The code of an error, or what `of` makes of a reply.
fn code(answer: &QueryResult, of: impl FnOnce(&Value) -> Value) -> Value {
    match answer {
        Ok(reply) => of(reply),
        Err(error) => {
            let code = serde_json::to_value(error.code).unwrap();
            json!(format!("refused {}", code.as_str().unwrap()))
        }
    }
}

/// Replies to waits and gets of events and the journal, without values that differ between daemons.
fn brief(list: &Value, fields: &[&str]) -> Value {
    let brief = |entry: &Value| -> Value { fields.iter().map(|it| entry[it].clone()).collect() };
    list.as_array().unwrap().iter().map(brief).collect()
}

/// Observations of a swarm by queries. `runs` is the swarm of the rows about a running one.
async fn observe(daemon: &Served, name: &str, runs: Option<&str>) -> Observation {
    let client = &daemon.client;
    let status = client.get(name, "status").await;
    let result = &status["result"];
    let state = format!("{}?format=json", keys::state(PREFIX, name));
    let state = client.query(&state, None).await.unwrap();
    let informed = state["id"].as_array().unwrap().iter();
    let informed = informed.zip(state["weight"].as_array().unwrap());
    let informed = informed.filter(|(_, weight)| weight.as_f64() > Some(0.0));
    let order = &result["order"];
    let whole = snapshot(client, name).await;
    let controllers = client.get(name, "controllers").await;
    let events = client.get(name, "events?limit=1000").await;
    let journal = client.get(name, "journal?limit=1000").await;
    let journal = &journal["result"]["entries"];
    let verify = client.query(&keys::get(PREFIX, name, "verify"), None).await;
    let recordings = client.node("recordings").await;
    let recordings = recordings["recordings"].as_array().unwrap();
    let recording = recordings.iter().find(|it| it["recording"] == name);
    let metrics = client.node("metrics").await;
    let metrics = metrics["swarms"].as_array().unwrap();
    let metrics = metrics.iter().find(|it| it["swarm"] == name).unwrap();
    let history = &result["history_from"];
    let kept = events["result"]["events"].as_array().unwrap().iter();
    let of_number = |it: &Value| {
        let event = json!([it["epoch"], it["step"], it["event"]]);
        (it["number"].to_string(), event)
    };
    let mut look = Observation::from([
        ("epoch", status["epoch"].clone()),
        ("step", status["step"].clone()),
        ("time", status["time"].clone()),
        ("state_hash", result["state_hash"].clone()),
        ("seq", status["seq"].clone()),
        ("n", result["n"].clone()),
        ("parameters", result["parameters"].clone()),
        ("rate", result["rate"].clone()),
        ("informed", informed.map(|(id, _)| id.clone()).collect()),
        (
            "means",
            json!([
                order["mean_order"],
                order["mean_velocity"],
                order["mean_drift"]
            ]),
        ),
        ("steps in the means", json!(whole.sums.count)),
        ("degraded steps", result["certificate"]["degraded"].clone()),
        ("contacts", result["certificate"]["contacts"].clone()),
        ("scheduled commands", result["scheduled"].clone()),
        (
            "controllers",
            brief(
                &controllers["result"]["controllers"],
                &["controller", "mode", "ids"],
            ),
        ),
        ("phase", json!([status["phase"], result["reason"]])),
        ("published frames", state["frame"].clone()),
        ("event number", events["result"]["newest"].clone()),
        ("kept events", Value::Object(kept.map(of_number).collect())),
        (
            "journal",
            brief(journal, &["seq", "epoch", "step", "verb", "unix_secs"]),
        ),
        ("history_from", json!([history["epoch"], history["step"]])),
        (
            "verify",
            code(&verify, |it| match it["result"]["differs_at"] {
                Value::Null if it["result"]["hashes"] != 0 => json!("same"),
                _ => it["result"].clone(),
            }),
        ),
        (
            "recording",
            recording.map_or(Value::Null, |it| it["phase"].clone()),
        ),
        (
            "frames recorded",
            recording.map_or(Value::Null, |it| it["frames"].clone()),
        ),
        ("/healthz", json!(health(&daemon.http).0)),
        ("metric: steps", metrics["steps"].clone()),
        ("metric: faults", metrics["faults"].clone()),
    ]);
    if let Some(runs) = runs {
        let status = client.get(runs, "status").await;
        let result = &status["result"];
        look.extend([
            (
                "phase of one that runs",
                json!([status["phase"], result["reason"]]),
            ),
            ("until_step of one that runs", result["until_step"].clone()),
            ("step of one that runs", status["step"].clone()),
        ]);
    }
    look
}

impl Prepared {
    /// The result of the query that waits.
    async fn waited(&mut self, has_ended: bool) -> Value {
        if let Some(waiter) = self.waiter.take_if(|it| has_ended || it.is_finished()) {
            self.waited = match waiter.await.unwrap().first() {
                Some(answer) => code(answer, |_| json!("answered")),
                None => json!("no reply"),
            };
        }
        self.waited.clone()
    }
}

/// Observations of a swarm by commands, after all queries.
async fn probe(client: &Client, name: &str, (request, reply): &(Value, Value)) -> Observation {
    let again = client.cmd(name, "inform", request.clone()).await;
    let again = code(&again, |it| match it == reply {
        true => json!("first reply"),
        false => it.clone(),
    });
    let mut look = Observation::from([("request sent again", again)]);
    let status = client.get(name, "status").await;
    let joined = status["result"]["controllers"] != 0;
    for _ in 0..3 {
        // Everything before it is durable too once this gets a reply.
        let set = client.cmd(name, "set", json!({"publish_every": 7})).await;
        look.insert("new command", code(&set, |_| json!("applied")));
        let stepped = if joined {
            let step = client.get(name, "status").await["step"].clone();
            let args = json!({"expect_step": step, "args": {"controller": "ada"}});
            client.cmd(name, "advance", args).await
        } else {
            client.cmd(name, "step", json!({})).await
        };
        let durable = code(&stepped, |it| {
            let durable = it["result"]["durable_step"].as_u64().unwrap();
            let step = it["step"].as_u64().unwrap();
            match durable {
                _ if durable + 1 < step => json!("stays behind"),
                _ if durable <= step => json!("follows"),
                _ => json!(format!("step {step}, durable {durable}")),
            }
        });
        look.insert("durable_step", durable);
    }
    look
}

/// A restarted daemon with swarms of these names, each restored from a snapshot with three
/// degraded steps.
async fn begin(folder: &Path, points: &str, names: &[&str]) -> Served {
    let mut daemon = Served::on(folder, "").await;
    let client = &daemon.client;
    let spec = json!({"n": 12, "seed": 3, "rate": 2, "start": {"kind": "disc", "radius": 6}});
    client.create("model", spec).await;
    let mut model = snapshot(client, "model").await;
    model.exactness.degraded = 3;
    let model = model.sealed();
    for name in names {
        restore(client, name, &model).await.unwrap();
    }
    client.ok("model", "delete", json!({})).await;
    daemon.kill();
    Served::on(folder, points).await
}

/// Changes everything of a swarm that can be changed.
async fn prepare(daemon: &Served, data: &Path, name: &'static str, kind: Kind) -> Prepared {
    let client = &daemon.client;
    let runs = (kind == Kind::Runs).then_some(name);
    let mut made = observe(daemon, name, runs).await;
    // A swarm that starts over has no degraded steps, and no reason.
    made.insert("verify", Value::Null);
    let begin = json!({"begin": {"swarm": name, "recording": name, "every": 5}});
    node(client, "record", begin).await.unwrap();
    // An event that the journal does not have.
    let lost = format!("{name}-lost");
    let begin = json!({"begin": {"swarm": name, "recording": lost}});
    node(client, "record", begin).await.unwrap();
    has(client, &lost, "frames", 1).await;
    fs::remove_dir_all(folder_of(data, &lost)).unwrap();
    let failed = stop(client, &lost).await;
    assert_eq!(failed["phase"], "failed", "{failed}");
    client
        .ok(name, "run", json!({"rate": 50, "until_step": 40}))
        .await;
    client.wait_for_step(name, 40).await;
    let set = json!({"pi3": 1.5, "publish_every": 7});
    client.ok(name, "set", set).await;
    let inform = json!({"select": {"ids": [3, 4, 5]}, "direction": 1.0});
    let request = json!({"client": "me", "request_id": name, "args": inform});
    let reply = client.ok(name, "inform", request.clone()).await;
    client.ok(name, "inject", json!({"count": 2})).await;
    let mode = match kind {
        Kind::Stands => "lockstep",
        Kind::Runs => "free_running",
    };
    let join = json!({"controller": "ada", "select": {"ids": [0, 1]}, "mode": mode,
        "deadline_secs": 60});
    client.ok(name, "join", join).await;
    match kind {
        Kind::Stands => {
            let args = json!({"controller": "ada", "steps": STEPS - 40});
            let request = json!({"expect_step": 40, "args": args});
            client.ok(name, "advance", request).await;
        }
        Kind::Runs => {
            let request = json!({"rate": 4, "until_step": 1_000_000});
            client.ok(name, "run", request).await;
            client.wait_for_step(name, STEPS).await;
        }
    }
    // The last one makes all that came before it durable.
    let scheduled = json!({"at_step": 2_000_000, "args": {"pi4": 7}});
    client.ok(name, "set", scheduled).await;
    let key = keys::get(PREFIX, name, "wait?phase=faulted;timeout_secs=30");
    let asking = Client {
        session: client.session.clone(),
    };
    let waiter = tokio::spawn(async move { asking.query_all(&key, None).await });
    until("the states are recorded and published", async || {
        let state = format!("{}?format=json", keys::state(PREFIX, name));
        let frame = client.query(&state, None).await.unwrap()["frame"].as_u64();
        let list = client.node("recordings").await;
        let mut list = list["recordings"].as_array().unwrap().iter();
        let recorded = list.any(|it| it["recording"] == name && it["frames"].as_u64() >= Some(13));
        recorded && frame > Some(5)
    })
    .await;
    let mut before = observe(daemon, name, runs).await;
    before.extend([
        ("get/wait for a fault", json!("waits")),
        ("request sent again", json!("first reply")),
        ("new command", json!("applied")),
        ("durable_step", json!("follows")),
    ]);
    Prepared {
        name,
        made,
        before,
        waiter: Some(waiter),
        waited: json!("waits"),
        sent: (request, reply),
    }
}

/// A daemon with a paused and a running swarm, and a subscriber of their states.
struct Scenario {
    daemon: Served,
    stands: Prepared,
    runs: Prepared,
    _states: Subscriber,
}

async fn scenario(data: &Path) -> Scenario {
    let daemon = begin(data, "", &["school", "moving"]).await;
    let states = subscribe(&daemon.client, keys::state(PREFIX, "*")).await;
    let mut stands = prepare(&daemon, data, "school", Kind::Stands).await;
    let runs = prepare(&daemon, data, "moving", Kind::Runs).await;
    for (row, value) in &runs.before {
        if row.ends_with("of one that runs") {
            stands.before.insert(row, value.clone());
        }
    }
    Scenario {
        daemon,
        stands,
        runs,
        _states: states,
    }
}

/// Observes a swarm after a change and compares it with the column of that change.
async fn judge(
    table: &mut Table,
    change: &'static str,
    daemon: &Served,
    swarm: &mut Prepared,
    (name, runs): (&str, Option<&str>),
) {
    let mut after = observe(daemon, name, runs).await;
    let has_ended = matches!(change, "fault" | "stop, start" | "kill, start");
    if name == swarm.name {
        after.insert("get/wait for a fault", swarm.waited(has_ended).await);
    }
    after.extend(probe(&daemon.client, name, &swarm.sent).await);
    table.judge(change, &swarm.made, &swarm.before, &after);
}

#[tokio::test(flavor = "multi_thread")]
async fn each_change_of_a_swarm_restarts_and_continues_the_values_in_the_table() {
    let mut table = Table::of("swarms");
    let folder = || tempfile::tempdir().unwrap();

    let data = folder();
    let mut it = scenario(data.path()).await;
    for name in ["school", "moving"] {
        it.daemon.client.ok(name, "reset", json!({})).await;
    }
    let names = ("school", Some("moving"));
    judge(&mut table, "reset", &it.daemon, &mut it.stands, names).await;

    faults(&mut table, folder().path()).await;
    copies(&mut table, folder().path()).await;

    let data = folder();
    let mut it = scenario(data.path()).await;
    let client = &it.daemon.client;
    client.ok("moving", "pause", json!({})).await;
    let step = client.get("moving", "status").await["step"].as_u64();
    client.ok("moving", "run", json!({})).await;
    until("it steps on", async || {
        client.get("moving", "status").await["step"].as_u64() > step
    })
    .await;
    let names = ("moving", Some("moving"));
    judge(&mut table, "pause, run", &it.daemon, &mut it.runs, names).await;

    for (how, change) in [(End::Stop, "stop, start"), (End::Kill, "kill, start")] {
        let data = folder();
        let mut it = scenario(data.path()).await;
        it.daemon.end(how);
        it.daemon = Served::on(data.path(), "").await;
        let client = &it.daemon.client;
        let step = it.stands.before["step of one that runs"].as_u64();
        client.wait_for_step("moving", step.unwrap() + 1).await;
        let names = ("school", Some("moving"));
        judge(&mut table, change, &it.daemon, &mut it.stands, names).await;
    }

    full_disk(&mut table).await;
    table.finish();
}

/// A swarm that faults in the step after those that it has taken, and is reset. The first `verify` has
/// taken the same steps again.
async fn faults(table: &mut Table, data: &Path) {
    let points = format!("step={}*off->1*panic->off", 2 * STEPS);
    let daemon = begin(data, &points, &["school"]).await;
    let _states = subscribe(&daemon.client, keys::state(PREFIX, "*")).await;
    let mut swarm = prepare(&daemon, data, "school", Kind::Stands).await;
    let request = json!({"expect_step": STEPS, "args": {"controller": "ada"}});
    let (code, _) = daemon.client.err("school", "advance", request).await;
    assert_eq!(code, ErrorCode::Faulted);
    let names = ("school", None);
    judge(table, "fault", &daemon, &mut swarm, names).await;
    daemon.client.ok("school", "reset", json!({})).await;
    judge(table, "fault, reset", &daemon, &mut swarm, names).await;
}

/// A swarm that is forked and restored, and the copies.
async fn copies(table: &mut Table, data: &Path) {
    let mut it = scenario(data).await;
    let client = &it.daemon.client;
    for (name, copy) in [("school", "fork"), ("moving", "fork-of-moving")] {
        client.ok(name, "fork", json!({"name": copy})).await;
    }
    let names = ("fork", Some("fork-of-moving"));
    judge(table, "fork: copy", &it.daemon, &mut it.stands, names).await;
    for (name, copy) in [("school", "again"), ("moving", "moving-again")] {
        let whole = snapshot(client, name).await;
        let error = restore(client, name, &whole).await.unwrap_err();
        assert_eq!(error.code, ErrorCode::AlreadyExists);
        restore(client, copy, &whole).await.unwrap();
    }
    let names = ("again", Some("moving-again"));
    judge(table, "restore", &it.daemon, &mut it.stands, names).await;
    let names = ("school", Some("moving"));
    judge(table, "fork: origin", &it.daemon, &mut it.stands, names).await;

    // The durable history of a fork.
    let data = tempfile::tempdir().unwrap();
    let mut it = scenario(data.path()).await;
    for (name, copy) in [("school", "fork"), ("moving", "fork-of-moving")] {
        let args = json!({"name": copy});
        it.daemon.client.ok(name, "fork", args).await;
    }
    it.daemon.kill();
    it.daemon = Served::on(data.path(), "").await;
    let names = ("fork", Some("fork-of-moving"));
    let change = "fork: copy, kill, start";
    judge(table, change, &it.daemon, &mut it.stands, names).await;
}

/// A disk that is full, and has space again.
async fn full_disk(table: &mut Table) {
    let Some(disk) = SmallDisk::mount(16) else {
        return;
    };
    let mut it = scenario(disk.path()).await;
    let client = &it.daemon.client;
    // A command without effect. The other swarm uses up the reserve of the store.
    let same = json!({"publish_every": 7});
    disk.fill();
    until("the disk is full", async || {
        // Fills the space that a recording frees.
        disk.fill_more();
        let answer = client.cmd("moving", "set", same.clone()).await;
        answer.is_err_and(|error| error.code == ErrorCode::StorageFull)
    })
    .await;
    let names = ("school", Some("moving"));
    judge(table, "full disk", &it.daemon, &mut it.stands, names).await;
    it.stands.before = observe(&it.daemon, "school", names.1).await;
    it.stands.before.extend([
        ("get/wait for a fault", json!("waits")),
        ("request sent again", json!("first reply")),
        ("new command", json!("refused storage_full")),
        ("durable_step", json!("stays behind")),
    ]);
    disk.make_room();
    until("there is room", async || {
        client.cmd("school", "set", same.clone()).await.is_ok()
    })
    .await;
    judge(table, "room again", &it.daemon, &mut it.stands, names).await;
}
