//! `nodes`: the daemons that are reached here.

use jostle_proto::{Hello, NodeReply, NodeStatus, keys};
use serde_json::{Value, json};

use crate::bus::{Answer, Bus, Whom};
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::table;
use crate::verbs::look::Sight;

/// The daemons that are there, each with what it says about itself.
///
/// # Errors
///
/// That there are none.
pub async fn sight(bus: &Bus, output: Output) -> Result<Sight, Failure> {
    let names = bus.nodes().await?;
    if names.is_empty() {
        return Err(bus.nobody().await);
    }
    let (mut rows, mut documents, mut notes) = (Vec::new(), Vec::new(), Vec::new());
    for name in names {
        let hello = get(bus, &name, "hello").await;
        let status = get(bus, &name, "status").await;
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
    let data = if output.json {
        json!({ "nodes": documents }).to_string()
    } else {
        let header = [
            "node", "version", "wire", "up", "swarms", "running", "faulted", "memory", "clients",
        ];
        table::table(header, rows)
    };
    Ok(Sight {
        data: Some(data),
        note: (!notes.is_empty()).then(|| notes.join("\n")),
    })
}

async fn get(bus: &Bus, node: &str, noun: &str) -> Result<Answer, Failure> {
    let key = keys::node_get(bus.prefix(), node, noun);
    bus.ask_again(Whom::Node(node), &key, None).await
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
