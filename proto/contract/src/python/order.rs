//! The order of the fields of each type, which schemas do not have.

use std::collections::BTreeMap;

use jostle_proto::contract::{definition, schemas};
use serde_json::Value;
use serde_json::value::RawValue;

use crate::{fixtures, rewrite};

/// The fields of each type of a document, in the order in which the type writes them.
pub struct Order<'a> {
    definitions: &'a Value,
    fields: BTreeMap<String, Vec<String>>,
}

impl<'a> Order<'a> {
    /// The order in the fixtures, as their types write them. Fields that no fixture has together are in
    /// the order of the fixtures.
    ///
    /// # Errors
    /// A fixture cannot be read, or none has some field.
    pub fn of(definitions: &'a Value, file: &str) -> std::io::Result<Self> {
        let mut order = Order {
            definitions,
            fields: BTreeMap::new(),
        };
        let schemas = schemas();
        for (message, _, text) in fixtures()? {
            let (of, name) = definition(message, &schemas[message]);
            if of == file {
                let text = rewrite(message, &text).map_err(std::io::Error::other)?;
                order.walk(&name, &definitions[&name], &text);
            }
        }
        let unknown = order.unknown();
        match unknown.is_empty() {
            true => Ok(order),
            false => Err(std::io::Error::other(format!(
                "no fixture has {}: `JOSTLE_RECORD=1 cargo test --release --test daemon recorded` first, \
                 or add one to proto/fixtures",
                unknown.join(", ")
            ))),
        }
    }

    /// The fields that no fixture has, of the types that some fixture has.
    fn unknown(&self) -> Vec<String> {
        let mut unknown = Vec::new();
        for (name, known) in &self.fields {
            let all = self.definitions[name]["properties"].as_object();
            let all = all.into_iter().flatten().map(|(field, _)| field);
            let missing = all.filter(|field| !known.contains(field));
            unknown.extend(missing.map(|field| format!("{name}.{field}")));
        }
        unknown
    }

    /// The fields of a type.
    pub fn fields(&self, name: &str) -> &[String] {
        self.fields.get(name).map_or(&[], Vec::as_slice)
    }

    /// Collects the fields of `text`, which is a value of the type `name` or within it.
    fn walk(&mut self, name: &str, schema: &'a Value, text: &str) {
        if let Some(place) = schema["$ref"].as_str() {
            let name = place.trim_start_matches("#/$defs/");
            return self.walk(name, &self.definitions[name], text);
        }
        for kind in ["anyOf", "oneOf"] {
            for variant in schema[kind].as_array().into_iter().flatten() {
                self.walk(name, variant, text);
            }
        }
        if let Ok(items) = serde_json::from_str::<Vec<&RawValue>>(text) {
            for item in items {
                self.walk(name, &schema["items"], item.get());
            }
        } else if let Ok(fields) = serde_json::from_str::<BTreeMap<String, &RawValue>>(text) {
            let mut fields: Vec<_> = fields.into_iter().collect();
            fields.retain(|(field, _)| schema["properties"].get(field).is_some());
            // In the order of the text.
            fields.sort_by_key(|(_, value)| value.get().as_ptr());
            let names: Vec<&str> = fields.iter().map(|(field, _)| field.as_str()).collect();
            self.merge(name, &names);
            for (field, value) in fields {
                self.walk(name, &schema["properties"][&field], value.get());
            }
        }
    }

    fn merge(&mut self, name: &str, fields: &[&str]) {
        let known = self.fields.entry(name.to_owned()).or_default();
        for (i, field) in fields.iter().enumerate() {
            if !known.iter().any(|it| it == field) {
                let later = known
                    .iter()
                    .position(|it| fields[i..].contains(&it.as_str()));
                known.insert(later.unwrap_or(known.len()), (*field).to_owned());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_field_that_no_fixture_has_is_named() {
        let definitions = json!({
            "Seen": {"properties": {"a": {}, "b": {}}},
            "Unseen": {"properties": {"c": {}}},
        });
        let mut order = Order {
            definitions: &definitions,
            fields: BTreeMap::new(),
        };
        order.walk("Seen", &definitions["Seen"], r#"{"a": 1}"#);
        assert_eq!(order.unknown(), ["Seen.b"]);
        order.walk("Seen", &definitions["Seen"], r#"{"b": 2}"#);
        assert!(order.unknown().is_empty());
    }
}
