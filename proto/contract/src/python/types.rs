//! The types of Python for the schemas of values.

use serde_json::Value;

use super::tables::{TYPES, class_of};

/// The Python type of what a schema describes.
pub fn kind(schema: &Value) -> String {
    if let Some(place) = schema["$ref"].as_str() {
        let name = name_of(place);
        let kind = TYPES
            .iter()
            .find(|(it, _)| *it == name)
            .map(|(_, kind)| *kind);
        return kind.unwrap_or_else(|| class_of(name, "").0).to_owned();
    }
    if let Some(variants) = schema["anyOf"].as_array() {
        return variants.iter().map(kind).collect::<Vec<_>>().join(" | ");
    }
    match &schema["type"] {
        Value::Array(kinds) => kinds
            .iter()
            .map(|it| one(it, schema))
            .collect::<Vec<_>>()
            .join(" | "),
        kind => one(kind, schema),
    }
}

/// The Python type of the values of one kind.
fn one(of: &Value, schema: &Value) -> String {
    let items = || kind(&schema["items"]);
    let kind = match of.as_str() {
        Some("integer") => "int",
        Some("number") => "float",
        Some("string") => "str",
        Some("boolean") => "bool",
        Some("null") => "None",
        Some("array") => match (schema["minItems"].as_u64(), schema["maxItems"].as_u64()) {
            (Some(2), Some(2)) => return format!("tuple[{0}, {0}]", items()),
            _ => return format!("list[{}]", items()),
        },
        Some("object") => match &schema["additionalProperties"] {
            Value::Object(_) => {
                return format!("dict[str, {}]", kind(&schema["additionalProperties"]));
            }
            _ => "dict[str, Any]",
        },
        _ => "Any",
    };
    kind.to_owned()
}

/// A default in Python.
pub fn literal(kind: &str, value: &Value) -> String {
    match value {
        Value::Bool(true) => "True".to_owned(),
        Value::Bool(false) => "False".to_owned(),
        Value::Object(_) if kind.starts_with("dict") => {
            let value = value.to_string().replace(':', ": ");
            format!("msgspec.field(default_factory=lambda: {value})")
        }
        // The first variant, with its own defaults.
        Value::Object(_) => format!("{}()", kind.split(' ').next().unwrap_or_default()),
        value => value.to_string(),
    }
}

/// Collects the types that a schema refers to.
pub fn references<'a>(schema: &'a Value, found: &mut Vec<&'a str>) {
    found.extend(schema["$ref"].as_str().map(name_of));
    for variant in schema["anyOf"].as_array().into_iter().flatten() {
        references(variant, found);
    }
    if schema["items"].is_object() {
        references(&schema["items"], found);
    }
}

/// The name of the type that a reference stands for.
pub fn name_of(place: &str) -> &str {
    place.trim_start_matches("#/$defs/")
}

/// A text; empty if there is none.
pub fn text(value: &Value) -> &str {
    value.as_str().unwrap_or_default()
}

/// Whether a list contains a name.
pub fn has(names: &Value, name: &str) -> bool {
    names
        .as_array()
        .is_some_and(|names| names.iter().any(|it| it == name))
}

/// The type within an envelope, if the field is one.
pub fn within<'a>(name: &str, schema: &'a Value) -> Option<&'a str> {
    let place = schema["$ref"]
        .as_str()
        .filter(|_| matches!(name, "result" | "event"));
    place.map(name_of)
}

/// What a field means, with its unit.
pub fn doc(schema: &Value) -> String {
    let text = text(&schema["description"]);
    let unit = schema["x-unit"].as_str().unwrap_or("1");
    let counted = unit.split(" /").next().unwrap_or_default();
    match unit == "1" || text.to_lowercase().contains(counted) {
        true => text.to_owned(),
        false => format!("{text} In {unit}."),
    }
}
