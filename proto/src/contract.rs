//! The contract as data: what is on which key, and the JSON Schema of every message.
//!
//! Everything that describes the wire is made from here: the two documents in `schema/`, the AsyncAPI
//! document, and what a daemon answers on `get/schema`.

mod channels;
pub mod selectors;

use std::collections::{BTreeMap, BTreeSet};

use schemars::Schema;
use serde::Deserialize as _;
use serde_json::{Map, Value, json};

use crate::message::{REQUEST, SchemaOf};
use crate::schema::{has_type, received, sent};
use crate::{Parameter, ParameterKind, Spec, Usual};

pub use crate::message::{is_received, visit};
pub use crate::visitor::Visitor;
pub use channels::{CHANNELS, Channel, ChannelKind};

/// The names of all messages.
pub fn messages() -> BTreeSet<&'static str> {
    let mut messages = BTreeSet::from([REQUEST, "error", "scheduled.reply", "attachment"]);
    for channel in CHANNELS.iter() {
        match channel.kind {
            ChannelKind::Published(message)
            | ChannelKind::PublishedAndQueried(message)
            | ChannelKind::Put(message)
            | ChannelKind::Get(message) => {
                messages.insert(message);
            }
            ChannelKind::Command(verb) => messages.extend([verb.args, verb.reply]),
            ChannelKind::Token | ChannelKind::ClientToken => {}
        }
    }
    messages
}

/// The JSON Schema (2020-12) of every message, by name; each stands alone.
pub fn schemas() -> BTreeMap<&'static str, Schema> {
    let messages = messages().into_iter();
    messages
        .filter_map(|name| Some((name, schema(name)?)))
        .collect()
}

/// The JSON Schema (2020-12) of one message, which stands alone; `None` if there is no such message.
pub fn schema(message: &str) -> Option<Schema> {
    visit(message, SchemaOf)
}

/// The file in `schema/` with the definition of this message, and the definition's name.
pub fn definition(message: &str, schema: &Schema) -> (&'static str, String) {
    let document = match is_received(message) {
        true => "received.json",
        false => "sent.json",
    };
    let title = schema.get("title").and_then(Value::as_str);
    (document, title.unwrap_or_default().to_owned())
}

/// The files in `schema/`: one with each type that a daemon receives, one with each that it sends.
///
/// # Errors
/// Two types of one file have the same name.
pub fn documents() -> Result<BTreeMap<&'static str, Value>, String> {
    let mut documents = BTreeMap::new();
    for (message, schema) in schemas() {
        let (file, name) = definition(message, &schema);
        let mut root = schema;
        let dialect = root.remove("$schema");
        root.remove("title");
        let nested = match root.remove("$defs") {
            Some(Value::Object(nested)) => nested,
            _ => Map::new(),
        };
        let document = documents
            .entry(file)
            .or_insert_with(|| json!({"$schema": dialect, "$defs": {}}));
        for (name, definition) in nested.into_iter().chain([(name, root.to_value())]) {
            let there = &mut document["$defs"][&name];
            if !there.is_null() && *there != definition {
                return Err(format!("{message}: there is another type {name}"));
            }
            *there = definition;
        }
    }
    Ok(documents)
}

/// Every parameter of a spec but the start, in its order, as its schema describes it; `value` is
/// the default.
pub fn parameters() -> Vec<Parameter> {
    let schema = received::<Spec>();
    let given = serde_json::to_value(Spec::new(1)).unwrap_or_default();
    let sent = sent::<Spec>();
    // A reply has all of them, in the order of the fields.
    let names = sent.get("required").and_then(Value::as_array);
    let names = names.into_iter().flatten().filter_map(Value::as_str);
    names
        .filter(|name| *name != "start")
        .map(|name| {
            let schema = schema.as_value();
            let choices = choices(schema, &schema["properties"][name]);
            parameter(name, &schema["properties"][name], choices, &given[name])
        })
        .collect()
}

/// The values of a choice, each without its numbers; none if `property` is no choice.
fn choices(schema: &Value, property: &Value) -> Vec<Value> {
    let name = property["$ref"].as_str().unwrap_or_default();
    let definition = &schema["$defs"][name.trim_start_matches("#/$defs/")];
    let variants = definition["oneOf"].as_array().into_iter().flatten();
    variants
        .map(|variant| match &variant["properties"]["kind"]["const"] {
            Value::Null => variant["const"].clone(),
            kind => serde_json::json!({ "kind": kind }),
        })
        .collect()
}

