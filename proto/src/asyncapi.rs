//! The AsyncAPI document: what is on which key, for people's tools.
//!
//! AsyncAPI has no binding for zenoh, so what zenoh adds stands under `x-zenoh`: how a key is
//! declared, in which encodings, whether wildcards are welcome. The application it describes is
//! the daemon: what it publishes it sends, a query it receives and answers with a `reply`.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use crate::claim::Standing;
use crate::contract::{CHANNELS, Channel, ChannelKind, definition, schemas};
use crate::keys::{DEFAULT_PREFIX, NAME_RULE};
use crate::{CBOR, JSON, WIRE_VERSION};

/// A message's examples: each with its name.
pub type Examples = BTreeMap<&'static str, Vec<(String, Value)>>;

/// The document, with `examples` of its messages. Payloads are described by `schema/`.
pub fn document(examples: &Examples) -> Value {
    let mut channels = Map::new();
    let mut operations = Map::new();
    for channel in CHANNELS.iter() {
        channels.insert(id(channel), describe(channel));
        operations.extend(operate(channel));
    }
    json!({
        "asyncapi": "3.0.0",
        "info": {
            "title": "jostle",
            "version": WIRE_VERSION.to_string(),
            "description": "A daemon that hosts swarms of bodies which only push each other, on \
                            zenoh. Requests with unknown fields are rejected; replies and samples may have \
                            more than is described here, and readers tolerate it. See README.md \
                            beside this file.",
            "license": {"name": "MIT OR Apache-2.0"},
        },
        "defaultContentType": JSON,
        "servers": {"local": {
            "host": "127.0.0.1:7447",
            "protocol": "zenoh",
            "description": "A daemon on this machine, at its default address.",
            "x-zenoh": {
                "endpoint": "tcp/127.0.0.1:7447",
                "mode": "client",
                "scouting": false,
                "gossip": false,
            },
        }},
        "channels": channels,
        "operations": operations,
        "components": {
            "parameters": parameters(),
            "messages": messages(examples),
        },
    })
}

/// The parameters of the addresses.
fn parameters() -> Map<String, Value> {
    let name = |of: &str| json!({"description": format!("{of}: {NAME_RULE}")});
    [
        (
            "prefix",
            json!({
                "description": "The first chunk of every key; a setting of the daemon.",
                "default": DEFAULT_PREFIX,
            }),
        ),
        ("swarm", name("A swarm's name")),
        ("node", name("A daemon's name")),
        ("controller", name("A controller's name")),
        ("experiment", name("An experiment's name")),
        (
            "id",
            json!({"description": "The id that the client gave its wait, in its query."}),
        ),
        (
            "instance",
            json!({
                "description": "One run of a daemon: the time of its start, then the id of its zenoh session.",
            }),
        ),
        (
            "standing",
            json!({
                "description": "Whether the daemon serves the name, and has changed the swarm since it does.",
                "enum": Standing::ALL.map(Standing::word),
            }),
        ),
    ]
    .map(|(name, described)| (name.to_owned(), described))
    .into_iter()
    .collect()
}

/// What a channel is called in the document, such as `swarm_get_status`.
fn id(channel: &Channel) -> String {
    let key = channel.key.trim_end_matches("/{node}");
    key.replace("@node/", "")
        .replace(['{', '}'], "")
        .replace('/', "_")
}

fn describe(channel: &Channel) -> Value {
    let address = format!("{{prefix}}/{}", channel.key);
    let link = |folder: &str, name: &str| {
        let place = format!("components/{folder}/{name}");
        (name.to_owned(), refer(&place))
    };
    let parameters: Map<String, Value> = parameters()
        .keys()
        .filter(|name| address.contains(&format!("{{{name}}}")))
        .map(|name| link("parameters", name))
        .collect();
    let messages: Map<String, Value> = all(channel)
        .into_iter()
        .map(|name| link("messages", name))
        .collect();
    let mut description = json!({
        "address": address,
        "description": channel.doc,
        "parameters": parameters,
        "messages": messages,
        "bindings": {"x-zenoh": zenoh(channel)},
    });
    if matches!(channel.kind, ChannelKind::Token | ChannelKind::ClientToken)
        && let Some(fields) = description.as_object_mut()
    {
        fields.remove("messages");
    }
    description
}

/// What zenoh adds.
fn zenoh(channel: &Channel) -> Value {
    let publisher = |encoding: &str| {
        json!({
            "kind": "publisher",
            "encoding": encoding,
            "congestion_control": "drop",
            "attachment": "none",
        })
    };
    let attached = |mut publisher: Value| {
        publisher["attachment"] = json!(format!("attachment, {CBOR}"));
        publisher
    };
    let queryable = |declared: &str, wildcards: &str| {
        let parameters = channel.parameters.iter();
        let parameters: Map<String, Value> = parameters
            .map(|it| (it.name.to_owned(), json!(format!("{}{}", it.range, it.doc))))
            .collect();
        json!({
            "kind": "queryable",
            "declared": format!("{{prefix}}/{declared}"),
            "wildcards": wildcards,
            "selector_parameters": parameters,
            "errors": "reply_err, application/json",
            "attachment": "none",
        })
    };
    // One queryable for all nouns, one for all verbs: an unknown one gets an answer too.
    let declared = match (
        channel.key.split_once("/{experiment}/"),
        channel.key.rsplit_once('/'),
    ) {
        (Some((start, _)), _) | (None, Some((start, _))) => format!("{start}/**"),
        (None, None) => channel.key.to_owned(),
    };
    match channel.kind {
        ChannelKind::Token => json!({"kind": "liveliness"}),
        ChannelKind::ClientToken => json!({"kind": "liveliness of a client"}),
        ChannelKind::Put(_) => json!({
            "kind": "subscriber",
            "encodings": [JSON, CBOR],
            "attachment": "none",
        }),
        ChannelKind::Published("event") => {
            let mut event = publisher(JSON);
            event["advanced"] = json!({"cache": 64, "heartbeat_secs": 2});
            event
        }
        ChannelKind::Published(_) => publisher(JSON),
        ChannelKind::PublishedAndQueried("state") => json!({
            "kind": "publisher and queryable",
            "publisher": attached(publisher(CBOR)),
            "queryable": queryable(channel.key, "welcome"),
        }),
        ChannelKind::PublishedAndQueried(_) => json!({
            "kind": "publisher and queryable",
            "publisher": publisher(JSON),
            "queryable": queryable(&declared, "welcome"),
        }),
        ChannelKind::Get(_) if !channel.answers_wildcards => queryable(&declared, "not answered"),
        ChannelKind::Get(_) => queryable(&declared, "welcome"),
        ChannelKind::Command(..) => queryable(&declared, "rejected: a wildcard executes nothing"),
    }
}

