//! The fixtures are complete: every variant, every constant and every field of every schema
//! is in one of them.

use std::collections::BTreeSet;

use jostle_proto::contract::{is_received, schemas};
use serde_json::{Value, json};

use jostle_contract::fixtures;

/// A schema, and the parts of it that fixtures have.
struct Walk<'a> {
    message: &'a str,
    definitions: &'a Value,
    seen: BTreeSet<String>,
}

impl<'a> Walk<'a> {
    fn of(message: &'a str, schema: &'a Value) -> Self {
        Walk {
            message,
            definitions: &schema["$defs"],
            seen: BTreeSet::new(),
        }
    }

    /// The schema behind a reference, and its name. A type is the same wherever it is
    /// used, but may differ between requests and messages of the daemon.
    fn resolve(&self, schema: &'a Value, place: &str) -> (&'a Value, String) {
        let direction = match is_received(self.message) {
            true => "request",
            false => "message",
        };
        match (schema["$ref"].as_str(), schema["title"].as_str()) {
            (Some(name), _) => {
                let name = name.trim_start_matches("#/$defs/");
                (&self.definitions[name], format!("{direction} {name}"))
            }
            (None, Some(title)) => (schema, format!("{direction} {title}")),
            (None, None) => (schema, place.to_owned()),
        }
    }

    /// Collects every part of a schema.
    fn all(&mut self, schema: &'a Value, place: &str) {
        let (schema, place) = self.resolve(schema, place);
        for (i, variant) in variants(schema).enumerate() {
            let variant_place = format!("{place} variant {}", name_of(variant, i));
            self.see(&variant_place);
            self.all(variant, &variant_place);
        }
        for constant in schema["enum"].as_array().into_iter().flatten() {
            self.see(&format!("{place} = {constant}"));
        }
        for (name, field) in schema["properties"].as_object().into_iter().flatten() {
            let field_place = format!("{place}.{name}");
            if self.see(&field_place) {
                self.all(field, &field_place);
            }
        }
        if schema["items"].is_object() {
            self.all(&schema["items"], &format!("{place}[]"));
        }
    }

    /// Collects the parts of the schema that `value` has.
    fn one(&mut self, schema: &'a Value, place: &str, value: &Value) {
        let (schema, place) = self.resolve(schema, place);
        for (i, variant) in variants(schema).enumerate() {
            if self.is_of(variant, value) {
                let variant_place = format!("{place} variant {}", name_of(variant, i));
                self.see(&variant_place);
                self.one(variant, &variant_place, value);
            }
        }
        for constant in schema["enum"].as_array().into_iter().flatten() {
            if constant == value {
                self.see(&format!("{place} = {constant}"));
            }
        }
        for (name, field) in schema["properties"].as_object().into_iter().flatten() {
            if let Some(value) = value.get(name) {
                let field_place = format!("{place}.{name}");
                self.see(&field_place);
                self.one(field, &field_place, value);
            }
        }
        if let (Value::Object(_), Some(values)) = (&schema["items"], value.as_array()) {
            for value in values {
                self.one(&schema["items"], &format!("{place}[]"), value);
            }
        }
    }

    fn see(&mut self, place: &str) -> bool {
        self.seen.insert(place.to_owned())
    }

    fn is_of(&self, variant: &Value, value: &Value) -> bool {
        let (variant, _) = self.resolve(variant, "");
        if !variant["const"].is_null() {
            return variant["const"] == *value;
        }
        let fields = variant["properties"].as_object().into_iter().flatten();
        let mut constants = fields.filter(|(_, field)| !field["const"].is_null());
        let mut required = variant["required"].as_array().into_iter().flatten();
        !value.is_null()
            && constants.all(|(name, field)| value[name] == field["const"])
            && required.all(|name| value.get(name.as_str().unwrap_or_default()).is_some())
    }
}

/// The variants of an enum; `null` is not a variant.
fn variants(schema: &Value) -> impl Iterator<Item = &Value> {
    let variants = ["oneOf", "anyOf"].into_iter();
    variants
        .flat_map(|kind| schema[kind].as_array().into_iter().flatten())
        .filter(|variant| variant["type"] != "null")
}

/// The name of a variant: its constant or its only field, or its number.
fn name_of(variant: &Value, number: usize) -> String {
    let properties = variant["properties"].as_object();
    let mut constants = properties.into_iter().flatten().map(|(_, it)| &it["const"]);
    let name = match (&variant["const"], &variant["required"][0]) {
        (Value::String(text), _) => Some(text),
        (_, Value::String(field)) => match constants.find(|it| it.is_string()) {
            Some(Value::String(text)) => Some(text),
            _ => Some(field),
        },
        _ => None,
    };
    name.cloned().unwrap_or_else(|| number.to_string())
}

#[test]
fn every_variant_and_field_of_every_schema_stands_in_a_fixture() {
    let fixtures = fixtures().unwrap();
    let (mut all, mut seen) = (BTreeSet::new(), BTreeSet::new());
    for (message, schema) in schemas() {
        let schema = schema.to_value();
        let mut walk = Walk::of(message, &schema);
        walk.all(&schema, message);
        all.append(&mut walk.seen);
        for (_, _, text) in fixtures.iter().filter(|(of, ..)| *of == message) {
            walk.one(&schema, message, &serde_json::from_str(text).unwrap());
        }
        seen.append(&mut walk.seen);
    }
    assert!(all.len() > 300, "{}", all.len());
    let unseen: Vec<&String> = all.difference(&seen).collect();
    assert!(unseen.is_empty(), "no fixture has {unseen:#?}");
}

#[test]
fn what_no_fixture_has_is_noticed() {
    let schema = json!({"properties": {"a": {"oneOf": [{"const": "x"}, {"const": "y"}]}, "b": {}}});
    let mut walk = Walk::of("message", &schema);
    walk.all(&schema, "message");
    let all = std::mem::take(&mut walk.seen);
    walk.one(&schema, "message", &json!({"a": "y"}));
    let unseen: Vec<&String> = all.difference(&walk.seen).collect();
    assert_eq!(unseen, ["message.a variant x", "message.b"]);
}
