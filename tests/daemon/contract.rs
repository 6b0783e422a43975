//! The documents in `proto/` describe all that a daemon serves, and a daemon serves all of it.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::time::Duration;

use jostle_proto::asyncapi::{self, Examples};
use jostle_proto::{Error, ErrorCode, Event, keys};
use serde_json::{Value, json};
use zenoh::Session;
use zenoh_ext::{AdvancedSubscriberBuilderExt, HistoryConfig};

use crate::support::playback;
use crate::support::{Daemon, NODE, PREFIX, until};

mod bounds;
mod facts;
mod prepare;
mod recorded;

use prepare::{
    create, finish_experiment, prepare_experiment, prepare_recording, prepare_replay, send,
    send_again,
};

/// A key of the document with its zenoh binding.
struct Channel {
    key: String,
    zenoh: Value,
}

/// The document's channels for a swarm.
fn channels(swarm: &str) -> Vec<Channel> {
    let document = asyncapi::document(&Examples::new());
    let channels = document["channels"].as_object().unwrap().values();
    channels
        .map(|channel| Channel {
            key: filled(&channel["address"], swarm),
            zenoh: channel["bindings"]["x-zenoh"].clone(),
        })
        .collect()
}

/// The key of a token; wildcards replace a claim's instance and standing.
fn of_any_run(key: &str) -> String {
    match key.rsplitn(3, '/').collect::<Vec<_>>()[..] {
        [_, _, claim] if claim.contains("/claim") => format!("{claim}/*/*"),
        _ => key.to_owned(),
    }
}

/// The experiment of the fixtures.
const EXPERIMENT: &str = "small";

/// An address with names for its parameters.
fn filled(address: &Value, swarm: &str) -> String {
    let address = address.as_str().unwrap().replace("{prefix}", PREFIX);
    let address = address.replace("{swarm}", swarm).replace("{node}", NODE);
    let address = address.replace("{controller}", "*");
    let address = address.replace("{instance}/{standing}", "*/*");
    address.replace("{experiment}", EXPERIMENT)
}

fn proto() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../proto"))
}

/// The fixtures of a message, each with the rest of its name.
fn fixtures(message: &str) -> Vec<(String, Value)> {
    let mut fixtures = Vec::new();
    for entry in fs::read_dir(proto().join("fixtures")).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        let Some(rest) = name
            .strip_prefix(message)
            .and_then(|it| it.strip_suffix("json"))
        else {
            continue;
        };
        if rest.starts_with('.') {
            let text = fs::read_to_string(&path).unwrap();
            fixtures.push((name, serde_json::from_str(&text).unwrap()));
        }
    }
    assert!(!fixtures.is_empty(), "{message} has fixtures");
    fixtures.sort_by(|(a, _), (b, _)| a.cmp(b));
    fixtures
}

/// Fails unless a reply equals what its type writes.
fn check_reply(message: &str, reply: &Value) {
    let back = jostle_contract::rewrite(message, &reply.to_string());
    let back = back.map(|text: String| serde_json::from_str::<Value>(&text).unwrap());
    assert_eq!(back.as_ref(), Ok(reply), "{message}");
}

