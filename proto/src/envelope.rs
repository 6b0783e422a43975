//! The envelopes of requests and replies.

use std::fmt;

use schemars::JsonSchema;
use serde::de::{DeserializeOwned, IgnoredAny, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::Value;
use serde_json::value::RawValue;

use crate::error::{RequestError, below};
use crate::walk::{Arguments, check_types};
use crate::{LARGEST_WHOLE, Phase};

/// An object with any of these fields is an envelope; no argument of a verb has these names.
const ENVELOPE_FIELDS: [&str; 7] = [
    "at_step",
    "request_id",
    "client",
    "expect_epoch",
    "expect_step",
    "timeout_secs",
    "args",
];

/// The longest `request_id` and `client`, in bytes.
pub const MAX_LABEL_LENGTH: usize = 256;

/// What they can be.
const LABEL_RANGE: &str = "at most 256 bytes of text without control or bidirectional characters";

/// The pattern of a `request_id`, a `client` and a note: the characters of [`is_plain`].
pub(crate) const PLAIN_TEXT_RULE: &str =
    "^[^\\u0000-\\u001f\\u007f-\\u009f\\u061c\\u200e-\\u200f\\u2028-\\u202e\\u2066-\\u2069]*$";

/// Whether a character is safe to print: it is no control character, ends no line and does not change the
/// direction of text.
pub fn is_plain(c: char) -> bool {
    let changes_direction = matches!(
        c,
        '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}'
    );
    !c.is_control() && !changes_direction && !matches!(c, '\u{2028}' | '\u{2029}')
}

/// A request; every field is optional.
#[derive(Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Request {
    /// The client's id for this request. A request is executed once for each `client` and
    /// `request_id`; a retry gets the first reply.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(
        length(max = MAX_LABEL_LENGTH),
        regex(pattern = PLAIN_TEXT_RULE),
        extend("x-range" = LABEL_RANGE)
    )]
    pub request_id: Option<String>,
    /// The client, as the request names it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(
        length(max = MAX_LABEL_LENGTH),
        regex(pattern = PLAIN_TEXT_RULE),
        extend("x-range" = LABEL_RANGE)
    )]
    pub client: Option<String>,
    /// Execute it when the swarm is at this step. One in the past is a `conflict`; one in the
    /// future is acknowledged at once with `applies_at_step`, and an event has its result.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(max = LARGEST_WHOLE))]
    pub at_step: Option<u64>,
    /// Reject with `conflict` unless the swarm is in this epoch.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expect_epoch: Option<u64>,
    /// Reject with `conflict` unless the swarm is at this step.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expect_step: Option<u64>,
    /// After this many seconds the reply is `deadline_exceeded`; the daemon continues with it.
    /// Above 0, at most 3600; 5 if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 3600.0))]
    pub timeout_secs: Option<f64>,
    /// The verb's arguments.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<serde_json::Map<String, Value>>")]
    pub args: Option<Box<RawValue>>,
}

impl Request {
    /// Parses the payload of a request: an envelope, the verb's arguments alone, or nothing.
    ///
    /// # Errors
    ///
    /// [`RequestError`] if it is not a JSON object, has a field twice, or is an envelope with an
    /// unknown field or one of a wrong type.
    pub fn from_json(payload: &[u8]) -> Result<Self, RequestError> {
        let text = std::str::from_utf8(payload)
            .map_err(|error| whole(&format!("the payload is not UTF-8: {error}")))?
            .trim();
        if text.is_empty() {
            return Ok(Request::default());
        }
        // A valid envelope is parsed once; anything else again, for the path of the error.
        if text.starts_with('{')
            && let Ok(request) = serde_json::from_str::<Request>(text)
            && request.has_fields()
        {
            return Ok(request);
        }
        let fields: FieldNames = serde_json::from_str(text)
            .map_err(|error| whole(&format!("the payload is not a JSON object: {error}")))?;
        if let Some(twice) = fields.twice {
            return Err(RequestError::new(&twice, "is given twice"));
        }
        if fields
            .names
            .iter()
            .any(|name| ENVELOPE_FIELDS.contains(&name.as_str()))
        {
            read(text).map_err(|mut error: RequestError| {
                if error.problem.starts_with("unknown field") {
                    error.problem += ": the verb's own arguments go into `args`";
                }
                error
            })
        } else {
            Ok(Request {
                args: Some(
                    RawValue::from_string(text.to_owned())
                        .map_err(|error| whole(&error.to_string()))?,
                ),
                ..Request::default()
            })
        }
    }

