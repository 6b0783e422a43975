//! `schema`: the messages on the wire, as the daemon describes them.

use jostle_proto::contract::{CHANNELS, Channel, ChannelKind};
use jostle_proto::{NodeReply, Schemas};

use crate::arguments::SchemaArguments;
use crate::bus::Bus;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::table;

/// Prints the schema of a message, or which there are.
///
/// # Errors
///
/// Why there is none.
pub async fn schema(bus: &Bus, output: Output, arguments: &SchemaArguments) -> Result<(), Failure> {
    let answer = bus.get_node("schema").await?;
    let schemas = answer.read::<NodeReply<Schemas>>()?.result.schemas;
    let Some(message) = &arguments.message else {
        if output.json {
            return output.data(answer.json()?);
        }
        let (rows, docs): (Vec<_>, Vec<_>) = schemas
            .keys()
            .map(|message| {
                let (key, purpose) = purpose(message);
                ([message.clone(), key], purpose)
            })
            .unzip();
        return output.data(&table::documented(["message", "key"], rows, &docs));
    };
    match schemas.get(message) {
        Some(schema) if output.json => output.data(&schema.to_string()),
        Some(schema) => output.data(&format!("{schema:#}")),
        None => Err(Failure::NoMessage {
            message: message.clone(),
            there: schemas.into_keys().collect(),
        }),
    }
}

/// The key a message stands on, if it is one, and what it is for.
fn purpose(message: &str) -> (String, String) {
    let is_its = |channel: &&Channel| match channel.kind {
        ChannelKind::Published(it)
        | ChannelKind::Kept(it)
        | ChannelKind::Put(it)
        | ChannelKind::Get(it) => it == message,
        ChannelKind::Command(args, reply) => args == message || reply == message,
        ChannelKind::Token | ChannelKind::ClientToken => false,
    };
    let what = match message {
        "request" => "What may stand around the arguments of a command.",
        "error" => "Why something was refused or failed.",
        "scheduled.reply" => "The answer to a command that waits for its `at_step`.",
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
        for message in contract::schemas().keys() {
            let (key, purpose) = purpose(message);
            assert!(!key.is_empty() && !purpose.is_empty(), "{message}");
        }
    }
}