#[tokio::test(flavor = "multi_thread")]
async fn every_channel_of_the_document_is_served() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    create(client, "a").await;
    let samples = client.session.declare_subscriber(keys::state(PREFIX, "a"));
    let state = samples.await.unwrap();
    let samples = client.session.declare_subscriber(keys::order(PREFIX, "a"));
    let order = samples.await.unwrap();
    let samples = client.session.declare_subscriber(keys::event(PREFIX, "a"));
    let event = samples.await.unwrap();
    let key = keys::experiment(PREFIX, NODE, EXPERIMENT, "progress");
    let progress = client.session.declare_subscriber(key).await.unwrap();
    let published = [
        ("state", state),
        ("order", order),
        ("event", event),
        ("progress", progress),
    ];
    let begin = json!({"begin": {"swarm": "a", "recording": "take"}});
    send_again(client, "", "record", &begin).await.unwrap();
    client.ok("a", "step", json!({"steps": 10})).await;
    let stop = json!({"stop": {"recording": "take"}});
    send_again(client, "", "record", &stop).await.unwrap();
    finish_experiment(client).await;

    let mut verbs = Vec::new();
    for Channel { key, zenoh } in channels("a") {
        let kind = zenoh["kind"].as_str().unwrap();
        let last = key.rsplit('/').next().unwrap();
        if kind.contains("publisher") {
            let publisher = zenoh.get("publisher").unwrap_or(&zenoh);
            let (_, samples) = published.iter().find(|(name, _)| *name == last).unwrap();
            let sample = samples.recv_async().await.unwrap();
            assert_eq!(sample.key_expr().as_str(), key);
            assert_eq!(
                sample.encoding().to_string(),
                publisher["encoding"],
                "{key}"
            );
            let attachment = sample.attachment().map(|it| it.to_bytes());
            match attachment {
                None => assert_eq!(publisher["attachment"], "none", "{key}"),
                Some(bytes) => {
                    assert_eq!(
                        publisher["attachment"], "attachment, application/cbor",
                        "{key}"
                    );
                    let read: Value = ciborium::from_reader(&bytes[..]).unwrap();
                    check_reply("attachment", &read);
                }
            }
        }
        if kind == "liveliness" {
            let tokens = tokens(&client.session, &key).await;
            let tokens: Vec<String> = tokens.iter().map(|it| of_any_run(it)).collect();
            assert_eq!(tokens, [key]);
        } else if key.contains("/cmd/") {
            verbs.push(last.to_owned());
        } else if kind.contains("queryable") {
            let parameters = match last {
                "wait" => "?step=0",
                "recording" => "?name=take",
                "order" | "series" => "?run=n=2 #0",
                _ => "",
            };
            let reply = client
                .query(&format!("{key}{parameters}"), None)
                .await
                .unwrap();
            let message = match last {
                "state" => "state".to_owned(),
                "wait" => "status.reply".to_owned(),
                "experiment" => "experiment.file.reply".to_owned(),
                noun if key.contains("/experiment/") => format!("experiment.{noun}"),
                noun if key.contains("/@node/") => format!("node.{noun}.reply"),
                noun => format!("{noun}.reply"),
            };
            check_reply(&message, &reply);
        }
    }
    let take = playback::recorded_file(client).await;
    for verb in verbs {
        for (i, (fixture, args)) in fixtures(&format!("{verb}.args")).into_iter().enumerate() {
            let swarm = format!("{verb}-{i}");
            if verb == "experiment" {
                prepare_experiment(client, &args).await;
            }
            if verb == "record" {
                prepare_recording(client, &args).await;
            }
            let answer = match &*verb {
                "discard" => {
                    let _ = client.cmd("school", "delete", json!({})).await;
                    create(client, "school").await;
                    send_again(client, &swarm, &verb, &args).await
                }
                "replay" => {
                    prepare_replay(&daemon, &args, &take).await;
                    send(client, &swarm, &verb, &args).await
                }
                "seek" => {
                    playback::upload_and_open(client, &swarm, &take)
                        .await
                        .unwrap();
                    send_again(client, &swarm, &verb, &args).await
                }
                "when" if args.get("id").is_some() => {
                    // The condition of this id.
                    let first = json!({"condition": "order > 0.9 for 20", "pause": true});
                    send(client, &swarm, &verb, &first).await.unwrap();
                    send_again(client, &swarm, &verb, &args).await
                }
                _ => send(client, &swarm, &verb, &args).await,
            };
            if fixture.starts_with("experiment.args.expand_files") {
                // A run with set-points cannot be played.
                assert_eq!(answer.unwrap_err().details["field"], "expand.toml");
                continue;
            }
            let reply = answer.unwrap_or_else(|error| panic!("{fixture}: {error:?}"));
            check_reply(&format!("{verb}.reply"), &reply);
            let later = json!({"at_step": 1_000_000, "args": args});
            let is_of_none = ["discard", "experiment", "record", "replay"].contains(&&*verb);
            if MAKING.contains(&&*verb) || is_of_none || verb == "seek" {
                let error = send_again(client, &swarm, &verb, &later).await.unwrap_err();
                assert_eq!(error.details["field"], "at_step", "{verb}");
                if is_of_none {
                    continue;
                }
                // Other fixtures use the same name.
                let made = reply["swarm"].as_str().unwrap();
                client.ok(made, "delete", json!({})).await;
            } else if verb == "advance" {
                let error = send_again(client, &swarm, &verb, &later).await.unwrap_err();
                assert_eq!(error.details["field"], "at_step", "{verb}");
                client.ok(&swarm, "delete", json!({})).await;
            } else if verb != "delete" {
                let reply = client.ok(&swarm, &verb, later).await;
                check_reply("scheduled.reply", &reply);
                if verb == "protect" {
                    client.ok(&swarm, &verb, json!({"on": false})).await;
                }
                client.ok(&swarm, "delete", json!({})).await;
            }
        }
    }
    daemon.stop().await;
}