    /// Whether any field is set.
    fn has_fields(&self) -> bool {
        let Request {
            request_id,
            client,
            at_step,
            expect_epoch,
            expect_step,
            timeout_secs,
            args,
        } = self;
        let labels = request_id.is_some() || client.is_some();
        let steps = at_step.is_some() || expect_epoch.is_some() || expect_step.is_some();
        labels || steps || timeout_secs.is_some() || args.is_some()
    }

    /// Parses the verb's arguments.
    ///
    /// # Errors
    ///
    /// [`RequestError`] if a field is missing, unknown, given twice or of a wrong type.
    pub fn args<T: Arguments>(&self) -> Result<T, RequestError> {
        let args = self.args.as_deref().map_or("{}", RawValue::get);
        if !args.starts_with('{') {
            let problem = "is not an object with named fields";
            return Err(RequestError::new("args", problem));
        }
        let read_again = |_| {
            read(args).map_err(|mut error: RequestError| {
                if error.field.is_empty() {
                    error.field = "args".into();
                }
                error
            })
        };
        let parsed: T = serde_json::from_str(args).or_else(read_again)?;
        // serde has checked all types but those of lists and objects.
        if args[1..].contains(['{', '[']) {
            let given = serde_json::from_str(args).map_err(|error| whole(&error.to_string()))?;
            check_types::<T>(&given)?;
        }
        Ok(parsed)
    }
}

/// Reads JSON; an error names the field.
fn read<T: DeserializeOwned>(text: &str) -> Result<T, RequestError> {
    let mut deserializer = serde_json::Deserializer::from_str(text);
    let value = serde_path_to_error::deserialize(&mut deserializer).map_err(|error| {
        let path = error.path().to_string();
        let path = if path == "." { String::new() } else { path };
        let problem = without_position(&error.into_inner().to_string());
        // serde's path of a missing or duplicate field is that of the object.
        let named = ["missing field `", "duplicate field `"]
            .iter()
            .find_map(|start| problem.strip_prefix(start))
            .and_then(|rest| rest.strip_suffix('`'));
        let field = named.map_or(path.clone(), |name| below(&path, name));
        // Clients do not know the Rust types.
        let problem = match problem.split_once("expected ") {
            Some((given, "f64")) => format!("{given}expected a number"),
            Some((given, "u64" | "u32" | "u8")) => format!("{given}expected a whole number"),
            Some((given, kind))
                if kind.starts_with("struct ") || kind.starts_with("internally tagged enum ") =>
            {
                format!("{given}expected an object with named fields")
            }
            Some((_, "newtype variant" | "struct variant")) => "has no value".to_owned(),
            // A field beside the tag and the content of a variant.
            Some((_, known)) if problem.starts_with("invalid value: string") && is_field(known) => {
                format!("unknown field, expected {known}")
            }
            _ => problem,
        };
        RequestError::new(&field, &problem)
    })?;
    deserializer
        .end()
        .map_err(|error| whole(&error.to_string()))?;
    Ok(value)
}

/// Whether serde expected one of the two fields of a change.
fn is_field(known: &str) -> bool {
    known == "\"verb\" or \"args\""
}

/// Removes line and column: they are not those of the payload if it has an envelope.
fn without_position(problem: &str) -> String {
    let end = problem.rfind(" at line ").unwrap_or(problem.len());
    problem[..end].to_owned()
}

fn whole(problem: &str) -> RequestError {
    RequestError::new("", problem)
}

/// The names of an object's fields, and the first duplicate.
struct FieldNames {
    names: Vec<String>,
    twice: Option<String>,
}