/// The messages a query on a channel may carry.
fn asked(kind: ChannelKind) -> Vec<&'static str> {
    match kind {
        ChannelKind::Published(_)
        | ChannelKind::Put(_)
        | ChannelKind::Token
        | ChannelKind::ClientToken => vec![],
        ChannelKind::PublishedAndQueried(_) | ChannelKind::Get(_) => vec!["query"],
        ChannelKind::Command(verb) => vec![verb.args, "request"],
    }
}

/// The messages it may be answered with.
fn answered(kind: ChannelKind) -> Vec<&'static str> {
    match kind {
        ChannelKind::Published(_)
        | ChannelKind::Put(_)
        | ChannelKind::Token
        | ChannelKind::ClientToken => vec![],
        ChannelKind::PublishedAndQueried(reply) | ChannelKind::Get(reply) => {
            vec![reply, "error"]
        }
        ChannelKind::Command(verb) if verb.at_step => {
            vec![verb.reply, "scheduled.reply", "error"]
        }
        ChannelKind::Command(verb) => vec![verb.reply, "error"],
    }
}

/// Every message of a channel.
fn all(channel: &Channel) -> Vec<&'static str> {
    match channel.kind {
        ChannelKind::Published(message) | ChannelKind::Put(message) => vec![message],
        kind => [asked(kind), answered(kind)].concat(),
    }
}

/// The operations of a channel, each with its name.
fn operate(channel: &Channel) -> Vec<(String, Value)> {
    let id = id(channel);
    let named = |messages: &[&str]| -> Value {
        let messages = messages.iter();
        messages
            .map(|name| refer(&format!("channels/{id}/messages/{name}")))
            .collect()
    };
    let send = |verb: &str, messages: &[&str]| {
        let mut operation = json!({
            "action": "send",
            "channel": refer(&format!("channels/{id}")),
            "summary": channel.doc,
        });
        if !messages.is_empty() {
            operation["messages"] = named(messages);
        }
        (format!("{verb}_{id}"), operation)
    };
    let take = |verb: &str, messages: &[&str]| {
        let (name, mut operation) = send(verb, messages);
        operation["action"] = json!("receive");
        (name, operation)
    };
    let answer = |verb: &str| {
        let operation = json!({
            "action": "receive",
            "channel": refer(&format!("channels/{id}")),
            "summary": channel.doc,
            "messages": named(&asked(channel.kind)),
            "reply": {
                "channel": refer(&format!("channels/{id}")),
                "messages": named(&answered(channel.kind)),
            },
        });
        (format!("{verb}_{id}"), operation)
    };
    match channel.kind {
        ChannelKind::Published(message) => vec![send("publish", &[message])],
        ChannelKind::PublishedAndQueried(message) => {
            vec![send("publish", &[message]), answer("answer")]
        }
        ChannelKind::Token => vec![send("hold", &[])],
        ChannelKind::Put(message) => vec![take("take", &[message])],
        ChannelKind::ClientToken => vec![take("watch", &[])],
        ChannelKind::Get(_) => vec![answer("answer")],
        ChannelKind::Command(..) => vec![answer("execute")],
    }
}

/// Every message: its schema and examples.
fn messages(examples: &Examples) -> Value {
    let mut messages = Map::new();
    for (name, schema) in schemas() {
        let (file, type_name) = definition(name, &schema);
        let description = schema.get("description").cloned().unwrap_or_default();
        let examples: Vec<Value> = examples
            .get(name)
            .into_iter()
            .flatten()
            .map(|(name, payload)| json!({"name": name, "payload": payload}))
            .collect();
        let encodings = match name {
            "state" => json!([CBOR, JSON]),
            "step.reply" => json!([JSON, CBOR]),
            "attachment" | "snapshot.reply" | "experiment.order" | "experiment.series" => {
                json!([CBOR])
            }
            _ => json!([JSON]),
        };
        let message = json!({
            "name": name,
            "title": schema.get("title"),
            "summary": description,
            "contentType": encodings[0],
            "payload": {"$ref": format!("./schema/{file}#/$defs/{type_name}")},
            "bindings": {"x-zenoh": {"encodings": encodings}},
            "examples": examples,
        });
        messages.insert(name.to_owned(), message);
    }
    let query = json!({
        "name": "query",
        "title": "Query",
        "summary": "A query without a payload; what it asks for is in its key and parameters.",
    });
    messages.insert("query".to_owned(), query);
    messages.into()
}

fn refer(place: &str) -> Value {
    json!({"$ref": format!("#/{place}")})
}
