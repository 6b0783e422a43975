//! `nodes`: the daemons that are reachable.

use jostle_client::{Payload, Target};
use jostle_proto::{Hello, NodeReply, NodeStatus, keys};
use serde_json::{Value, json};

use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::table;

/// Lists the daemons that are reachable, each with its own description.
pub async fn nodes(context: &Context) -> Result<(), Failure> {
    let Context { client, output } = context;
    let names = client.nodes().await?;
    if names.is_empty() {
        return Err(client.no_node().await.into());
    }
    let (mut rows, mut documents, mut notes) = (Vec::new(), Vec::new(), Vec::new());
    for name in names {
        let hello = get(context, &name, "hello").await;
        let status = get(context, &name, "status").await;
        match (hello, status) {
            (Ok(hello), Ok(status)) => {
                documents.push(json!({
                    "node": name,
                    "hello": hello.read::<NodeReply<Value>>()?.result,
                    "status": status.read::<NodeReply<Value>>()?.result,
                    "error": null,
                }));
                let hello = hello.read::<NodeReply<Hello>>()?.result;
                let status = status.read::<NodeReply<NodeStatus>>()?.result;
                rows.push(row(name, &hello, &status));
            }
            (Err(failure), _) | (_, Err(failure)) => {
                notes.push(failure.to_string());
                documents.push(json!({
                    "node": name, "hello": null, "status": null, "error": failure.to_json(),
                }));
                let mut silent = [const { String::new() }; 9].map(|_| format::NONE.to_owned());
                silent[0] = name;
                rows.push(silent);
            }
        }
    }
    if !notes.is_empty() {
        output.note(&notes.join("\n"));
    }
    let header = [
        "node",
        "version",
        "wire",
        "up",
        "swarms",
        "running",
        "faulted",
        "reserved_memory",
        "clients",
    ];
    let text = table::table(header, rows);
    output.print(&json!({ "nodes": documents }), &text)
}

async fn get(context: &Context, node: &str, noun: &str) -> Result<Payload, Failure> {
    let client = &context.client;
    let key = keys::node_get(client.prefix(), node, noun);
    Ok(client.query(Target::Node(node), &key, None).await?)
}

fn row(name: String, hello: &Hello, status: &NodeStatus) -> [String; 9] {
    [
        name,
        hello.version.clone(),
        hello.wire_version.to_string(),
        format::duration(status.uptime_secs),
        status.swarms.to_string(),
        status.running.to_string(),
        status.faulted.to_string(),
        format::bytes(status.memory_bytes),
        status.clients.to_string(),
    ]
}