impl<'de> Deserialize<'de> for FieldNames {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Names;
        impl<'de> Visitor<'de> for Names {
            type Value = FieldNames;

            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str("an object")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<FieldNames, A::Error> {
                let mut fields = FieldNames {
                    names: Vec::new(),
                    twice: None,
                };
                while let Some((name, IgnoredAny)) = map.next_entry::<String, IgnoredAny>()? {
                    // The first names suffice: an object of many has an unknown one.
                    if fields.twice.is_none() && fields.names.len() < 64 {
                        if fields.names.contains(&name) {
                            fields.twice = Some(name);
                        } else {
                            fields.names.push(name);
                        }
                    }
                }
                Ok(fields)
            }
        }
        deserializer.deserialize_map(Names)
    }
}

/// The reply of a swarm, and of the node that created one. The reply to a query on a swarm's
/// `state` is the state alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "{T}Reply")]
pub struct Reply<T> {
    /// The swarm's name.
    pub swarm: String,
    /// Increases when `step` does not continue what was published before.
    pub epoch: u64,
    /// The step at which the command took effect; for `step`, the step reached.
    pub step: u64,
    /// `step · dt`, body sizes over free speed.
    pub time: f64,
    /// The phase after the command.
    pub phase: Phase,
    /// Number of commands applied to the swarm.
    pub seq: u64,
    /// The result.
    pub result: T,
}

/// The reply of a node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "Node{T}Reply")]
pub struct NodeReply<T> {
    /// The daemon's name.
    pub node: String,
    /// The result.
    pub result: T,
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;
    use crate::verbs::{BatchArgs, CreateArgs, InformArgs, InjectArgs, RunArgs, SetArgs, StepArgs};

