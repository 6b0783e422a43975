//! The JSON Schema of a type, as a daemon receives or sends it.

use schemars::generate::SchemaSettings;
use schemars::transform::{RecursiveTransform, Transform};
use schemars::{JsonSchema, Schema};
use serde_json::Value;

/// Returns the schema of what a daemon receives. Unknown fields are rejected; a field that has a
/// default is optional.
pub(crate) fn received<T: JsonSchema>() -> Schema {
    schema::<T>(SchemaSettings::draft2020_12().for_deserialize())
}

/// Returns the schema of what a daemon sends. A reader accepts unknown fields, since a newer daemon
/// may send more.
pub(crate) fn sent<T: JsonSchema>() -> Schema {
    let mut schema = schema::<T>(SchemaSettings::draft2020_12().for_serialize());
    RecursiveTransform(|schema: &mut Schema| {
        if schema.get("additionalProperties") == Some(&Value::Bool(false)) {
            schema.remove("additionalProperties");
        }
    })
    .transform(&mut schema);
    schema
}

fn schema<T: JsonSchema>(settings: SchemaSettings) -> Schema {
    let mut schema = settings.into_generator().into_root_schema_for::<T>();
    RecursiveTransform(unwrap_description).transform(&mut schema);
    schema
}

/// Removes the line breaks within the paragraphs of a description, which come from doc comments.
fn unwrap_description(schema: &mut Schema) {
    if let Some(Value::String(text)) = schema.get_mut("description") {
        let paragraphs = text.split("\n\n").map(|it| it.replace('\n', " "));
        *text = paragraphs.collect::<Vec<_>>().join("\n\n");
    }
}

/// Whether `schema` allows values of this type.
pub(crate) fn has_type(schema: &Value, kind: &str) -> bool {
    match &schema["type"] {
        Value::Array(types) => types.iter().any(|it| it == kind),
        one => one == kind,
    }
}
