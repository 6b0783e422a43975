//! The bounds in the schemas are those that the daemon enforces.

use std::collections::{BTreeMap, BTreeSet};

use jostle_proto::contract::schemas;
use jostle_proto::{Error, ErrorCode, keys};
use serde_json::{Value, json};

use super::fixtures;
use super::prepare::{prepare_experiment, prepare_recording, send};
use crate::support::{Daemon, PREFIX};

/// A field of a request with a value at one of its bounds and one just outside of it.
struct Bound {
    /// As an error names it.
    field: String,
    /// As JSON points to it.
    place: String,
    outside: Value,
    at: Value,
}

/// The bounds of `schema` for the fields of `value`.
fn bounds(schema: &Value, root: &Value, value: &Value, field: &str, place: &str) -> Vec<Bound> {
    if let Some(name) = schema["$ref"].as_str() {
        let definition = &root["$defs"][name.trim_start_matches("#/$defs/")];
        return bounds(definition, root, value, field, place);
    }
    let bound = |outside: Value, at: Value| Bound {
        field: field.to_owned(),
        place: place.to_owned(),
        outside,
        at,
    };
    let mut found = Vec::new();
    let types = schema["type"].to_string();
    if types.contains("\"integer\"") {
        let limit = |name: &str| schema[name].as_i64();
        found.extend(limit("minimum").map(|it| bound(json!(it - 1), json!(it))));
        found.extend(limit("maximum").map(|it| bound(json!(it + 1), json!(it))));
    } else if types.contains("\"number\"") {
        let limit = |name: &str| schema[name].as_f64();
        found.extend(limit("minimum").map(|it| bound(json!(it.next_down()), json!(it))));
        found.extend(limit("maximum").map(|it| bound(json!(it.next_up()), json!(it))));
        // A small number within the bound is large enough for a body to turn.
        found.extend(limit("exclusiveMinimum").map(|it| bound(json!(it), json!(it + 1e-6))));
    }
    if let Some(pattern) = schema["pattern"].as_str() {
        // There are two patterns: of names, and of labels, which permit almost all characters.
        let (outside, at) = match pattern {
            keys::NAME_RULE => ("a/b", "a".repeat(64)),
            _ => ("a\u{7}b", "ü \u{2020} *".to_owned()),
        };
        found.push(bound(json!(outside), json!(at)));
    }
    if let Some(longest) = schema["maxLength"].as_u64() {
        let text = |length: u64| json!("a".repeat(usize::try_from(length).unwrap()));
        found.push(bound(text(longest + 1), text(longest)));
    }
    if let Value::Array(items) = value {
        let many = |count: &Value| {
            let count = usize::try_from(count.as_u64().unwrap()).unwrap();
            match place.ends_with("/measures") {
                // They must differ.
                true => (1..=count)
                    .map(|gap| json!(format!("clusters.count(0.{gap:03})")))
                    .collect(),
                false => vec![items[0].clone(); count],
            }
        };
        if let least @ Value::Number(_) = &schema["minItems"] {
            found.push(bound(json!(many(least)[1..]), json!(many(least))));
        }
        if let most @ Value::Number(_) = &schema["maxItems"] {
            let mut more = many(most);
            more.push(items[0].clone());
            found.push(bound(json!(more), json!(many(most))));
        }
        // Of a list of numbers only the first is tested: ids must differ.
        let some = match items.first() {
            Some(Value::Number(_)) => &items[..1],
            _ => &items[..],
        };
        for (i, item) in some.iter().enumerate() {
            let (field, place) = (format!("{field}[{i}]"), format!("{place}/{i}"));
            found.extend(bounds(&schema["items"], root, item, &field, &place));
        }
    }
    for (name, property) in schema["properties"].as_object().into_iter().flatten() {
        let dot = if field.is_empty() { "" } else { "." };
        let (field, place) = (format!("{field}{dot}{name}"), format!("{place}/{name}"));
        if let Some(value) = value.get(name) {
            found.extend(bounds(property, root, value, &field, &place));
        }
    }
    for kind in ["oneOf", "anyOf"] {
        let variants = schema[kind].as_array().into_iter().flatten();
        for variant in variants.filter(|variant| is_meant(variant, value)) {
            found.extend(bounds(variant, root, value, field, place));
        }
    }
    found
}

/// Whether a value is of this variant: it has all fields, and the constants in them.
fn is_meant(variant: &Value, value: &Value) -> bool {
    let required = variant["required"].as_array().into_iter().flatten();
    let constants = variant["properties"].as_object().into_iter().flatten();
    required
        .map(|name| name.as_str().unwrap())
        .all(|name| value.get(name).is_some())
        && constants
            .filter_map(|(name, property)| Some((name, property.get("const")?)))
            .all(|(name, constant)| value.get(name) == Some(constant))
}

