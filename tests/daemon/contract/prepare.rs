//! Creates the swarms, experiments and recordings that the requests of the fixtures need.

use std::fs;

use jostle_proto::keys;
use serde_json::{Value, json};

use super::{EXPERIMENT, fixtures};
use crate::support::playback;
use crate::support::{Client, Daemon, NODE, PREFIX, QueryResult, until};

/// The spec of the fixtures: four individuals, paused, one of them informed.
pub(super) async fn create(client: &Client, name: &str) {
    let (_, create) = fixtures("create.args.everything").remove(0);
    client.create(name, create["spec"].clone()).await;
    let informed = json!({"select": {"ids": [3]}, "direction": 1});
    client.ok(name, "inform", informed).await;
}

/// Submits the experiment of the fixtures and waits until it is finished.
pub(super) async fn finish_experiment(client: &Client) {
    let (_, submit) = fixtures("experiment.args")
        .into_iter()
        .find(|(name, _)| name == "experiment.args.json")
        .unwrap();
    send_again(client, "", "experiment", &submit).await.unwrap();
    let key = keys::experiment(PREFIX, NODE, EXPERIMENT, "progress");
    until("the experiment is finished", async || {
        client.query(&key, None).await.unwrap()["phase"] == "finished"
    })
    .await;
}

/// Creates an experiment of the fixtures' name to which `args` apply.
pub(super) async fn prepare_experiment(client: &Client, args: &Value) {
    let send = async |args: Value| send_again(client, "", "experiment", &args).await;
    // Deletes earlier experiments, also that whose name has the maximum length.
    let named = args.as_object().unwrap().values();
    let named = named.filter_map(|it| it["name"].as_str());
    for name in named.chain([EXPERIMENT]) {
        let name = json!({"name": name});
        let _ = send(json!({"cancel": name})).await;
        let _ = send(json!({"delete": name})).await;
    }
    let name = json!({"name": EXPERIMENT});
    if args.get("submit").is_some() {
        return;
    }
    let toml = "name = \"small\"\nduration = 1e6\nspec = { n = 20 }\n";
    send(json!({"submit": {"toml": toml}})).await.unwrap();
    if args.get("delete").is_some() {
        send(json!({"cancel": name})).await.unwrap();
    }
}

/// Uploads or records the file that a playback opens.
pub(super) async fn prepare_replay(daemon: &Daemon, args: &Value, take: &[u8]) {
    let client = &daemon.client;
    client
        .query_all(&keys::cmd(PREFIX, "tape", "delete"), None)
        .await;
    if let Some(upload) = args.get("upload") {
        let number = |name: &str| usize::try_from(upload[name].as_u64().unwrap()).unwrap();
        let file = vec![0; number("length")];
        let mut from = 0;
        while from < number("offset") {
            let to = number("offset").min(from + 100_000);
            let _ = playback::upload_piece(client, "tape", &file, from, to).await;
            from = to;
        }
    } else if let Some(recording) = args["open"]["recording"].as_str() {
        let folder = daemon.data_dir().join("recordings").join(recording);
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("part-00000.mcap"), take).unwrap();
    } else {
        playback::upload(client, "tape", take).await;
    }
}

/// Creates a recording of the fixtures' name, unless `args` begin one.
pub(super) async fn prepare_recording(client: &Client, args: &Value) {
    // Another verb may have deleted it.
    client
        .query_all(&keys::cmd(PREFIX, "school", "delete"), None)
        .await;
    create(client, "school").await;
    let send = async |args: Value| send_again(client, "", "record", &args).await;
    let _ = send(json!({"delete": {"recording": "take"}})).await;
    if args.get("begin").is_none() {
        let begin = json!({"swarm": "school", "recording": "take"});
        send(json!({"begin": begin})).await.unwrap();
    }
}

/// Sends a command's arguments to a swarm of its own, or to the node.
pub(super) async fn send(client: &Client, swarm: &str, verb: &str, request: &Value) -> QueryResult {
    if !keys::NODE_VERBS.contains(&verb) {
        create(client, swarm).await;
    }
    if ["advance", "leave"].contains(&verb) {
        let args = json!({"controller": "ada", "select": {"ids": [0, 1, 2]}, "driving": true});
        client.ok(swarm, "join", args).await;
    }
    send_again(client, swarm, verb, request).await
}

/// Sends a command to an existing swarm, or to the node.
pub(super) async fn send_again(
    client: &Client,
    swarm: &str,
    verb: &str,
    request: &Value,
) -> QueryResult {
    let key = match keys::NODE_VERBS.contains(&verb) {
        true => keys::node_cmd(PREFIX, NODE, verb),
        false => keys::cmd(PREFIX, swarm, verb),
    };
    client
        .query(&key, Some(request.to_string().as_bytes()))
        .await
}
