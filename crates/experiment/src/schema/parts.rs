//! Parts of the JSON Schema of an experiment's file.

use serde_json::{Map, Value, json};

/// Schemas by key.
pub type Schemas = Map<String, Value>;

/// Returns the schema of a table with these keys and no others.
pub fn table(properties: &Schemas, required: &[&str]) -> Value {
    let mut schema = json!({
        "type": "object",
        "properties": properties,
        "additionalProperties": false,
    });
    if !required.is_empty() {
        schema["required"] = json!(required);
    }
    schema
}

/// Returns a schema with a description. In draft-07 nothing stands beside a reference.
pub fn described(doc: &str, schema: Value) -> Value {
    let mut schema = match schema["$ref"].is_null() {
        true => schema,
        false => json!({"allOf": [schema]}),
    };
    schema["description"] = json!(doc.trim());
    schema
}

/// Returns a reference to a definition of the schema.
pub fn reference(name: &str) -> Value {
    json!({"$ref": format!("#/definitions/{name}")})
}

/// Returns the schema of a whole number in a range.
pub fn whole([min, max]: [u64; 2]) -> Value {
    json!({"type": "integer", "minimum": min, "maximum": max})
}

/// Returns a schema for each of these keys, of what has it.
pub fn has(keys: impl Iterator<Item = &'static str>) -> Value {
    keys.map(|key| json!({"required": [key]})).collect()
}

/// Returns the schema of a list.
pub fn list(items: &Value) -> Value {
    json!({"type": "array", "items": items})
}