/// Whether an error says that this field is wrong.
fn is_about(error: &Error, field: &str) -> bool {
    // A column is rejected as a whole, and so is a change of a batch whose arguments precede
    // its verb.
    let column = field.strip_suffix(']').and_then(|it| it.rsplit_once('['));
    let change = field.split_once(".args").map(|(change, _)| change);
    let named = error.details.get("field").and_then(Value::as_str);
    error.code == ErrorCode::InvalidArgument
        && named.is_some()
        && [Some(field), column.map(|(column, _)| column), change].contains(&named)
}

/// An interval that the text of an error names, such as `(0, 1e6]`.
#[derive(Debug)]
struct Interval {
    least: f64,
    most: f64,
    has_least: bool,
    has_most: bool,
}

impl Interval {
    fn of(text: &str) -> Option<Self> {
        let (_, range) = text.split_once(" is outside ")?;
        let has_least = match range.chars().next()? {
            '[' => true,
            '(' => false,
            _ => return None,
        };
        let end = range.find([']', ')'])?;
        let (least, most) = range[1..end].split_once(", ")?;
        Some(Interval {
            least: least.parse().ok()?,
            most: most.parse().ok()?,
            has_least,
            has_most: range[end..].starts_with(']'),
        })
    }

    fn has(&self, value: f64) -> bool {
        let is_above = value > self.least || self.has_least && value == self.least;
        let is_below = value < self.most || self.has_most && value == self.most;
        is_above && is_below
    }
}

/// The intervals that the errors of a field name, and the values that it was given, each with whether it is
/// outside the bounds.
#[derive(Default)]
struct Tried {
    intervals: Vec<Interval>,
    values: Vec<(f64, bool)>,
}

/// The errors of requests whose value is within its bounds: the message, the field that is at a bound,
/// and what is wrong beside it. Every other such request must succeed.
const OTHER_ERRORS: [(&str, &str, ErrorCode); 31] = [
    // Names of things that do not exist.
    ("advance.args", "controller", ErrorCode::NotFound),
    ("leave.args", "controller", ErrorCode::NotFound),
    ("discard.args", "name", ErrorCode::NotFound),
    ("experiment.args", "cancel.name", ErrorCode::NotFound),
    ("experiment.args", "delete.name", ErrorCode::NotFound),
    ("experiment.args", "pause.name", ErrorCode::NotFound),
    ("experiment.args", "resume.name", ErrorCode::NotFound),
    ("record.args", "delete.recording", ErrorCode::NotFound),
    ("record.args", "begin.swarm", ErrorCode::NotFound),
    ("replay.args", "open.name", ErrorCode::NotFound),
    // Uploads of which the first piece is missing, or that are larger than the daemon accepts.
    ("replay.args", "upload.name", ErrorCode::Conflict),
    ("replay.args", "upload.length", ErrorCode::Conflict),
    ("replay.args", "upload.length", ErrorCode::ResourceExhausted),
    ("replay.args", "upload.offset", ErrorCode::Conflict),
    // More steps than are taken within the deadline, and a step that is not reached.
    ("advance.args", "steps", ErrorCode::DeadlineExceeded),
    ("step.args", "steps", ErrorCode::DeadlineExceeded),
    ("fork.args", "step", ErrorCode::Conflict),
    // A disc in which four bodies have no place.
    (
        "create.args",
        "spec.start.radius",
        ErrorCode::ResourceExhausted,
    ),
    // The swarm is not a playback.
    ("seek.args", "fraction", ErrorCode::IncorrectState),
    ("seek.args", "step", ErrorCode::IncorrectState),
    ("seek.args", "time", ErrorCode::IncorrectState),
    // A deadline that passes before the command is executed.
    ("request", "timeout_secs", ErrorCode::DeadlineExceeded),
    // The swarm is in epoch 1.
    ("request", "expect_epoch", ErrorCode::Conflict),
    // `dt` is too long for the largest weights and rates of turning, and itself for the default ones.
    ("advance.args", "set.weight[0]", ErrorCode::InvalidArgument),
    (
        "batch.args",
        "commands[0].args.pi3",
        ErrorCode::InvalidArgument,
    ),
    (
        "batch.args",
        "commands[2].args.weight",
        ErrorCode::InvalidArgument,
    ),
    ("create.args", "spec.dt", ErrorCode::InvalidArgument),
    ("create.args", "spec.pi3", ErrorCode::InvalidArgument),
    ("inform.args", "weight", ErrorCode::InvalidArgument),
    ("inject.args", "weight", ErrorCode::InvalidArgument),
    ("set.args", "pi3", ErrorCode::InvalidArgument),
];

