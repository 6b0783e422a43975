//! The command line has a subcommand for each verb of the contract, and an argument for each of its fields.
//! `surface.txt`, which a unit test compares with the program, lists both.

use std::collections::BTreeSet;

use jostle_proto::contract::schemas;
use jostle_proto::verbs::{Definition, NodeVerb, SwarmVerb};
use serde_json::Value;

const SURFACE: &str = include_str!("../../surface.txt");

/// Verbs without a subcommand: why.
const NO_SUBCOMMAND: [(&str, &str); 3] = [
    ("join", "a controller is a program, in Python or Rust"),
    ("advance", "as join"),
    (
        "discard",
        "delete asks each daemon, and discards on the one of --node",
    ),
];

/// Fields without an argument of their name: which argument has them, or why there is none.
const OTHERS: [(&str, &str, &str); 27] = [
    ("protect", "on", "--off"),
    ("run", "until_time", "--until 20"),
    ("step", "return", "--state"),
    ("inform", "select", "--count, --ids and others"),
    ("uninform", "select", "--count, --ids and others"),
    ("remove", "select", "--count, --ids and others"),
    ("batch", "commands", "<file>"),
    ("batch", "draw", "the file can have it"),
    ("batch", "protocol", "the file can have it"),
    ("fork", "step", "--at-step"),
    ("when", "event", "`jostle wait` and `run --until`"),
    ("when", "from_step", "as event"),
    (
        "when",
        "before_step",
        "for the commands of an experiment's file",
    ),
    ("when", "draw", "as before_step"),
    ("when", "protocol", "as before_step"),
    ("when", "pause", "without commands it pauses"),
    ("when", "id", "--cancel"),
    ("restore", "snapshot", "<file>"),
    ("experiment", "submit", "experiment run"),
    ("experiment", "expand", "experiment run --dry-run"),
    ("experiment", "pause", "experiment pause"),
    ("experiment", "resume", "experiment resume"),
    ("experiment", "cancel", "experiment cancel"),
    ("experiment", "delete", "experiment delete"),
    ("replay", "open", "<name>"),
    ("replay", "upload", "<file>"),
    ("record", "begin", "record"),
];

/// The names of the fields of arguments, those of all variants.
fn fields(schema: &Value, root: &Value, names: &mut BTreeSet<String>) {
    if let Some(name) = schema["$ref"].as_str() {
        let name = name.trim_start_matches("#/$defs/");
        return fields(&root["$defs"][name], root, names);
    }
    for kind in ["oneOf", "anyOf"] {
        for variant in schema[kind].as_array().into_iter().flatten() {
            fields(variant, root, names);
        }
    }
    let properties = schema["properties"].as_object().into_iter().flatten();
    names.extend(properties.map(|(name, _)| name.clone()));
}

fn definitions() -> impl Iterator<Item = &'static Definition> {
    SwarmVerb::DEFINITIONS.iter().chain(NodeVerb::DEFINITIONS)
}

#[test]
fn each_verb_has_a_subcommand_and_each_of_its_fields_an_argument() {
    let surface: BTreeSet<&str> = SURFACE.lines().collect();
    let (mut missing, mut needed) = (Vec::new(), BTreeSet::new());
    for &Definition {
        name,
        args,
        at_step,
        ..
    } in definitions()
    {
        let is_named = surface.contains(name);
        let has_reason = NO_SUBCOMMAND.iter().any(|(verb, _)| *verb == name);
        if is_named == has_reason {
            missing.push(format!("{name}: a subcommand, or why there is none"));
        }
        if !is_named {
            continue;
        }
        // That of `fork` is a field of its own.
        let takes_step = surface.contains(format!("{name} --at-step").as_str());
        if name != "fork" && takes_step != at_step {
            missing.push(format!(
                "{name}: --at-step is {takes_step}, at_step {at_step}"
            ));
        }
        let schema = schemas()[args].clone().to_value();
        let mut names = BTreeSet::new();
        fields(&schema, &schema, &mut names);
        for field in names {
            let argument = field.replace('_', "-");
            let arguments = [
                format!("{name} --{argument}"),
                format!("{name} <{field}>"),
                // Those of `set` name any field.
                format!("{name} <assignments>"),
            ];
            let is_there = arguments.iter().any(|it| surface.contains(it.as_str()));
            let other = OTHERS.iter().find(|it| (it.0, it.1) == (name, &field));
            match (is_there, other) {
                (false, None) => missing.push(format!("{name}: an argument for {field}")),
                (false, Some(other)) => {
                    needed.insert((other.0, other.1));
                }
                (true, _) => {}
            }
        }
    }
    assert!(missing.is_empty(), "{missing:#?}");
    let listed: BTreeSet<_> = OTHERS.iter().map(|it| (it.0, it.1)).collect();
    assert_eq!(listed, needed, "no line is left of what has an argument");
}
