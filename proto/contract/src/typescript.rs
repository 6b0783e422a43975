//! The types of the messages in TypeScript.

use serde_json::{Map, Value};

/// Types whose names TypeScript or the DOM has already.
const RENAMED: [(&str, &str); 3] = [
    ("Error", "ErrorBody"),
    ("Event", "EventMessage"),
    ("Request", "CommandRequest"),
];

/// Every type of a document of `schema/`, in the order of their names; `title` says what they are.
pub fn types(document: &Value, title: &str) -> String {
    let mut text = format!(
        "// Written by `cargo run --release -p jostle-contract`; not by hand.\n\n/** {title} */\n"
    );
    let definitions = document["$defs"].as_object().into_iter().flatten();
    let mut envelopes: Vec<&str> = Vec::new();
    for (name, schema) in definitions {
        let Some(envelope) = envelope(name) else {
            text += &declaration(name_of(name), schema);
            continue;
        };
        // All envelopes of a kind differ in their results alone.
        if !envelopes.contains(&envelope) {
            envelopes.push(envelope);
            let mut schema = schema.clone();
            schema["properties"]["result"]["$ref"] = Value::from("#/$defs/T");
            text += &declaration(&format!("{envelope}<T>"), &schema);
        }
    }
    text
}

/// The generic type of a reply, if this is one.
fn envelope(name: &str) -> Option<&'static str> {
    let result = name.strip_suffix("Reply")?;
    Some(match result.starts_with("Node") {
        true => "NodeReply",
        false => "Reply",
    })
}

fn name_of(definition: &str) -> &str {
    let mut renamed = RENAMED.iter();
    let renamed = renamed.find(|(name, _)| *name == definition);
    renamed.map_or(definition, |(_, name)| name)
}

fn declaration(name: &str, schema: &Value) -> String {
    let doc = doc(schema, "");
    match schema["properties"].as_object() {
        Some(fields) if schema["oneOf"].is_null() => {
            format!(
                "\n{doc}export interface {name} {}\n",
                object(fields, schema, "")
            )
        }
        _ => format!("\n{doc}export type {name} = {};\n", expression(schema, "")),
    }
}

fn object(fields: &Map<String, Value>, schema: &Value, indent: &str) -> String {
    let required: Vec<&str> = schema["required"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(Value::as_str)
        .collect();
    let inner = format!("{indent}  ");
    let mut text = "{\n".to_owned();
    for (name, field) in fields {
        // What has a default is left out by earlier versions.
        let is_there = required.contains(&name.as_str()) && field.get("default").is_none();
        let mark = if is_there { "" } else { "?" };
        text += &doc(field, &inner);
        text += &format!("{inner}{name}{mark}: {};\n", expression(field, &inner));
    }
    text + indent + "}"
}

/// The type that a schema describes.
fn expression(schema: &Value, indent: &str) -> String {
    if let Some(place) = schema["$ref"].as_str() {
        return name_of(place.trim_start_matches("#/$defs/")).to_owned();
    }
    if let Some(constant) = schema.get("const") {
        return constant.to_string();
    }
    if let Some(words) = schema["enum"].as_array() {
        return union(words.iter().map(Value::to_string));
    }
    for kind in ["oneOf", "anyOf"] {
        if let Some(variants) = schema[kind].as_array() {
            return union(variants.iter().map(|it| expression(it, indent)));
        }
    }
    match &schema["type"] {
        Value::Array(kinds) => union(kinds.iter().map(|kind| one(kind, schema, indent))),
        kind => one(kind, schema, indent),
    }
}

/// The type of the values of one kind.
fn one(kind: &Value, schema: &Value, indent: &str) -> String {
    match kind.as_str() {
        Some("integer" | "number") => "number".to_owned(),
        Some(kind @ ("string" | "boolean" | "null")) => kind.to_owned(),
        Some("array") => {
            let item = match &schema["items"] {
                Value::Object(_) => expression(&schema["items"], indent),
                _ => "unknown".to_owned(),
            };
            match (schema["minItems"].as_u64(), schema["maxItems"].as_u64()) {
                (Some(least), Some(most)) if least == most => {
                    format!(
                        "[{}]",
                        vec![item.as_str(); usize::try_from(least).unwrap_or(0)].join(", ")
                    )
                }
                _ if item.contains([' ', '|']) => format!("({item})[]"),
                _ => format!("{item}[]"),
            }
        }
        Some("object") => match (
            schema["properties"].as_object(),
            &schema["additionalProperties"],
        ) {
            (Some(fields), _) => object(fields, schema, indent),
            (None, Value::Object(_)) => {
                let value = expression(&schema["additionalProperties"], indent);
                format!("Record<string, {value}>")
            }
            (None, Value::Bool(false)) => "Record<string, never>".to_owned(),
            (None, _) => "Record<string, unknown>".to_owned(),
        },
        _ => "unknown".to_owned(),
    }
}

fn union(types: impl Iterator<Item = String>) -> String {
    types.collect::<Vec<_>>().join(" | ")
}

fn doc(schema: &Value, indent: &str) -> String {
    match schema["description"].as_str() {
        Some(text) => format!("{indent}/** {} */\n", text.replace("\n\n", " ")),
        None => String::new(),
    }
}
