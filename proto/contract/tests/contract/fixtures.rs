//! Every fixture is a message: its type reads it and writes it back. The check of the AsyncAPI
//! document, whose examples they are, compares them with the schemas.

use std::collections::BTreeSet;
use std::fs;

use jostle_proto::contract::{is_received, schemas};
use jostle_proto::verbs::StepResult;
use jostle_proto::{Reply, Snapshot, State, to_cbor};
use serde_json::{Value, json};

use jostle_contract::{fixtures, folder, message, rewrite};

/// Whether clients send this message.
/// Reads a message into its type and writes it back.
fn written_back(message: &str, text: &str) -> Result<Value, String> {
    let text = rewrite(message, text)?;
    serde_json::from_str(&text).map_err(|it| it.to_string())
}

#[test]
fn every_message_and_every_error_code_has_a_fixture() {
    let fixtures = fixtures().unwrap();
    let there: BTreeSet<&str> = fixtures.iter().map(|(message, ..)| *message).collect();
    assert_eq!(there, schemas().into_keys().collect());

    let schema = schemas().remove("error").unwrap().to_value();
    let codes = schema["$defs"]["ErrorCode"]["oneOf"].as_array().unwrap();
    assert_eq!(codes.len(), 13);
    for code in codes {
        let code = code["const"].as_str().unwrap();
        let (.., text) = fixtures
            .iter()
            .find(|(message, variant, _)| *message == "error" && variant == code)
            .unwrap_or_else(|| panic!("there is no fixtures/error.{code}.json"));
        let error: jostle_proto::Error = serde_json::from_str(text).unwrap();
        assert_eq!(serde_json::to_value(error.code).unwrap(), code);
    }
}

#[test]
fn every_fixture_reads_into_its_type_and_nothing_is_dropped() {
    for (message, variant, text) in fixtures().unwrap() {
        let given: Value = serde_json::from_str(&text).unwrap();
        let back = written_back(message, &text).unwrap_or_else(|it| panic!("{variant}: {it}"));
        if is_received(message) {
            // A field that is left out is written with its default.
            assert!(
                holds(&back, &given),
                "{message} {variant}: {given} came back as {back}"
            );
            let again = written_back(message, &back.to_string()).unwrap();
            assert_eq!(back, again, "{message} {variant}");
        } else {
            assert_eq!(given, back, "{message} {variant}");
        }
    }
}

/// Whether `whole` contains `part`; 4 and 4.0 are equal.
fn holds(whole: &Value, part: &Value) -> bool {
    match (whole, part) {
        (Value::Object(whole), Value::Object(part)) => part
            .iter()
            .all(|(name, part)| whole.get(name).is_some_and(|whole| holds(whole, part))),
        (Value::Array(whole), Value::Array(part)) => {
            whole.len() == part.len() && whole.iter().zip(part).all(|(a, b)| holds(a, b))
        }
        (Value::Number(whole), Value::Number(part)) => whole.as_f64() == part.as_f64(),
        (whole, part) => whole == part,
    }
}

#[test]
fn an_unknown_field_is_rejected_in_requests_and_ignored_in_messages_of_the_daemon() {
    for (message, variant, text) in fixtures().unwrap() {
        let given: Value = serde_json::from_str(&text).unwrap();
        for place in objects(message, &given, String::new()) {
            let mut more = given.clone();
            let object = more.pointer_mut(&place).unwrap();
            object["from_the_future"] = json!({"is": ["tolerated"]});
            let read = written_back(message, &more.to_string());
            let context = format!("{message} {variant} {place}: {read:?}");
            if is_received(message) {
                assert!(read.is_err(), "{context}");
            } else {
                assert_eq!(read.as_ref(), Ok(&given), "{context}");
            }
        }
    }
}

#[test]
fn schemas_reject_unknown_fields_exactly_where_types_do() {
    for (message, schema) in schemas() {
        let schema = schema.to_value();
        let definitions = schema["$defs"].as_object().into_iter().flatten();
        let all = definitions.map(|(_, it)| it).chain([&schema]);
        for part in all.flat_map(|it| variants(it).chain([it])) {
            let is_closed = part["additionalProperties"] == false;
            let has_fields = part["properties"].is_object();
            if is_received(message) {
                assert!(is_closed || !has_fields, "{message}: {part}");
            } else {
                assert!(!is_closed, "{message}: {part}");
            }
        }
    }
}

fn variants(schema: &Value) -> impl Iterator<Item = &Value> {
    schema["oneOf"].as_array().into_iter().flatten()
}

/// Pointers to all objects whose fields the contract defines: not those of unparsed arguments, of
/// an error's details, of JSON Schemas, nor of values that may be anything.
fn objects(message: &str, value: &Value, place: String) -> Vec<String> {
    let is_open = match place.rsplit('/').next() {
        // A map whose names are measures.
        Some("measures") => message == "order",
        // A map whose names are controllers.
        Some("sequences") => message == "attachment",
        Some("args") => message == "request" || !is_received(message),
        Some("details" | "schemas" | "default" | "value" | "choices") => true,
        _ => false,
    };
    let mut places = Vec::new();
    match value {
        _ if is_open => {}
        Value::Object(fields) => {
            for (name, field) in fields {
                places.extend(objects(message, field, format!("{place}/{name}")));
            }
            places.push(place);
        }
        Value::Array(items) => {
            for (i, item) in items.iter().enumerate() {
                places.extend(objects(message, item, format!("{place}/{i}")));
            }
        }
        _ => {}
    }
    places
}

#[test]
fn states_in_cbor_are_those_in_json_to_the_bit() {
    let read = |name: &str| fs::read(folder().join("fixtures").join(name)).unwrap();
    let bytes = read("state.cbor");
    let state: State = serde_json::from_slice(&read("state.json")).unwrap();
    assert_eq!(State::from_cbor(&bytes).unwrap(), state);
    assert_eq!(state.to_cbor(), bytes);

    let bytes = read("step.reply.state.cbor");
    let reply: Reply<StepResult> = serde_json::from_slice(&read("step.reply.state.json")).unwrap();
    assert_eq!(
        ciborium::from_reader::<Reply<StepResult>, _>(&bytes[..]).unwrap(),
        reply
    );
    assert_eq!(to_cbor(&reply), bytes);

    let bytes = read("snapshot.reply.cbor");
    let reply: Reply<Snapshot> = serde_json::from_slice(&read("snapshot.reply.json")).unwrap();
    assert_eq!(
        ciborium::from_reader::<Reply<Snapshot>, _>(&bytes[..]).unwrap(),
        reply
    );
    assert_eq!(to_cbor(&reply), bytes);
    let file = to_cbor(&reply.result);
    assert_eq!(Snapshot::from_file(&file).unwrap(), reply.result);
}

#[test]
fn every_file_among_the_fixtures_is_of_a_message() {
    for entry in fs::read_dir(folder().join("fixtures")).unwrap() {
        let path = entry.unwrap().path();
        let stem = path.file_stem().unwrap().to_string_lossy();
        assert!(message(&stem).is_some(), "{}", path.display());
    }
}
