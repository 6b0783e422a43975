//! Requests that succeed if they are permitted, one for each row of the table, and their effects.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::{Reply, Snapshot, keys};
use serde_json::{Value, json};

use super::UserSession;
use crate::support::{NODE, PREFIX, TIMEOUT, until};

/// The swarm, the recording and the experiment that queries are about.
pub const SWARM: &str = "source";
pub const RECORDING: &str = "film";
const EXPERIMENT: &str = "small";

const TOML: &str = "name = \"small\"\nduration = 1\n[[grid]]\nn = [2]\n[measure]\norder_every = 10\nseries_every = 10\ncolumns = [\"order\"]\n";

/// A request that succeeds once, unless the sender is not permitted to send it.
pub struct Request {
    /// The selector over zenoh.
    pub selector: String,
    /// The method and the path over HTTP.
    pub http: String,
    /// The arguments of a command.
    pub args: Option<Value>,
    /// The swarm that a command changes, if it is one that exists.
    swarm: Option<String>,
}

/// Creates what the queries are about.
pub async fn prepare(olga: &UserSession) {
    olga.create(SWARM).await;
    // `get/experiment` needs a step.
    olga.cmd(SWARM, "step", json!({})).await;
    record(olga, RECORDING).await;
    olga.node_cmd("experiment", json!({"submit": {"toml": TOML}}))
        .await;
    let progress = keys::experiment(PREFIX, NODE, EXPERIMENT, "progress");
    until("the experiment is finished", async || {
        olga.ok(&progress, None).await["phase"] == "finished"
    })
    .await;
}

/// Records 20 steps of a swarm.
pub async fn record(olga: &UserSession, recording: &str) {
    let swarm = "filmed";
    olga.create(swarm).await;
    let begin = json!({"begin": {"swarm": swarm, "recording": recording}});
    olga.node_cmd("record", begin).await;
    olga.cmd(swarm, "step", json!({"steps": 20})).await;
    olga.node_cmd("record", json!({"stop": {"recording": recording}}))
        .await;
    let recordings = keys::node_get(PREFIX, NODE, "recordings");
    until("the recording ends", async || {
        let reply = olga.ok(&recordings, None).await;
        let recordings = reply["result"]["recordings"].as_array().unwrap().iter();
        let mut ended = recordings.filter(|it| it["phase"] == "ended");
        ended.any(|it| it["recording"] == recording)
    })
    .await;
}

/// A snapshot as `restore` takes it.
async fn snapshot(olga: &UserSession) -> String {
    let query = olga.session.get(keys::get(PREFIX, SWARM, "snapshot"));
    let reply = query.await.unwrap().recv_async().await.unwrap();
    let sample = reply.into_result().unwrap();
    let reply: Reply<Snapshot> = ciborium::from_reader(&*sample.payload().to_bytes()).unwrap();
    STANDARD.encode(jostle_proto::to_cbor(&reply.result))
}

impl Request {
    /// The request of a row of the table. Swarms and files of a command are created for it, with names that
    /// begin with `name`.
    pub async fn of(row: &str, name: &str, olga: &UserSession) -> Self {
        match row.split_once("/cmd/") {
            Some(("{swarm}", verb)) => Self::command(verb, name, olga).await,
            Some((_, verb)) => Self::node_command(verb, name, olga).await,
            None => Self::query(row),
        }
    }

    fn query(row: &str) -> Self {
        let (selector, http) = match row.rsplit_once('/').unwrap().1 {
            "wait" => ("?step=0", "?step=0"),
            "recording" => ("?name=film", "?name=film"),
            "order" | "series" => ("?run=n=2 #0", "?run=n%3D2%20%230"),
            _ => ("", ""),
        };
        let key = row.replace("{swarm}", SWARM);
        let key = key.replace("{experiment}", EXPERIMENT);
        Request {
            selector: format!("{PREFIX}/{}{selector}", key.replace("{node}", NODE)),
            http: format!("GET /api/get/{}{http}", key.replace("/{node}/", "/")),
            args: None,
            swarm: None,
        }
    }

