//! Compares JSON with the schema of a type, where serde is too lenient or too strict.
//!
//! A type of which clients send values rejects unknown fields. In a reply the same type must accept
//! those of a newer daemon: [`Lenient`] removes them. In a request, serde reads a list as an object
//! whose fields are in order: [`check_types`] rejects it.

use std::any::TypeId;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::de::{DeserializeOwned, Error as _};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::Value;

use crate::error::{RequestError, below};
use crate::schema::{has_type, received};

/// Arguments of a verb.
pub trait Arguments: DeserializeOwned + JsonSchema + 'static {}

impl<T: DeserializeOwned + JsonSchema + 'static> Arguments for T {}

/// A type of which a request rejects unknown fields, in a reply.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Lenient<T>(
    #[serde(deserialize_with = "lenient", bound(deserialize = "T: Arguments"))] pub T,
);

impl<T: JsonSchema> JsonSchema for Lenient<T> {
    fn schema_name() -> Cow<'static, str> {
        T::schema_name()
    }

    fn schema_id() -> Cow<'static, str> {
        T::schema_id()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        T::json_schema(generator)
    }
}

/// Deserializes a `T` without the fields that its schema does not have.
pub(crate) fn lenient<'de, D: Deserializer<'de>, T: Arguments>(
    deserializer: D,
) -> Result<T, D::Error> {
    let mut value = Value::deserialize(deserializer)?;
    let schema = schema::<T>();
    remove_unknown(&mut value, schema, schema);
    T::deserialize(value).map_err(D::Error::custom)
}

/// Checks that there is no list in place of an object in the arguments, and no object in place of
/// text.
pub(crate) fn check_types<T: Arguments>(args: &Value) -> Result<(), RequestError> {
    let schema = schema::<T>();
    check(args, schema, schema, "")
}

/// Returns the schema of `T`. Generating one takes longer than reading a request, so each is kept.
fn schema<T: Arguments>() -> &'static Value {
    static SCHEMAS: Mutex<BTreeMap<TypeId, &'static Value>> = Mutex::new(BTreeMap::new());
    let mut schemas = SCHEMAS.lock().unwrap_or_else(PoisonError::into_inner);
    schemas
        .entry(TypeId::of::<T>())
        .or_insert_with(|| Box::leak(Box::new(received::<T>().to_value())))
}

fn remove_unknown(value: &mut Value, schema: &Value, root: &Value) {
    let schema = resolve(schema, root, value);
    if let (Value::Object(fields), Value::Object(known)) = (value, &schema["properties"]) {
        fields.retain(|name, _| known.contains_key(name));
        for (name, field) in fields {
            remove_unknown(field, &known[name], root);
        }
    }
}

fn check(value: &Value, schema: &Value, root: &Value, path: &str) -> Result<(), RequestError> {
    let schema = resolve(schema, root, value);
    match value {
        Value::Array(_) if has_type(schema, "object") => Err(RequestError::new(
            path,
            "is a list where an object with named fields belongs",
        )),
        Value::Object(_) if has_type(schema, "string") => {
            Err(RequestError::new(path, "is an object where a word belongs"))
        }
        // A column of numbers can be long, and has no lists or objects.
        Value::Array(items) => items
            .iter()
            .enumerate()
            .filter(|(_, item)| item.is_array() || item.is_object())
            .try_for_each(|(i, item)| check(item, &schema["items"], root, &format!("{path}[{i}]"))),
        Value::Object(fields) => fields.iter().try_for_each(|(name, field)| {
            check(field, &schema["properties"][name], root, &below(path, name))
        }),
        _ => Ok(()),
    }
}

/// Follows references, and chooses the variant of an enum: the one that `value` is of, else the
/// first, since all have one type.
fn resolve<'a>(schema: &'a Value, root: &'a Value, value: &Value) -> &'a Value {
    if let Some(name) = schema["$ref"].as_str() {
        let definition = &root["$defs"][name.trim_start_matches("#/$defs/")];
        return resolve(definition, root, value);
    }
    let mut kinds = ["oneOf", "anyOf"].into_iter();
    match kinds.find_map(|kind| schema[kind].as_array()) {
        Some(variants) => {
            let variant = variants.iter().find(|variant| is_of(variant, value));
            resolve(variant.unwrap_or(&variants[0]), root, value)
        }
        None => schema,
    }
}

/// Whether `value` has the tag of this variant, or else its only field.
fn is_of(variant: &Value, value: &Value) -> bool {
    let fields = variant["properties"].as_object().into_iter().flatten();
    let mut tags = fields
        .clone()
        .filter(|(_, field)| field.get("const").is_some());
    match tags.next() {
        Some((tag, field)) => value.get(tag) == field.get("const"),
        None => fields
            .map(|(name, _)| name)
            .any(|name| value.get(name).is_some()),
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use serde_json::json;

    use super::*;
    use crate::{Spec, Start};

    #[test]
    fn unknown_fields_of_a_spec_are_removed_from_a_reply_and_rejected_in_a_request() {
        let more = json!({
            "n": 2, "weather": "fine", "attraction": {"kind": "all", "reach": 3},
            "start": {"kind": "given", "x": [0, 9], "y": [0, 9], "alpha": [0, 1], "z": [1, 1]},
        });
        assert!(serde_json::from_value::<Spec>(more.clone()).is_err());
        let Lenient(spec) = serde_json::from_value::<Lenient<Spec>>(more).unwrap();
        let start = Start::Given {
            x: vec![0.0, 9.0],
            y: vec![0.0, 9.0],
            alpha: vec![0.0, 1.0],
        };
        assert_eq!(
            spec,
            Spec {
                start,
                ..Spec::new(2)
            }
        );
    }

    #[test]
    fn invalid_fields_of_a_reply_are_rejected() {
        for wrong in [json!({"n": "two"}), json!({"weather": 1}), json!([])] {
            assert!(serde_json::from_value::<Lenient<Spec>>(wrong).is_err());
        }
    }
}
