//! Where in a request a value stands, and the range that it has there, for errors.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use jostle_proto::contract::selectors::QueryParameter;
use jostle_proto::contract::{CHANNELS, ChannelKind, is_received, schemas};
use jostle_proto::verbs::{OwnVerb, definition};
use serde_json::Value;

/// The envelope of requests.
const REQUEST: &str = "request";

/// Where a value stands.
#[derive(Clone, Debug, Default)]
pub struct Place {
    of: Of,
    /// The path to the part of the arguments that paths are relative to; empty for all of them.
    path: String,
}

#[derive(Clone, Copy, Debug, Default)]
enum Of {
    /// Not a request.
    #[default]
    Nothing,
    /// A command with arguments that this message describes.
    Command(&'static str),
    /// A query with these parameters.
    Query(&'static [QueryParameter]),
}

impl Place {
    /// The place of the arguments of a verb, also of one that a swarm executes by itself.
    pub fn of_verb(verb: &str) -> Self {
        let of_own = |verb| match verb {
            OwnVerb::Fired => "when.args",
            OwnVerb::Control => "control.args",
            OwnVerb::Deadline | OwnVerb::Lost | OwnVerb::Idle => "leave.args",
        };
        let args = definition(verb).map(|it| it.args);
        let args = args.or_else(|| OwnVerb::of(verb).map(of_own));
        Place::new(args.map_or(Of::Nothing, Of::Command))
    }

    /// The place of what a request on a key has.
    pub fn of_key(key: &str) -> Self {
        if let Some((_, verb)) = key.rsplit_once("/cmd/") {
            return Place::of_verb(verb);
        }
        let last = |key: &str| key.rsplit('/').next().map(str::to_owned);
        let mut channels = CHANNELS.iter().filter(|channel| {
            let is_command = matches!(channel.kind, ChannelKind::Command(_));
            !is_command && !channel.parameters.is_empty() && last(channel.key) == last(key)
        });
        Place::new(
            channels
                .next()
                .map_or(Of::Nothing, |it| Of::Query(it.parameters)),
        )
    }

    fn new(of: Of) -> Self {
        Place {
            of,
            path: String::new(),
        }
    }

    /// The place of a part of this one: `path` may have indices.
    #[must_use]
    pub fn within(&self, path: &str) -> Self {
        let dot = if self.path.is_empty() { "" } else { "." };
        Place {
            of: self.of,
            path: format!("{}{dot}{path}", self.path),
        }
    }

    /// Returns a description of the valid values of a field. `field` may be a path with indices.
    pub fn range(&self, field: &str) -> Option<&'static str> {
        let Place { path, .. } = self.within(field);
        match self.of {
            Of::Nothing => None,
            Of::Command(args) => {
                let of =
                    |message| Some(RANGES.get(message)?.get(&without_indices(&path))?.as_str());
                of(args).or_else(|| of(REQUEST))
            }
            Of::Query(parameters) => {
                let parameter = parameters.iter().find(|it| it.name == path)?;
                Some(parameter.range).filter(|range| !range.is_empty())
            }
        }
    }
}

/// Returns `a.b` of `a[2].b`.
fn without_indices(path: &str) -> String {
    let names = path.split('.').filter_map(|part| part.split('[').next());
    names.collect::<Vec<_>>().join(".")
}

/// The ranges of the fields of a message, by path without indices.
type Ranges = BTreeMap<String, String>;

/// The ranges of each message that a daemon receives.
static RANGES: LazyLock<BTreeMap<&'static str, Ranges>> = LazyLock::new(|| {
    let received = schemas().into_iter();
    let received = received.filter(|(message, _)| is_received(message));
    received
        .map(|(message, schema)| {
            let (schema, mut ranges) = (schema.to_value(), Ranges::new());
            add_fields(&mut ranges, &schema, &schema, "");
            (message, ranges)
        })
        .collect()
});

/// Adds the ranges of all fields in the value at `path`, which `schema` describes. Where variants have a
/// field in common, it is that of the first.
fn add_fields(ranges: &mut Ranges, schema: &Value, root: &Value, path: &str) {
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

/// Returns what a reference refers to, or the schema itself.
fn referred<'a>(schema: &'a Value, root: &'a Value) -> &'a Value {
    match schema["$ref"].as_str() {
        Some(name) => referred(&root["$defs"][name.trim_start_matches("#/$defs/")], root),
        None => schema,
    }
}

/// Returns the variants of a schema that are not null, or itself.
fn alternatives<'a>(schema: &'a Value, root: &'a Value) -> Vec<&'a Value> {
    let schema = referred(schema, root);
    let mut kinds = ["oneOf", "anyOf"].into_iter();
    match kinds.find_map(|kind| schema[kind].as_array()) {
        Some(variants) => {
            let variants = variants.iter().filter(|it| it["type"] != "null");
            variants.flat_map(|it| alternatives(it, root)).collect()
        }
        None => vec![schema],
    }
}

/// Returns the range of a field, or of the items of a list: what `x-range` says, else what the bounds say.
fn range(field: &Value, root: &Value) -> Option<String> {
    let said = |schema: &Value| schema["x-range"].as_str().map(str::to_owned);
    let variants = ["oneOf", "anyOf"].map(|kind| referred(field, root)[kind].as_array());
    let variants = variants.into_iter().flatten().flatten();
    if let Some(range) = said(field)
        .or_else(|| said(referred(field, root)))
        .or_else(|| variants.map(|it| referred(it, root)).find_map(said))
    {
        return Some(range);
    }
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
