//! The tables of `docs/` about verbs and parameters.

use std::fs;

use jostle_contract::folder;
use jostle_proto::AXES;
use jostle_proto::contract::parameters;
use jostle_proto::verbs::{NodeVerb, SwarmVerb};
use serde_json::Value;

fn page(name: &str) -> String {
    fs::read_to_string(folder().join("../docs").join(name)).unwrap()
}

/// The cells of the rows below a heading of a table.
fn rows(text: &str, heading: &str) -> Vec<Vec<String>> {
    let (_, table) = text.split_once(heading).unwrap();
    let rows = table.lines().skip(2).take_while(|it| it.starts_with('|'));
    let cells = |row: &str| row.split('|').map(|it| it.trim().to_owned()).collect();
    rows.map(cells).collect()
}

#[test]
fn every_verb_has_an_example_in_the_pages_about_commands_and_recordings() {
    let text = ["commands.md", "recording.md", "experiments.md"].map(page);
    let text = text.concat();
    let definitions = SwarmVerb::DEFINITIONS.iter().chain(NodeVerb::DEFINITIONS);
    // `jostle delete` sends it to a daemon of which it knows the name.
    let shown = definitions.filter(|it| it.name != "discard");
    for verb in shown.map(|it| it.name) {
        let is_there =
            text.contains(&format!("`{verb}`")) || text.contains(&format!("`jostle {verb}"));
        assert!(is_there, "{verb}");
    }
}

#[test]
fn the_tables_of_parameters_have_their_defaults() {
    let parameters = parameters();
    let default = |name: &str| {
        let mut named = parameters.iter().filter(|it| it.name == name);
        let default = named.next().map(|it| it.default.clone());
        match default.as_ref().and_then(Value::as_f64) {
            Some(number) => Some(number.to_string()),
            None => default.map(|it| match &it {
                Value::Null => "required".to_owned(),
                Value::Object(fields) => format!("`{{ kind = {} }}`", fields["kind"]),
                other => format!("`{other}`"),
            }),
        }
    };
    let (mut of_model, mut axes) = (0, Vec::new());
    for row in rows(
        &page("model.md"),
        "| symbol | field | meaning | default | range |",
    ) {
        let name = row[2].trim_matches('`');
        assert_eq!(default(name).as_ref(), Some(&row[4]), "{name}");
        of_model += 1;
    }
    assert!(of_model >= 6);
    for row in rows(&page("experiments.md"), "| axis | default | meaning |") {
        let name = row[1].trim_matches('`').to_owned();
        if let Some(default) = default(&name) {
            assert_eq!(default, row[2], "{name}");
        }
        axes.push(name);
    }
    let missing = AXES
        .iter()
        .map(|it| &it.name)
        .filter(|it| !axes.contains(it));
    assert_eq!(missing.collect::<Vec<_>>(), Vec::<&String>::new());
}
