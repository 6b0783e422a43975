//! What the code of a swarm says of a command is what the contract says of its verb.

use jostle_contract::fixtures;
use jostle_proto::Request;
use jostle_proto::verbs::definition;
use jostled::convert::commands;
use jostled::swarm::command::Command;
use serde_json::Value;

/// The commands of the fixtures: verb, arguments, command.
fn parsed() -> Vec<(&'static str, Value, Command)> {
    let mut parsed = Vec::new();
    for (message, _, text) in fixtures().unwrap() {
        let Some(verb) = message.strip_suffix(".args") else {
            continue;
        };
        let request = Request::from_json(text.as_bytes()).unwrap();
        // The others are executed by the daemon.
        if let Ok((message, _)) = commands::read(verb, &request) {
            let args = serde_json::from_str(&text).unwrap();
            parsed.push((verb, args, message.command));
        }
    }
    parsed
}

#[test]
fn annotations_of_the_contract_are_annotations_of_a_swarm() {
    let (mut annotations, mut others) = (0, 0);
    for (verb, _, command) in parsed() {
        // Whether `when` is one depends on its arguments.
        if verb != "when" {
            let is_one = command.is_annotation();
            assert_eq!(definition(verb).unwrap().is_annotation, is_one, "{verb}");
            match is_one {
                true => annotations += 1,
                false => others += 1,
            }
        }
    }
    assert!(annotations >= 2 && others > 10, "{annotations} {others}");
}

/// Otherwise any user could name any controller.
#[test]
fn a_command_that_names_a_controller_is_one_of_this_controller() {
    let mut named = 0;
    for (verb, args, command) in parsed() {
        let controller = args["controller"].as_str();
        assert_eq!(command.controller(), controller, "{verb}");
        named += usize::from(controller.is_some());
    }
    assert!(named >= 3, "{named}");
}
