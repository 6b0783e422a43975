//! Descriptions of the valid values of fields, for errors.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use jostle_proto::contract::{is_received, schemas};
use serde_json::Value;

/// Descriptions of fields that no bound in a schema describes: objects, parameters of selectors,
/// and ranges that depend on the daemon or on other fields.
const DESCRIPTIONS: &[(&str, &str)] = &[
    ("n", "a whole number from 1 to the daemon's max_individuals"),
    (
        "dt",
        "a number above 0, at most 2r / (1 + h ω): 0.02 fits most swarms",
    ),
    ("relinearise", "0 or 1"),
    (
        "attraction",
        "{\"kind\": \"all\"}, optionally with \"accuracy\"; or of kind \"voronoi\", \"metric\" \
         with \"radius\", \"topological\" with \"neighbours\", \"power\" with \"exponent\"",
    ),
    (
        "start",
        "{\"kind\": \"disc\"} or {\"kind\": \"given\", \"x\", \"y\", \"alpha\"}",
    ),
    (
        "rate",
        "a number above 0, at most 1e6, or null for as fast as possible",
    ),
    (
        "max_idle_secs",
        "0 for no limit, or a number from 0.1 to 1e6",
    ),
    ("bytes", "base64 of a piece of the file"),
    ("offset", "a whole number of bytes"),
    ("length", "a whole number of bytes"),
    (
        "snapshot",
        "the `result` of get/snapshot, its CBOR in base64",
    ),
    (
        "select",
        "one of {\"ids\": […]}, {\"count\": 5}, {\"fraction\": 0.1}, \
         {\"within\": {\"x\", \"y\", \"radius\"}}, {\"informed\": true}, {\"foremost\": {\"count\", \"along\"}}",
    ),
    ("ids", "a list of ids of individuals in the swarm"),
    ("count", "a whole number of individuals"),
    ("x", "a number from -1e6 to 1e6"),
    ("y", "a number from -1e6 to 1e6"),
    (
        "set",
        "{\"ids\": […], \"direction\": […]}, optionally with \"weight\": […]",
    ),
    ("step", "a whole number, 0 or more"),
    ("after", "a whole number, 0 or more"),
    (
        "commands",
        "a list of 1 to 256 of {\"verb\": \"set\" | \"inform\" | \"uninform\" | \"inject\" | \
         \"remove\", \"args\": {…}}",
    ),
    (
        "condition",
        "a comparison of a measure with a number, such as \"order > 0.9 for 20\"; several are joined \
         by `and` and `or`",
    ),
    ("pause", "true"),
    ("cancel", "true"),
    ("part", "a whole number, 0 or more"),
    ("phase", "paused, running or faulted"),
    ("begin.format", "\"mcap\""),
    ("format", "json or cbor"),
    (
        "request_id",
        "at most 256 bytes of text without control or bidirectional characters",
    ),
    (
        "client",
        "at most 256 bytes of text without control or bidirectional characters",
    ),
];

/// Descriptions made from the schemas of requests, by path and by name alone.
static RANGES: LazyLock<BTreeMap<String, String>> = LazyLock::new(|| {
    let mut ranges = BTreeMap::new();
    for (message, schema) in schemas() {
        if is_received(message) {
            let schema = schema.to_value();
            add_fields(&mut ranges, &schema, &schema, "");
        }
    }
    let by_name: Vec<_> = ranges
        .iter()
        .filter_map(|(path, range)| Some((path.rsplit_once('.')?.1.to_owned(), range.clone())))
        .collect();
    for (name, range) in by_name {
        ranges.entry(name).or_insert(range);
    }
    ranges
});

/// Returns a description of the valid values of a field. `field` may be a path with indices.
pub fn range_of(field: &str) -> Option<&'static str> {
    let parts = field.split('.');
    let names: Vec<&str> = parts.filter_map(|part| part.split('[').next()).collect();
    let path = names.join(".");
    let wanted = [path.as_str(), names.last()?];
    let described = |name: &&str| DESCRIPTIONS.iter().find(|(described, _)| described == name);
    match wanted.iter().find_map(described) {
        Some((_, description)) => Some(description),
        None => wanted
            .iter()
            .find_map(|it| RANGES.get(*it).map(String::as_str)),
    }
}

/// Adds the ranges of all fields in the value at `path`, which `schema` describes.
fn add_fields(ranges: &mut BTreeMap<String, String>, schema: &Value, root: &Value, path: &str) {
    for schema in alternatives(schema, root) {
        if !schema["items"].is_null() {
            add_fields(ranges, &schema["items"], root, path);
        }
        for (name, field) in schema["properties"].as_object().into_iter().flatten() {
            let dot = if path.is_empty() { "" } else { "." };
            let path = format!("{path}{dot}{name}");
            if let Some(range) = range(field, root) {
                ranges.entry(path.clone()).or_insert(range);
            }
            add_fields(ranges, field, root, &path);
        }
    }
}

/// Returns the variants of a schema that are not null, or itself.
fn alternatives<'a>(schema: &'a Value, root: &'a Value) -> Vec<&'a Value> {
    if let Some(name) = schema["$ref"].as_str() {
        let definition = &root["$defs"][name.trim_start_matches("#/$defs/")];
        return alternatives(definition, root);
    }
    let mut kinds = ["oneOf", "anyOf"].into_iter();
    match kinds.find_map(|kind| schema[kind].as_array()) {
        Some(variants) => {
            let variants = variants.iter().filter(|it| it["type"] != "null");
            variants.flat_map(|it| alternatives(it, root)).collect()
        }
        None => vec![schema],
    }
}

/// Returns the range of a field, or of the items of a list.
fn range(field: &Value, root: &Value) -> Option<String> {
    let alternatives = alternatives(field, root);
    // A single constant is the tag of a variant.
    if let [others @ .., last] = &alternatives[..]
        && !others.is_empty()
    {
        let constant = |it: &&Value| it.get("const").map(Value::to_string);
        let others: Option<Vec<_>> = others.iter().map(constant).collect();
        return Some(format!("{} or {}", others?.join(", "), constant(last)?));
    }
    let schema = alternatives.first()?;
    let types = schema["type"].to_string();
    let has = |kind: &str| types.contains(&format!("{kind:?}"));
    let bound = |name: &str| schema[name].as_f64().map(number);
    if has("array") {
        let null = schema["items"]["type"].to_string().contains("null");
        let range = range(&schema["items"], root)?;
        return Some(if null {
            format!("null, or {range}")
        } else {
            range
        });
    }
    if has("boolean") {
        return Some("true or false".to_owned());
    }
    if has("string") {
        return Some(schema["pattern"].as_str()?.to_owned());
    }
    let kind = match (has("integer"), has("number")) {
        (true, _) => "a whole number",
        (_, true) => "a number",
        _ => return None,
    };
    let limits = (
        bound("minimum"),
        bound("exclusiveMinimum"),
        bound("maximum"),
    );
    Some(match limits {
        (Some(least), _, Some(most)) => format!("{kind} from {least} to {most}"),
        (Some(least), _, None) if least == "0" => format!("{kind}, 0 or more"),
        (Some(least), _, None) => format!("{kind} from {least}"),
        (_, Some(bound), Some(most)) => format!("{kind} above {bound}, at most {most}"),
        _ => return None,
    })
}

/// Returns the shorter one of `1000000` and `1e6`.
fn number(number: f64) -> String {
    let (plain, exponent) = (format!("{number}"), format!("{number:e}"));
    if exponent.len() < plain.len() {
        exponent
    } else {
        plain
    }
}