/// The parameter that a property describes.
fn parameter(name: &str, property: &Value, choices: Vec<Value>, default: &Value) -> Parameter {
    let number = |key: &str| property[key].as_f64();
    let text = |key: &str| property[key].as_str().map(str::to_owned);
    let is = |kind| has_type(property, kind);
    let kind = match (is("integer"), is("number")) {
        (true, _) => ParameterKind::Integer,
        (_, true) => ParameterKind::Number,
        _ => ParameterKind::Choice,
    };
    let changed_by = property["x-changed-by"].as_array();
    let changed_by: Vec<String> = changed_by
        .into_iter()
        .flatten()
        .filter_map(|verb| verb.as_str().map(str::to_owned))
        .collect();
    Parameter {
        name: name.to_owned(),
        doc: text("description").unwrap_or_default(),
        unit: text("x-unit").unwrap_or_else(|| "1".to_owned()),
        kind,
        minimum: number("minimum"),
        exclusive_minimum: number("exclusiveMinimum"),
        maximum: number("maximum"),
        usual: Usual::deserialize(&property["x-usual"]).ok(),
        choices,
        nullable: is("null"),
        // How many individuals there are is the one thing that must be said.
        default: match name {
            "n" => Value::Null,
            _ => default.clone(),
        },
        value: default.clone(),
        live: !changed_by.is_empty(),
        changed_by,
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;
    use crate::keys;

    #[test]
    fn every_message_of_a_channel_has_a_type() {
        assert_eq!(schemas().into_keys().collect::<BTreeSet<_>>(), messages());
    }

    #[test]
    fn the_nouns_and_verbs_of_the_keys_are_those_of_the_channels() {
        let below = |start: &str| -> Vec<&str> {
            let keys = CHANNELS.iter().map(|channel| channel.key);
            keys.filter_map(|key| key.strip_prefix(start)).collect()
        };
        assert_eq!(below("{swarm}/get/"), keys::SWARM_GETS);
        assert_eq!(below("{swarm}/cmd/"), keys::SWARM_VERBS);
        assert_eq!(below("@node/{node}/get/"), keys::NODE_GETS);
        assert_eq!(below("@node/{node}/cmd/"), keys::NODE_VERBS);
        let of_experiments = below("@node/{node}/experiment/{experiment}/");
        assert_eq!(of_experiments, keys::EXPERIMENT_GETS);
    }

    #[test]
    fn no_two_channels_have_one_key() {
        let keys: BTreeSet<&str> = CHANNELS.iter().map(|channel| channel.key).collect();
        assert_eq!(keys.len(), CHANNELS.len());
    }

    #[test]
    fn what_is_asked_for_is_closed_and_what_is_told_is_open() {
        for (name, schema) in schemas() {
            let text = serde_json::to_string(&schema).unwrap();
            let is_closed = text.contains("\"additionalProperties\":false");
            assert_eq!(is_received(name), is_closed, "{name}");
        }
        // The details of an error may be anything, and its schema says so.
        let error = schemas().remove("error").unwrap().to_value();
        assert_eq!(error["properties"]["details"]["additionalProperties"], true);
    }

    /// The definitions that `part` refers to, with those that they refer to.
    fn needed(part: &Value, all: &Value, found: &mut Map<String, Value>) {
        match part {
            Value::Object(fields) => {
                if let Some(place) = fields.get("$ref").and_then(Value::as_str) {
                    let name = place.strip_prefix("#/$defs/").unwrap();
                    if !found.contains_key(name) {
                        found.insert(name.to_owned(), all[name].clone());
                        needed(&all[name], all, found);
                    }
                }
                for field in fields.values() {
                    needed(field, all, found);
                }
            }
            Value::Array(items) => items.iter().for_each(|it| needed(it, all, found)),
            _ => {}
        }
    }

    #[test]
    fn each_schema_is_its_definition_in_a_document_with_what_it_refers_to() {
        let documents = documents().unwrap();
        assert_eq!(
            documents.keys().collect::<Vec<_>>(),
            [&"received.json", &"sent.json"]
        );
        for (message, schema) in schemas() {
            let (file, name) = definition(message, &schema);
            let document = &documents[file];
            let mut rebuilt = document["$defs"][&name].clone();
            let mut nested = Map::new();
            needed(&rebuilt, &document["$defs"], &mut nested);
            rebuilt["$schema"] = document["$schema"].clone();
            rebuilt["title"] = json!(name);
            if !nested.is_empty() {
                rebuilt["$defs"] = nested.into();
            }
            assert_eq!(rebuilt, schema.to_value(), "{message}");
        }
    }

    #[test]
    fn every_parameter_has_a_range_a_unit_and_a_line_of_doc() {
        let parameters = parameters();
        let names: Vec<&str> = parameters.iter().map(|it| it.name.as_str()).collect();
        let written = serde_json::to_string(&Spec::new(1)).unwrap();
        let at = |name: &&str| written.find(&format!("\"{name}\":")).unwrap();
        assert!(names.is_sorted_by_key(at), "{names:?} of {written}");
        // How many individuals there are must be said.
        let default = |name: &str| {
            parameters
                .iter()
                .find(|it| it.name == name)
                .map(|it| &it.default)
        };
        assert_eq!(default("n"), Some(&Value::Null));
        assert_eq!(default("pi1"), Some(&serde_json::json!(Spec::new(1).pi1)));
        let of_kind = |kind: ParameterKind| -> Vec<&str> {
            let such = parameters.iter().filter(|it| it.kind == kind);
            such.map(|it| it.name.as_str()).collect()
        };
        assert_eq!(
            of_kind(ParameterKind::Integer),
            ["n", "relinearise", "seed", "publish_every"]
        );
        assert_eq!(
            of_kind(ParameterKind::Choice),
            ["contacts", "stepping", "attraction"]
        );
        for it in &parameters {
            assert!(!it.doc.is_empty() && !it.doc.contains('\n'), "{it:?}");
            assert!(!it.unit.is_empty(), "{it:?}");
            let is_bounded = it.minimum.or(it.exclusive_minimum).is_some();
            assert_eq!(is_bounded, it.kind != ParameterKind::Choice, "{it:?}");
            assert_eq!(it.choices.is_empty(), it.kind != ParameterKind::Choice);
            assert_eq!(it.live, !it.changed_by.is_empty(), "{it:?}");
            let verbs = it.changed_by.iter().map(String::as_str);
            for verb in verbs {
                assert!(keys::SWARM_VERBS.contains(&verb), "{it:?}");
            }
        }
    }
}