    async fn command(verb: &str, name: &str, olga: &UserSession) -> Self {
        let one = json!({"select": {"count": 1}});
        let changes = json!({"commands": [{"verb": "set", "args": {"pi3": 1.2}}]});
        let args = match verb {
            "delete" | "pause" | "reset" => json!({}),
            "run" => json!({"until_step": 3}),
            "step" => json!({"steps": 1}),
            "set" => json!({"pi3": 1.1}),
            "inform" => json!({"select": {"count": 1}, "direction": 0.5}),
            "uninform" | "remove" => one,
            "inject" => json!({"count": 1}),
            "batch" => changes,
            "fork" => json!({"name": format!("{name}-copy")}),
            "join" => json!({"controller": "cleo", "select": {"count": 1}}),
            "advance" => json!({"controller": "cleo", "steps": 1}),
            "leave" => json!({"controller": "cleo"}),
            "annotate" => json!({"text": "note"}),
            "seek" => json!({"fraction": 1.0}),
            "when" => json!({"condition": "order > 1", "pause": true}),
            "protect" => json!({"on": true}),
            _ => panic!("{verb} has no request here"),
        };
        match verb {
            "seek" => {
                let open = json!({"open": {"name": name, "recording": RECORDING}});
                olga.node_cmd("replay", open).await;
            }
            _ => olga.create(name).await,
        }
        match verb {
            "uninform" => {
                let all = json!({"select": {"fraction": 1.0}, "direction": 0.5});
                olga.cmd(name, "inform", all).await;
            }
            // Whoever sends it, also over HTTP: an operator holds the token.
            "join" => {
                let key = keys::ctl_alive(PREFIX, name, "cleo");
                let token = olga.session.liveliness().declare_token(key).await.unwrap();
                std::mem::forget(token);
            }
            "advance" | "leave" => {
                let join = json!({"controller": "cleo", "select": {"count": 1}});
                olga.cmd(name, "join", join).await;
            }
            _ => {}
        }
        Request {
            selector: keys::cmd(PREFIX, name, verb),
            http: format!("POST /api/cmd/{name}/{verb}"),
            args: Some(args),
            swarm: Some(name.to_owned()),
        }
    }

    async fn node_command(verb: &str, name: &str, olga: &UserSession) -> Self {
        let args = match verb {
            "create" => json!({"name": name, "spec": {"n": 3}}),
            "restore" => json!({"name": name, "snapshot": snapshot(olga).await}),
            "discard" => {
                olga.create(name).await;
                json!({"name": name})
            }
            "experiment" => json!({"submit": {"toml": TOML, "name": name}}),
            "replay" => json!({"open": {"name": name, "recording": RECORDING}}),
            "record" => {
                olga.create(name).await;
                json!({"begin": {"swarm": name, "recording": name}})
            }
            _ => panic!("{verb} has no request here"),
        };
        Request {
            selector: keys::node_cmd(PREFIX, NODE, verb),
            http: format!("POST /api/node/{verb}"),
            args: Some(args),
            swarm: None,
        }
    }

    /// Everything that the command could change: the state of its swarm, and the list of swarms,
    /// recordings and experiments.
    pub async fn effect(&self, olga: &UserSession) -> Value {
        let mut effect = json!({});
        for (noun, name) in [
            ("swarms", "swarm"),
            ("recordings", "recording"),
            ("experiments", "name"),
        ] {
            let reply = olga.ok(&keys::node_get(PREFIX, NODE, noun), None).await;
            let list = reply["result"][noun].as_array().unwrap().iter();
            let mut names: Vec<_> = list
                .map(|it| it[name].as_str().unwrap().to_owned())
                .collect();
            names.sort();
            effect[noun] = json!(names);
        }
        if let Some(swarm) = &self.swarm {
            let status = olga
                .query_all(&keys::get(PREFIX, swarm, "status"), None)
                .await;
            let mut status = status.into_iter().find_map(Result::ok).unwrap_or_default();
            if let Some(result) = status.get_mut("result").and_then(Value::as_object_mut) {
                // Values that change with time.
                for field in ["real_time_factor", "waiting_for", "history_from"] {
                    assert!(result.remove(field).is_some(), "{field}");
                }
            }
            effect["status"] = status;
        }
        effect
    }

    /// Sends the request over HTTP. Returns the status, and the code of an error.
    pub fn send(&self, address: &str, token: Option<&str>) -> (u16, Option<String>) {
        let body = self.args.as_ref().map_or(String::new(), Value::to_string);
        let token = token.map(|token| format!("Authorization: Bearer {token}\r\n"));
        let (request, token) = (&self.http, token.unwrap_or_default());
        let head = format!(
            "{request} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n{token}\
             Content-Length: {}\r\n\r\n",
            body.len()
        );
        let mut stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(TIMEOUT)).unwrap();
        // The body of a rejected request is not read.
        let _ = stream.write_all((head + &body).as_bytes());
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        let _ = stream.shutdown(Shutdown::Both);
        let text = String::from_utf8_lossy(&answer);
        let (head, body) = text.split_once("\r\n\r\n").unwrap();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        let error: Value = serde_json::from_str(body).unwrap_or_default();
        let code = (status >= 400).then(|| error["code"].as_str().unwrap_or_default().to_owned());
        (status, code)
    }
}
