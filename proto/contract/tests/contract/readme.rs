//! Statements of `README.md` that a test can read. Its Rust is tested as documentation.

use std::fs;

use jostle_proto::contract::schemas;
use jostle_proto::verbs::MAX_CHANGES;
use jostle_proto::{LARGEST_WHOLE, MAX_LABEL_LENGTH, WIRE_VERSION, keys};
use serde_json::Value;

use jostle_contract::{fixtures, folder};

fn readme() -> String {
    fs::read_to_string(folder().join("README.md")).unwrap()
}

#[test]
fn every_error_code_is_in_the_table_in_the_order_of_the_schema() {
    let text = readme();
    let (_, table) = text.split_once("| code | when |").unwrap();
    let rows = table
        .lines()
        .skip(2)
        .take_while(|line| line.starts_with('|'));
    let listed: Vec<&str> = rows.map(|row| row.split('`').nth(1).unwrap()).collect();
    let schema = schemas().remove("error").unwrap().to_value();
    let codes = schema["$defs"]["ErrorCode"]["oneOf"].as_array().unwrap();
    let codes: Vec<&str> = codes.iter().filter_map(|it| it["const"].as_str()).collect();
    assert_eq!(listed, codes);
}

#[test]
fn every_verb_of_a_swarm_is_in_the_table_of_phases() {
    let text = readme();
    let (_, table) = text.split_once("| verb | `paused`").unwrap();
    let table = table.split("\n\n").next().unwrap();
    for verb in keys::SWARM_VERBS {
        assert!(table.contains(&format!("`{verb}`")), "{verb}");
    }
}

#[test]
fn every_example_is_a_fixture() {
    let text = readme();
    let blocks = text.split("```json\n").skip(1);
    let examples: Vec<Value> = blocks
        .map(|block| serde_json::from_str(block.split("```").next().unwrap()).unwrap())
        .collect();
    assert!(!examples.is_empty());
    let fixtures = fixtures().unwrap().into_iter();
    let fixtures: Vec<Value> = fixtures
        .map(|(.., text)| serde_json::from_str(&text).unwrap())
        .collect();
    for example in examples {
        assert!(fixtures.contains(&example), "{example:#}");
    }
}

#[test]
fn every_file_it_names_is_there() {
    let text = readme();
    let quoted = text.split('`').skip(1).step_by(2);
    let files = quoted.filter(|it| it.contains('/') && it.ends_with(".rs"));
    let mut count = 0;
    for file in files {
        let is_there = folder().join(file).exists() || folder().join("..").join(file).exists();
        assert!(is_there, "{file}");
        count += 1;
    }
    assert!(count >= 5, "{count}");
}

#[test]
fn its_numbers_are_those_of_the_code() {
    let text = readme();
    for number in [
        format!("`wire_version`, now {WIRE_VERSION}."),
        format!("{LARGEST_WHOLE} (2⁵³ - 1)"),
        format!("at most {MAX_LABEL_LENGTH} bytes"),
        format!("1 to {MAX_CHANGES} of `set`"),
        format!("`{}`", keys::NAME_RULE),
    ] {
        assert!(text.contains(&number), "{number}");
    }
}