/// Verbs that create a swarm: they cannot be scheduled.
const MAKING: [&str; 3] = ["create", "fork", "restore"];

async fn tokens(session: &Session, key: &str) -> Vec<String> {
    let replies = session.liveliness().get(key).await.unwrap();
    let mut tokens = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        tokens.push(reply.into_result().unwrap().key_expr().as_str().to_owned());
    }
    tokens
}

/// A router session that is connected to the daemon, which forwards all its declarations to it.
async fn peer(daemon: &Daemon) -> Session {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", json!("router")),
        ("scouting/delay", json!(0)),
        ("connect/endpoints", json!(daemon.server.endpoints)),
        ("listen/endpoints", json!([])),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        ("adminspace/enabled", json!(true)),
    ] {
        config.insert_json5(key, &value.to_string()).unwrap();
    }
    zenoh::open(config).await.unwrap()
}

/// Whether `peer` has received a queryable that matches `key`.
async fn has_queryable(peer: &Session, key: &str) -> bool {
    let querier = peer.declare_querier(key.to_owned()).await.unwrap();
    querier.matching_status().await.unwrap().matching()
}

/// The keys of a kind that `peer` received; zenoh hides those below `@node`. No declaration may
/// arrive meanwhile: zenoh's admin space locks its tables for reading, and again to reply, which
/// waits for ever if another thread waits to write between the two.
async fn declared(peer: &Session, kind: &str) -> BTreeSet<String> {
    let start = format!("@/{}/router/{kind}/", peer.zid());
    let replies = peer.get(format!("{start}**")).await.unwrap();
    let mut declared = BTreeSet::new();
    while let Ok(reply) = replies.recv_async().await {
        let sample = reply.into_result().unwrap();
        let key = sample.key_expr().as_str().strip_prefix(&start).unwrap();
        declared.insert(key.to_owned());
    }
    declared
}