/// Whether a request with a value within its bounds failed for a reason that is expected of it.
fn is_expected(message: &str, field: &str, error: &Error) -> bool {
    let named = error.details.get("field").and_then(Value::as_str);
    let is_about_dt = named.is_some_and(|named| named == "dt" || named.ends_with(".dt"));
    (error.code != ErrorCode::InvalidArgument || is_about_dt)
        && OTHER_ERRORS.contains(&(message, field, error.code))
}

#[tokio::test(flavor = "multi_thread")]
async fn the_bounds_of_the_schemas_are_those_of_the_daemon() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let (mut tried, mut wrong) = (BTreeSet::new(), Vec::new());
    let mut others: Vec<(&str, String, ErrorCode)> = Vec::new();
    let mut fields: BTreeMap<String, Tried> = BTreeMap::new();
    let schemas = schemas();
    let requests = schemas.iter().filter_map(|(message, schema)| {
        let verb = match *message {
            "request" => "inform",
            // A put gets no reply; `controllers` tests its effect.
            "control.args" => return None,
            message => message.strip_suffix(".args")?,
        };
        Some((*message, verb, schema.as_value()))
    });
    for (message, verb, schema) in requests {
        for (_, fixture) in fixtures(message) {
            for bound in bounds(schema, schema, &fixture, "", "") {
                let is_new = tried.insert(format!("{message} {} {}", bound.field, bound.outside));
                if !is_new {
                    continue;
                }
                let swarm = format!("s{}", tried.len());
                for (value, is_outside) in [(&bound.outside, true), (&bound.at, false)] {
                    let mut request = fixture.clone();
                    if message == "request" {
                        request["expect_step"] = json!(0);
                        request["request_id"] = json!(format!("{swarm}-{is_outside}"));
                    }
                    *request.pointer_mut(&bound.place).unwrap() = value.clone();
                    match message {
                        "record.args" => prepare_recording(client, &request).await,
                        "experiment.args" => prepare_experiment(client, &request).await,
                        _ => (),
                    }
                    if message != "request" {
                        // A verb that creates a swarm has a timeout for a busy disk, so that the name
                        // is free again for the next request; `advance` waits for its controllers.
                        let creates = ["create", "fork", "restore"].contains(&verb);
                        let timeout_secs = if creates { 20.0 } else { 0.5 };
                        request = json!({"timeout_secs": timeout_secs, "args": request});
                    }
                    let answer = send(client, &swarm, verb, &request).await;
                    let of_field = fields
                        .entry(format!("{message} {}", bound.field))
                        .or_default();
                    if let (true, Err(error)) = (is_outside, &answer) {
                        of_field.intervals.extend(Interval::of(&error.message));
                    }
                    of_field
                        .values
                        .extend(value.as_f64().map(|value| (value, is_outside)));
                    let is_right = match (&answer, is_outside) {
                        (Err(error), true) => is_about(error, &bound.field),
                        (Ok(_), true) => false,
                        (Err(error), false) => {
                            others.push((message, bound.field.clone(), error.code));
                            is_expected(message, &bound.field, error)
                        }
                        (Ok(_), false) => true,
                    };
                    if !is_right {
                        wrong.push(format!("{message} {} = {value}: {answer:?}", bound.field));
                    }
                    let named = request["args"]["name"].as_str();
                    let name = named.filter(|it| keys::is_name(it)).unwrap_or(&swarm);
                    // If nothing was created, no daemon replies.
                    client
                        .query_all(&keys::cmd(PREFIX, name, "delete"), None)
                        .await;
                    if verb == "fork" && name != swarm {
                        client.ok(&swarm, "delete", json!({})).await;
                    }
                }
            }
        }
    }
    let mut compared = 0;
    for (field, Tried { intervals, values }) in &fields {
        for (interval, (value, is_outside)) in intervals
            .iter()
            .flat_map(|it| values.iter().map(move |value| (it, value)))
        {
            if interval.has(*value) == *is_outside {
                wrong.push(format!("{field}: {value} and {interval:?}"));
            }
            compared += 1;
        }
    }
    assert!(compared > 20, "{compared}");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(tried.len() > 100, "{}", tried.len());
    for (message, field, code) in OTHER_ERRORS {
        let is_met = others.contains(&(message, field.to_owned(), code));
        assert!(is_met, "no {code:?} of {message} {field}: it succeeds");
    }
    println!("{} bounds hold", tried.len());
    daemon.stop().await;
}
