//! What differs from the rules, since it is public or is no part of the contract.

/// Messages that the package reads into arrays or not at all, or whose classes have more fields.
pub const APART: [&str; 7] = [
    "advance.reply",
    "experiment.order",
    "experiment.series",
    "scheduled.reply",
    "snapshot.reply",
    "spec.reply",
    "state",
];

/// Classes with another name or base than the rules give.
pub const CLASSES: [(&str, &str, &str); 9] = [
    ("Controller", "ControllerSummary", "HtmlStruct"),
    ("Error", "ErrorMessage", "msgspec.Struct"),
    ("Event", "Event", "Dated"),
    ("ExtraValue", "ExtraValue", "msgspec.Struct"),
    ("JournalEntry", "JournalEntry", "Dated"),
    ("Progress", "Progress", "msgspec.Struct"),
    ("Recording", "RecordingStatus", "HtmlStruct"),
    ("RunUnderWay", "RunUnderWay", "msgspec.Struct"),
    ("Schemas", "Schemas", "msgspec.Struct"),
];

/// The types of words and laws that a newer daemon may add to, and of inputs.
pub const TYPES: [(&str, &str); 6] = [
    ("Attraction", "dict[str, Any]"),
    ("ContactRule", "str"),
    ("ErrorCode", "str"),
    ("ParameterKind", "str"),
    ("Start", "Disc | Given"),
    ("Stepping", "str"),
];

/// Fields that differ from the rules; the class has none that is empty here.
pub const FIELDS: [(&str, &str); 6] = [
    ("Changed.published_hz", ""),
    ("ExpandedRun.spec", "dict[str, Any]"),
    ("RecordingGap.after", "RecordedAt | None"),
    ("StepResult.state", ""),
    ("WhoAmI.person", "str | None"),
    ("WhoAmI.role", "Role | None"),
];

/// Counts that the package makes of the numbers of messages.
pub const SKIPPED: [(&str, &str); 2] = [
    (
        "Event",
        "Number of events between the previous one and this that the daemon no longer stores; it \
         stores about a thousand.",
    ),
    (
        "JournalEntry",
        "Number of commands between the previous entry and this that the daemon no longer stores; 0 \
         if only some commands were selected.",
    ),
];

/// Fields that end a class, in an order that the fixtures do not have.
pub const LAST: [(&str, &str); 4] = [
    (
        "EventKind",
        "kind reason seq applies_at_step verb args client request_id error ids recording",
    ),
    ("InjectArgs", "count at within direction weight"),
    ("ParameterValues", "measures max_idle_secs"),
    ("ResultRow", "fault extra"),
];

/// The methods of some classes.
pub const METHODS: &str = include_str!("methods.py");

pub const HEAD: &str = r#"Unknown fields are ignored, so that this version can read a newer daemon. Lengths are in body
sizes, speeds in free speeds, times in body sizes over free speed, and angles in radians,
counter-clockwise from +x.

On the wire the fields of a reply are in `result`, within the envelope of every reply, and those of
an event in `event`; here both are the fields of one struct, which `_decode` makes.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any, Literal

import msgspec

from ._dated import Dated
from ._repr import HtmlStruct, bar_html
from ._spec import Disc, Given
"#;

/// The class of a type, and its base.
pub fn class_of<'a>(name: &'a str, base: &'a str) -> (&'a str, &'a str) {
    let mut classes = CLASSES.iter();
    let class = classes.find(|(it, ..)| *it == name);
    class.map_or((name, base), |(_, class, base)| (*class, *base))
}

/// The type of a field that differs from the rules.
pub fn overridden(definition: &str, name: &str) -> Option<&'static str> {
    let place = format!("{definition}.{name}");
    FIELDS
        .iter()
        .find(|(it, _)| *it == place)
        .map(|(_, kind)| *kind)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::collections::BTreeSet;

    use jostle_proto::contract::{documents, messages};
    use serde_json::Value;

    use super::*;

    /// The names of the properties of a type, of its variants, and of the `result` in them.
    fn properties<'a>(schema: &'a Value, all: &'a Value) -> BTreeSet<&'a str> {
        let own = schema["properties"].as_object().into_iter().flatten();
        let mut names: BTreeSet<&str> = own.map(|(name, _)| name.as_str()).collect();
        if let Some(place) = schema["properties"]["result"]["$ref"].as_str() {
            names.extend(properties(&all[place.trim_start_matches("#/$defs/")], all));
        }
        for kind in ["oneOf", "anyOf"] {
            let variants = schema[kind].as_array().into_iter().flatten();
            names.extend(variants.flat_map(|it| properties(it, all)));
        }
        names
    }

    #[test]
    fn each_row_names_a_message_a_type_or_a_field() {
        let documents = documents().unwrap();
        let known = |it: &str| {
            let (name, field) = it.split_once('.').unwrap_or((it, ""));
            documents
                .values()
                .map(|it| &it["$defs"])
                .any(|all| match field {
                    "" => all[name].is_object(),
                    field => properties(&all[name], all).contains(field),
                })
        };
        let mut rows: Vec<String> = Vec::new();
        rows.extend(CLASSES.map(|(name, ..)| name.to_owned()));
        rows.extend(TYPES.map(|(name, _)| name.to_owned()));
        rows.extend(FIELDS.map(|(name, _)| name.to_owned()));
        rows.extend(SKIPPED.map(|(name, _)| name.to_owned()));
        for (name, fields) in LAST {
            rows.extend(fields.split(' ').map(|field| format!("{name}.{field}")));
        }
        rows.retain(|it| !known(it));
        assert_eq!(rows, Vec::<String>::new());
        let messages = messages();
        assert!(APART.iter().all(|it| messages.contains(it)));
        assert!(!known("Event.nothing") && !known("Nothing") && known("Status.n"));
    }
}
