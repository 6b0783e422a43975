//! The keys of an experiment's file: one row each, from which the parser's tables and the JSON Schema of
//! the file are made.

use serde_json::{Map, Value, json};

/// Schemas by key.
pub type Schemas = Map<String, Value>;

/// Makes a table of the file: a struct that serde reads, and the schemas of its keys. A row is a key:
///
/// ```text
/// /// What it is, with its unit.
/// #[schema(its schema)]
/// name: Type,
/// ```
macro_rules! keys {
    (
        $(#[$meta:meta])*
        pub struct $Table:ident {
            required { $(
                $(#[doc = $required_doc:literal])+
                #[schema($required_schema:expr)]
                $required:ident: $Required:ty,
            )* }
            optional { $(
                $(#[doc = $doc:literal])+
                #[schema($schema:expr)]
                $optional:ident: $Optional:ty,
            )* }
        }
    ) => {
        $(#[$meta])*
        #[serde(deny_unknown_fields)]
        pub struct $Table {
            $($(#[doc = $required_doc])+ pub $required: $Required,)*
            $($(#[doc = $doc])+ #[serde(default)] pub $optional: $Optional,)*
        }

        impl $Table {
            /// The schema of the table.
            pub fn schema() -> serde_json::Value {
                let properties = $crate::keys::Schemas::from_iter([
                    $((
                        stringify!($required).to_owned(),
                        $crate::keys::described(concat!($($required_doc),+), $required_schema),
                    ),)*
                    $((
                        stringify!($optional).to_owned(),
                        $crate::keys::described(concat!($($doc),+), $schema),
                    ),)*
                ]);
                let required: &[&str] = &[$(stringify!($required)),*];
                $crate::keys::table(&properties, required)
            }
        }
    };
}
pub(crate) use keys;

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
