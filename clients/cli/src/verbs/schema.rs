//! `schema`: the JSON Schemas of the messages, from the daemon, and that of an experiment's file.

use std::collections::BTreeSet;

use jostle_experiment::SCHEMA;
use jostle_proto::contract::{CHANNELS, Channel, ChannelKind};
use jostle_proto::verbs::{NodeVerb, SwarmVerb};
use jostle_proto::{NodeReply, Schemas};
use serde_json::{Map, Value, json};

use crate::arguments::SchemaArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::table;

/// Prints the schema of an experiment's file, which needs no daemon.
pub fn of_file(output: Output) -> Result<(), Failure> {
    let schema = jostle_experiment::schema();
    output.print(&schema, &format!("{schema:#}"))
}

/// Prints the schema of a message, or the list of messages.
pub async fn schema(context: &Context, arguments: &SchemaArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    let answer = client.get_node("schema").await?;
    let schemas = answer.read::<NodeReply<Schemas>>()?.result.schemas;
    let Some(message) = &arguments.message else {
        let mut messages: Vec<&str> = schemas.keys().map(String::as_str).collect();
        messages.push(SCHEMA);
        messages.sort_unstable();
        if output.json {
            let listed = messages.iter().map(|message| {
                let (key, meaning) = purpose(message);
                json!({"message": message, "key": key, "meaning": meaning})
            });
            return output.document(&listed.collect::<Vec<_>>());
        }
        let table = table::of(
            &messages,
            [
                ("message", |it| (*it).to_owned()),
                ("key", |it| purpose(it).0),
            ],
        );
        let docs: Vec<String> = messages.iter().map(|it| purpose(it).1).collect();
        return output.data(&table::documented(&table, &docs));
    };
    let definition = SwarmVerb::of(message).map(SwarmVerb::definition);
    let definition = definition.or_else(|| NodeVerb::of(message).map(NodeVerb::definition));
    let of_verb = definition.map(|it| [it.args, it.reply]).unwrap_or_default();
    let of_verb: Map<String, Value> = schemas
        .iter()
        .filter(|(name, _)| of_verb.contains(&name.as_str()))
        .map(|(name, schema)| (name.clone(), schema.clone()))
        .collect();
    match schemas.get(message) {
        Some(schema) => output.print(schema, &format!("{schema:#}")),
        None if !of_verb.is_empty() => {
            let text = serde_json::to_string_pretty(&of_verb).unwrap_or_default();
            output.print(&of_verb, &text)
        }
        None => {
            let there = schemas.into_keys().chain([SCHEMA.to_owned()]);
            let there: Vec<String> = there.collect::<BTreeSet<_>>().into_iter().collect();
            let what = format!("message {message}");
            let failure = Failure::unknown(&what, message, &there, "jostle schema");
            Err(failure.with("message", message.as_str()))
        }
    }
}

/// The key of a message, if it has one, and its purpose.
fn purpose(message: &str) -> (String, String) {
    let is_its = |channel: &&Channel| match channel.kind {
        ChannelKind::Published(it)
        | ChannelKind::PublishedAndQueried(it)
        | ChannelKind::Put(it)
        | ChannelKind::Get(it) => it == message,
        ChannelKind::Command(verb) => verb.args == message || verb.reply == message,
        ChannelKind::Token | ChannelKind::ClientToken => false,
    };
    let what = match message {
        "attachment" => {
            "What a published state brings along: when its step was taken and when it was published."
        }
        "request" => "The envelope around the arguments of a command.",
        "error" => "The error reply to a request.",
        SCHEMA => "No message: the file of an experiment, for editors (draft-07).",
        "scheduled.reply" => "The reply to a scheduled command, one with `at_step`.",
        _ => "",
    };
    match CHANNELS.iter().find(is_its) {
        Some(channel) => (channel.key.into(), channel.doc.into()),
        None => (format::NONE.into(), what.into()),
    }
}

#[cfg(test)]
mod tests {
    use jostle_proto::contract;

    use super::*;

    #[test]
    fn every_message_has_a_purpose() {
        for message in contract::schemas().into_keys().chain([SCHEMA]) {
            let (key, purpose) = purpose(message);
            assert!(!key.is_empty() && !purpose.is_empty(), "{message}");
        }
    }
}