    #[test]
    fn arguments_alone_and_arguments_in_an_envelope_read_the_same() {
        let alone = Request::from_json(br#"{"steps": 3}"#).unwrap();
        let within = Request::from_json(br#"{"client": "me", "args": {"steps": 3}}"#).unwrap();
        let (alone, within) = (
            alone.args::<StepArgs>().unwrap(),
            within.args::<StepArgs>().unwrap(),
        );
        assert_eq!(alone, within);
        assert_eq!(alone.steps, 3);
    }

    #[test]
    fn nothing_at_all_is_a_request_without_arguments() {
        for payload in [&b""[..], b" \n", b"{}"] {
            let args: StepArgs = Request::from_json(payload).unwrap().args().unwrap();
            assert_eq!(args.steps, 1);
        }
    }

    #[test]
    fn a_rate_of_null_is_not_a_rate_left_out() {
        let read = |text: &str| {
            let request = Request::from_json(text.as_bytes()).unwrap();
            request.args::<RunArgs>().unwrap().rate
        };
        assert_eq!(read("{}"), None);
        assert_eq!(read(r#"{"rate": null}"#), Some(None));
        assert_eq!(read(r#"{"rate": 2}"#), Some(Some(2.0)));
    }

    #[test]
    fn a_wrong_field_is_named() {
        let error = |text: &str| {
            let request = Request::from_json(text.as_bytes());
            match request {
                Ok(request) => request.args::<StepArgs>().unwrap_err().field,
                Err(error) => error.field,
            }
        };
        assert_eq!(error(r#"{"steps": "three"}"#), "steps");
        assert_eq!(error(r#"{"steps": 1, "steps": 2}"#), "steps");
        assert_eq!(error(r#"{"client": 7}"#), "client");
        assert_eq!(error("[1]"), "");
    }

    #[test]
    fn a_field_that_a_change_of_a_batch_does_not_have_is_unknown() {
        let error = |change: &str| {
            let request = Request::from_json(format!(r#"{{"commands": [{change}]}}"#).as_bytes());
            request.unwrap().args::<BatchArgs>().unwrap_err().problem
        };
        let unknown = "unknown field, expected \"verb\" or \"args\"";
        assert_eq!(error(r#"{"verb": "set", "args": {}, "at": 1}"#), unknown);
        let other = error(r#"{"verb": "dance", "args": {}}"#);
        assert!(!other.starts_with("unknown field"), "{other}");
        let text = error(r#"{"verb": "inform", "args": {"select": "all", "direction": 1}}"#);
        assert!(!text.starts_with("unknown field"), "{text}");
    }

    #[test]
    fn a_problem_names_no_type_of_the_program() {
        let problem = |verb: &str, args: &str| {
            let request = Request::from_json(args.as_bytes()).unwrap();
            match verb {
                "set" => request.args::<SetArgs>().unwrap_err().problem,
                _ => request.args::<InformArgs>().unwrap_err().problem,
            }
        };
        for (verb, args) in [
            ("set", r#"{"relinearise": -1}"#),
            ("set", r#"{"relinearise": 256}"#),
            ("set", r#"{"relinearise": 1.0}"#),
            ("set", r#"{"publish_every": "often"}"#),
            ("set", r#"{"attraction": "all"}"#),
            ("set", r#"{"attraction": 3}"#),
            ("inform", r#"{"select": "informed", "direction": 0}"#),
            ("inform", r#"{"select": {"count": "all"}, "direction": 0}"#),
            ("inform", r#"{"select": {"within": 3}, "direction": 0}"#),
        ] {
            let text = problem(verb, args);
            for word in ["u8", "u32", "u64", "f64", "enum", "struct", "newtype"] {
                assert!(!text.contains(word), "{args}: {text}");
            }
        }
    }

    #[test]
    fn what_is_missing_is_named_and_what_is_long_is_cut() {
        let error = |text: &str| {
            let request = Request::from_json(text.as_bytes()).unwrap();
            request.args::<CreateArgs>().unwrap_err()
        };
        assert_eq!(error("{}").field, "name");
        assert_eq!(error(r#"{"name": "a", "spec": {}}"#).field, "spec.n");
        let long = error(&format!(r#"{{"{}": 1}}"#, "a".repeat(100_000)));
        assert!(long.to_string().len() < 1000);
        let stray = Request::from_json(br#"{"client": "me", "steps": 1}"#).unwrap_err();
        assert!(stray.to_string().contains("`args`"), "{stray}");
    }

    #[test]
    fn a_list_is_not_taken_for_an_object_nor_an_object_for_a_word() {
        let read = |text: &str| {
            let request = Request::from_json(text.as_bytes()).unwrap();
            request.args::<InjectArgs>().map_err(|error| error.field)
        };
        assert!(read(r#"{"at": [{"x": 1, "y": 2, "alpha": 3}]}"#).is_ok());
        for args in ["[3]", "[]", "3", "\"at\"", "null"] {
            let request = format!(r#"{{"client": "me", "args": {args}}}"#);
            let rejected = read(&request);
            // Arguments of null are none.
            if args == "null" {
                assert!(rejected.is_ok());
            } else {
                assert_eq!(rejected.unwrap_err(), "args", "{args}");
            }
        }
        assert_eq!(read(r#"{"at": [[1, 2, 3]]}"#).unwrap_err(), "at[0]");
        let word = Request::from_json(br#"{"return": {"state": null}}"#).unwrap();
        assert_eq!(word.args::<StepArgs>().unwrap_err().field, "return");
        assert_eq!(
            read(r#"{"count": 1, "within": [1, 2, 3]}"#).unwrap_err(),
            "within"
        );
    }

    #[test]
    fn the_pattern_excludes_the_characters_that_are_not_plain() {
        let class = PLAIN_TEXT_RULE.strip_prefix("^[^").unwrap();
        let class = class.strip_suffix("]*$").unwrap();
        let number =
            |text: &str| u32::from_str_radix(text.strip_prefix("\\u").unwrap(), 16).unwrap();
        let mut ranges = Vec::new();
        let mut rest = class;
        while !rest.is_empty() {
            let first = number(&rest[..6]);
            let last = rest[6..].strip_prefix('-').map(|range| number(&range[..6]));
            rest = &rest[if last.is_some() { 13 } else { 6 }..];
            ranges.push(first..=last.unwrap_or(first));
        }
        for c in '\0'..=char::MAX {
            let is_excluded = ranges.iter().any(|range| range.contains(&u32::from(c)));
            assert_eq!(is_plain(c), !is_excluded, "{c:?}");
        }
    }

    #[test]
    fn deep_nesting_is_rejected_without_a_deep_stack() {
        let deep = "[".repeat(200_000);
        assert!(Request::from_json(deep.as_bytes()).is_err());
        let text = format!("{{\"args\": {}{}}}", deep, "]".repeat(200_000));
        let request = Request::from_json(text.as_bytes());
        assert!(request.is_err() || request.is_ok_and(|r| r.args::<StepArgs>().is_err()));
    }
}