/// The documented keys of a kind, those of a swarm or those of the node; of a queryable what is
/// declared for it.
fn documented(kind: &str, is_node: bool) -> BTreeSet<String> {
    let channels = channels("a").into_iter();
    let of_kind = channels.filter(|channel| {
        let is = channel.zenoh["kind"].as_str().unwrap();
        is.split(" and ").any(|it| it == kind) && channel.key.contains("/@node/") == is_node
    });
    of_kind
        .map(|Channel { key, zenoh }| {
            let queryable = zenoh.get("queryable").unwrap_or(&zenoh);
            match queryable.get("declared") {
                Some(declared) if kind == "queryable" => filled(declared, "a"),
                _ => key,
            }
        })
        .collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn everything_the_daemon_declares_is_in_the_document() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    create(client, "a").await;
    let peer = peer(&daemon).await;
    let [mut queryable, token] = ["queryable", "liveliness"].map(|kind| documented(kind, false));
    // Replies to a retried deletion when its swarm is gone.
    queryable.insert(keys::cmd(PREFIX, "*", "delete"));
    until("all declarations", async || {
        for key in &queryable {
            if !has_queryable(&peer, key).await {
                return false;
            }
        }
        tokens(&peer, "**").await.len() >= token.len()
    })
    .await;
    // What is declared and not documented.
    tokio::time::sleep(Duration::from_millis(200)).await;
    assert_eq!(declared(&peer, "queryable").await, queryable);
    let declared_tokens = declared(&peer, "token").await;
    let declared_tokens = declared_tokens.iter().map(|it| of_any_run(it));
    assert_eq!(BTreeSet::from_iter(declared_tokens), token);
    let controls = BTreeSet::from([keys::ctl(PREFIX, "*", "*")]);
    assert_eq!(declared(&peer, "subscriber").await, controls);
    let of_nodes = tokens(&client.session, "**/@node/**").await;
    let of_nodes = of_nodes.iter().map(|it| of_any_run(it));
    assert_eq!(
        BTreeSet::from_iter(of_nodes),
        documented("liveliness", true)
    );

    let everything = peer.declare_subscriber("**").await.unwrap();
    let nodes = peer.declare_subscriber("**/@node/**").await.unwrap();
    let mut published = BTreeSet::new();
    until("all publications", async || {
        client.ok("a", "step", json!({"steps": 10})).await;
        while let Ok(Some(sample)) = everything.try_recv() {
            published.insert(sample.key_expr().as_str().to_owned());
        }
        published.len() >= documented("publisher", false).len()
    })
    .await;
    assert_eq!(published, documented("publisher", false));
    assert!(nodes.try_recv().unwrap().is_none());
    peer.close().await.unwrap();
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn late_subscribers_get_as_many_events_as_the_document_states() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    create(client, "a").await;
    for _ in 0..70 {
        client.ok("a", "set", json!({"pi3": 1.2})).await;
    }
    let key = keys::event(PREFIX, "a");
    let channel = channels("a").into_iter().find(|it| it.key == key).unwrap();
    let cached = channel.zenoh["advanced"]["cache"].as_u64().unwrap();
    let page = client.get("a", "events").await;
    let newest = page["result"]["newest"].as_u64().unwrap();
    let late = daemon.another_client().await.session;
    let events = late
        .declare_subscriber(&key)
        .history(HistoryConfig::default())
        .await
        .unwrap();
    for number in newest - cached + 1..=newest {
        let sample = events.recv_async().await.unwrap();
        let event: Event = serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
        assert_eq!(event.number, number);
    }
    late.close().await.unwrap();
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn wildcards_get_replies_where_the_document_permits_them() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    create(client, "a").await;
    finish_experiment(client).await;
    for (everything, is_node) in [("jostle/**", false), ("jostle/@node/**", true)] {
        let replies = client.session.get(everything).await.unwrap();
        let (mut answered, mut rejected) = (BTreeSet::new(), 0);
        while let Ok(reply) = replies.recv_async().await {
            match reply.into_result() {
                Ok(sample) => {
                    answered.insert(sample.key_expr().as_str().to_owned());
                }
                Err(error) => {
                    let error: Error = serde_json::from_slice(&error.payload().to_bytes()).unwrap();
                    assert!(
                        error.message.contains("a wildcard executes nothing"),
                        "{error:?}"
                    );
                    rejected += 1;
                }
            }
        }
        let channels = channels("a").into_iter();
        let welcoming = channels.filter(|Channel { key, zenoh }| {
            let queryable = zenoh.get("queryable").unwrap_or(zenoh);
            key.contains("/@node/") == is_node && queryable["wildcards"] == "welcome"
        });
        assert_eq!(answered, welcoming.map(|channel| channel.key).collect());
        assert_eq!(rejected, 1, "one queryable for all verbs");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_verbs_and_nouns_that_errors_name_are_those_of_the_document() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    create(client, "a").await;
    for folder in [
        keys::get(PREFIX, "a", ""),
        keys::cmd(PREFIX, "a", ""),
        keys::node_get(PREFIX, NODE, ""),
        keys::node_cmd(PREFIX, NODE, ""),
        keys::experiment(PREFIX, NODE, EXPERIMENT, ""),
    ] {
        let error = client
            .query(&format!("{folder}jump"), None)
            .await
            .unwrap_err();
        assert_eq!(error.code, ErrorCode::NotFound);
        let known: BTreeSet<String> =
            serde_json::from_value(error.details["known"].clone()).unwrap();
        let channels = channels("a").into_iter();
        let documented = channels.filter_map(|it| Some(it.key.strip_prefix(&folder)?.to_owned()));
        assert_eq!(known, documented.collect(), "{folder}");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_schemas_that_a_daemon_serves_are_those_in_the_repository() {
    let read = |file: &str| -> Value {
        let text = fs::read_to_string(proto().join(file)).unwrap();
        serde_json::from_str(&text).unwrap()
    };
    let messages = read("asyncapi.json")["components"]["messages"].take();
    let daemon = Daemon::start().await;
    let mut served = daemon.client.node("schema").await;
    let served = served["schemas"].as_object_mut().unwrap();
    for (name, message) in messages.as_object().unwrap() {
        let Some(place) = message["payload"]["$ref"].as_str() else {
            continue;
        };
        let (file, definition) = place.split_once("#/$defs/").unwrap();
        let mut document = read(file);
        let mut schema = served.remove(name).unwrap();
        let schema = schema.as_object_mut().unwrap();
        assert_eq!(schema.remove("title"), Some(json!(definition)), "{name}");
        assert_eq!(
            schema.remove("$schema").as_ref(),
            document.get("$schema"),
            "{name}"
        );
        let nested = schema.remove("$defs").unwrap_or_default();
        for (nested, schema) in nested.as_object().into_iter().flatten() {
            assert_eq!(*schema, document["$defs"][nested], "{name}: {nested}");
        }
        let root = document["$defs"][definition].take();
        assert_eq!(Value::Object(schema.clone()), root, "{name}");
    }
    assert!(served.is_empty(), "{served:?}");
    daemon.stop().await;
}
