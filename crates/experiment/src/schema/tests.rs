//! The schema agrees with the parser. [`compare`] is called for each file that a test of this crate gives
//! the parser.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use serde::Deserialize;
use serde_json::{Value, json};

use super::{VARIABLE, file_keys, measure_keys, schema};
use crate::error::PlanError;
use crate::file::File;
use crate::files::Files;
use crate::plan::Plan;

static FILE: LazyLock<Value> = LazyLock::new(schema);

/// The files in `cases.toml`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Cases {
    accepted: Vec<Case>,
    rejected: Vec<Case>,
    /// Those that only the parser rejects.
    parser: Vec<Case>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Case {
    file: String,
    /// A part of the parser's reason.
    #[serde(default)]
    reason: String,
}

static CASES: LazyLock<Cases> =
    LazyLock::new(|| toml::from_str(include_str!("cases.toml")).unwrap());

/// Compares what the parser and the schema say of a file. What only the parser rejects is in the list.
pub fn compare(files: &Files, parsed: &Result<Plan, PlanError>) {
    let Ok(mut file) = toml::from_str(&files.toml) else {
        return;
    };
    let names_files = [&files.points, &files.setpoints].map(Option::is_some);
    let names_files = names_files.contains(&true) || files.start.is_some();
    match (parsed, validated(&file)) {
        (Ok(_), Err(reason)) if is_of_list(&reason) => {}
        (Ok(_), Err(reason)) => {
            leave_out_replaced(&mut file);
            let reason = validated(&file).err().map(|_| reason);
            assert_eq!(reason, None, "only the schema rejects\n{}", files.toml);
        }
        (Err(error), Ok(())) if !names_files => {
            let reason = error.to_string();
            let mut listed = CASES.parser.iter();
            assert!(
                listed.any(|it| reason.contains(&it.reason)),
                "only the parser rejects, and cases.toml does not list it: {reason}\n{}",
                files.toml
            );
        }
        _ => {}
    }
}

/// Returns whether a list is in place of a table, which serde reads as the fields in their order.
fn is_of_list(reason: &str) -> bool {
    reason.starts_with('[') && reason.contains(r#" violates type: "object""#)
}

/// Removes the fields of `[spec]` that each `[[grid]]` replaces, whose ranges the parser does not check.
fn leave_out_replaced(file: &mut toml::Table) {
    let grids = file.get("grid").and_then(toml::Value::as_array);
    let grids = grids.cloned().unwrap_or_default();
    if let Some(spec) = file.get_mut("spec").and_then(toml::Value::as_table_mut) {
        spec.retain(|key, _| grids.is_empty() || grids.iter().any(|it| it.get(key).is_none()));
    }
}

/// Validates a file.
fn validated(file: &toml::Table) -> Result<(), String> {
    validate(&FILE, &json_of(&toml::Value::Table(file.clone())))
}

/// Returns a value of TOML in JSON, as editors do: NaN and infinite numbers are `null`.
fn json_of(value: &toml::Value) -> Value {
    match value {
        toml::Value::Table(fields) => {
            let fields = fields.iter().map(|(key, it)| (key.clone(), json_of(it)));
            Value::Object(fields.collect())
        }
        toml::Value::Array(items) => items.iter().map(json_of).collect(),
        toml::Value::String(text) => json!(text),
        toml::Value::Integer(number) => json!(number),
        toml::Value::Float(number) => json!(number),
        toml::Value::Boolean(is) => json!(is),
        toml::Value::Datetime(time) => json!(time.to_string()),
    }
}

/// Validates a value with the keywords of draft-07 that the schema has.
fn validate(schema: &Value, value: &Value) -> Result<(), String> {
    let keywords = match schema {
        Value::Bool(true) => return Ok(()),
        Value::Bool(false) => return Err(format!("{value} is not allowed")),
        Value::Object(keywords) => keywords,
        other => panic!("{other} is no schema"),
    };
    for (keyword, rule) in keywords {
        is_valid(schema, keyword, rule, value).map_err(|inner| match inner {
            Some(inner) => inner,
            None => format!("{value} violates {keyword}: {rule}"),
        })?;
    }
    Ok(())
}

/// Validates a value with one keyword; the error is the reason within the value, if there is one.
fn is_valid(
    schema: &Value,
    keyword: &str,
    rule: &Value,
    value: &Value,
) -> Result<(), Option<String>> {
    let object = value.as_object();
    let number = |holds: fn(f64, f64) -> bool| {
        let limit = rule.as_f64().unwrap();
        value.as_f64().is_none_or(|it| holds(it, limit))
    };
    let length = |holds: fn(usize, usize) -> bool| {
        let limit = usize::try_from(rule.as_u64().unwrap()).unwrap();
        value.as_array().is_none_or(|it| holds(it.len(), limit))
    };
    let within = |schema: &Value, value: &Value| validate(schema, value).map_err(Some);
    let matching = || {
        let schemas = rule.as_array().unwrap().iter();
        schemas.filter(|it| validate(it, value).is_ok()).count()
    };
    let has = |key: &Value| object.is_none_or(|it| it.contains_key(key.as_str().unwrap()));
    let fields = || object.into_iter().flatten();
    let holds = match keyword {
        "$schema" | "title" | "description" | "default" | "definitions" | "then" | "else" => true,
        "$ref" => {
            assert_eq!(schema.as_object().unwrap().len(), 1, "{schema}");
            let place = rule.as_str().unwrap().strip_prefix('#').unwrap();
            return within(FILE.pointer(place).unwrap(), value);
        }
        "type" => match rule.as_array() {
            Some(types) => types.iter().any(|it| is_of_type(it, value)),
            None => is_of_type(rule, value),
        },
        "enum" => rule.as_array().unwrap().contains(value),
        "const" => rule == value,
        "minimum" => number(|it, limit| it >= limit),
        "maximum" => number(|it, limit| it <= limit),
        "exclusiveMinimum" => number(|it, limit| it > limit),
        "pattern" => {
            let pattern = rule.as_str().unwrap();
            value.as_str().is_none_or(|it| is_match(pattern, it))
        }
        "minProperties" => object.is_none_or(|it| it.len() as u64 >= rule.as_u64().unwrap()),
        "maxProperties" => object.is_none_or(|it| it.len() as u64 <= rule.as_u64().unwrap()),
        "minItems" => length(|it, limit| it >= limit),
        "maxItems" => length(|it, limit| it <= limit),
        "uniqueItems" => {
            let items = value.as_array().into_iter().flatten();
            let texts: Vec<String> = items.map(ToString::to_string).collect();
            (1..texts.len()).all(|it| !texts[..it].contains(&texts[it]))
        }
        "items" => {
            let mut items = value.as_array().into_iter().flatten();
            return items.try_for_each(|it| within(rule, it));
        }
        "properties" => {
            let mut known = fields().filter_map(|(key, it)| Some((rule.get(key)?, it)));
            return known.try_for_each(|(schema, it)| within(schema, it));
        }
        "additionalProperties" => {
            let known = &schema["properties"];
            let mut others = fields().filter(|(key, _)| known.get(key).is_none());
            return others.try_for_each(|(key, it)| {
                let checked = validate(rule, it);
                checked.map_err(|reason| Some(format!("{key}: {reason}")))
            });
        }
        "propertyNames" => return fields().try_for_each(|(key, _)| within(rule, &json!(key))),
        "required" => rule.as_array().unwrap().iter().all(has),
        "dependencies" => {
            let given = rule.as_object().unwrap().iter();
            let mut given = given.filter(|(key, _)| object.is_some_and(|it| it.contains_key(*key)));
            return given.try_for_each(|(key, rule)| match rule.as_array() {
                Some(keys) if keys.iter().all(has) => Ok(()),
                Some(_) => Err(Some(format!("{key} requires {rule}"))),
                None => within(rule, value),
            });
        }
        "allOf" => {
            let mut schemas = rule.as_array().unwrap().iter();
            return schemas.try_for_each(|it| within(it, value));
        }
        "anyOf" => matching() > 0,
        "oneOf" => matching() == 1,
        "not" => validate(rule, value).is_err(),
        "if" => {
            let branch = if validate(rule, value).is_ok() {
                "then"
            } else {
                "else"
            };
            return schema.get(branch).map_or(Ok(()), |it| within(it, value));
        }
        other => panic!("unknown keyword {other}"),
    };
    if holds { Ok(()) } else { Err(None) }
}

fn is_of_type(kind: &Value, value: &Value) -> bool {
    match kind.as_str().unwrap() {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "number" => value.is_number(),
        "integer" => value.as_f64().is_some_and(|it| it.fract() == 0.0),
        other => panic!("type {other}"),
    }
}

/// Returns whether a text matches one of the patterns of the schema.
fn is_match(pattern: &str, text: &str) -> bool {
    let is_variable = |text: &str| {
        text.starts_with(|it: char| it.is_ascii_alphabetic())
            && text.chars().all(crate::file::is_of_name)
    };
    if pattern == jostle_proto::keys::NAME_RULE {
        return jostle_proto::keys::is_name(text);
    }
    if pattern == format!("^{VARIABLE}$") {
        return is_variable(text);
    }
    if pattern == format!(r"^\${VARIABLE}$") {
        return text.strip_prefix('$').is_some_and(is_variable);
    }
    // Of a measure.
    let all = pattern.strip_prefix(r"^\s*(").unwrap();
    let mut all = all.strip_suffix(r")\s*$").unwrap().split('|');
    all.any(|one| {
        let (name, argument) = one.split_once(r"\s*").unwrap_or((one, ""));
        let (given, given_argument) = match text.split_once('(') {
            Some((given, argument)) => (given, argument.trim_end().ends_with(')')),
            None => (text, false),
        };
        let has_argument = text.contains('(');
        given.trim() == name.replace('\\', "")
            && match argument.chars().next() {
                None => !has_argument,
                Some('(') => given_argument || !has_argument,
                _ => given_argument,
            }
    })
}

#[test]
fn the_parser_and_the_schema_reject_the_same_files_but_those_in_the_list() {
    // `compare` is called for each of them.
    let parsed = |case: &Case| Plan::parse(&case.file).map_err(|error| error.to_string());
    let is_valid = |case: &Case| validated(&toml::from_str(&case.file).unwrap());
    for case in &CASES.accepted {
        assert_eq!(parsed(case).err(), None, "{}", case.file);
        assert_eq!(is_valid(case), Ok(()), "{}", case.file);
    }
    for case in &CASES.rejected {
        assert!(parsed(case).is_err(), "the parser accepts\n{}", case.file);
        assert!(is_valid(case).is_err(), "the schema accepts\n{}", case.file);
    }
    for case in &CASES.parser {
        let reason = parsed(case).expect_err(&case.file);
        assert!(
            reason.contains(&case.reason) && !case.reason.is_empty(),
            "{reason}"
        );
        let reason = "the schema rejects it: move it to `rejected`";
        assert_eq!(is_valid(case), Ok(()), "{reason}\n{}", case.file);
    }
}

#[test]
fn the_schema_has_the_longest_lists_that_the_parser_reads() {
    type List<'a> = (&'a str, &'a dyn Fn(usize) -> String, usize);
    let set = |count| {
        format!(
            "{{ time = 0, set = [{}] }}",
            ["{ pi3 = 2 }"].repeat(count).join(", ")
        )
    };
    let blocks = |count| ["{ time = 0, set = { pi3 = 2 } }"].repeat(count).join(", ");
    let columns = |count: usize| {
        let columns: Vec<String> = (1..=count)
            .map(|it| format!("'clusters.count(0.{it:03})'"))
            .collect();
        columns.join(", ")
    };
    let lists: [List<'_>; 3] = [
        ("at", &set, 256),
        ("at", &blocks, 1000),
        ("measure.columns", &columns, 100),
    ];
    for (key, list, limit) in lists {
        for (count, is_accepted) in [(limit, true), (limit + 1, false)] {
            let list = list(count);
            let file = format!("name = 'a'\nduration = 1\nspec = {{ n = 3 }}\n{key} = [{list}]\n");
            let parsed = Plan::parse(&file).map_err(|error| error.to_string());
            assert_eq!(
                parsed.is_ok(),
                is_accepted,
                "{key}: {count} {:?}",
                parsed.err()
            );
            let checked = validated(&toml::from_str(&file).unwrap());
            assert_eq!(checked.is_ok(), is_accepted, "{key}: {count}");
        }
    }
}

/// Returns the text of each experiment in the repository.
fn repository() -> Vec<(PathBuf, String)> {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
    let mut found = Vec::new();
    let mut folders: Vec<PathBuf> = ["paper", "docs", "tests/stored", "fuzz/corpus/experiments"]
        .map(|it| root.join(it))
        .into();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let is_input = path.components().any(|it| it.as_os_str() == "corpus");
            let Ok(text) = fs::read_to_string(&path) else {
                continue;
            };
            match path.extension().and_then(|it| it.to_str()) {
                Some("toml") => found.push((path, text)),
                Some("md") => found.extend(blocks(&text).map(|it| (path.clone(), it))),
                _ if is_input => found.push((path, text)),
                _ => {}
            }
        }
    }
    let is_experiment = |text: &str| {
        let file = toml::from_str::<toml::Table>(text).unwrap_or_default();
        ["name", "duration"]
            .iter()
            .all(|key| file.contains_key(*key))
    };
    found.retain(|(_, text)| is_experiment(text));
    found
}

/// Returns the blocks of a page in TOML, also those in the commands of a shell.
fn blocks(page: &str) -> impl Iterator<Item = String> {
    let mut parts = page.split("```").skip(1).step_by(2);
    let of_toml = parts
        .clone()
        .filter_map(|it| it.strip_prefix("toml\n").map(str::to_owned));
    let of_shell = parts.by_ref().flat_map(|it| {
        let texts = it.split("<<'END'\n").skip(1);
        texts.filter_map(|it| Some(it.split_once("\nEND")?.0.to_owned()))
    });
    of_toml.chain(of_shell).collect::<Vec<_>>().into_iter()
}

#[test]
fn each_experiment_of_the_repository_is_accepted() {
    let files = repository();
    let names: Vec<&str> = files.iter().filter_map(|(it, _)| it.to_str()).collect();
    let count = |part: &str| names.iter().filter(|it| it.contains(part)).count();
    let counts = ["paper/", "docs/", "tests/stored/", "fuzz/"].map(count);
    let least = [3, 8, 9, 8];
    assert!(
        counts.iter().zip(least).all(|(it, least)| *it >= least),
        "{counts:?}"
    );
    for (path, text) in &files {
        // `compare` is called for each.
        let parsed = Plan::parse(text);
        let stored = Plan::stored(Files::from(text.as_str()));
        if path.to_str().unwrap().contains("fuzz/") || parsed.is_err() && stored.is_ok() {
            continue;
        }
        // Some name a file, which is not given.
        let checked = validated(&toml::from_str(text).unwrap());
        assert_eq!(checked, Ok(()), "{}: {parsed:?}", path.display());
    }
}

/// A value somewhere in a file.
type Place = Vec<String>;

/// Returns the places of all values of a file.
fn places(value: &toml::Value, at: &[String], found: &mut Vec<Place>) {
    if !at.is_empty() {
        found.push(at.to_vec());
    }
    let mut within =
        |key: String, value: &toml::Value| places(value, &[at, &[key]].concat(), found);
    match value {
        toml::Value::Table(fields) => fields.iter().for_each(|(key, it)| within(key.clone(), it)),
        toml::Value::Array(items) => {
            let items = items.iter().enumerate();
            items.for_each(|(index, it)| within(index.to_string(), it));
        }
        _ => {}
    }
}

fn value_at<'a>(value: &'a mut toml::Value, place: &[String]) -> &'a mut toml::Value {
    place.iter().fold(value, |value, key| match value {
        toml::Value::Array(items) => &mut items[key.parse::<usize>().unwrap()],
        other => &mut other[key.as_str()],
    })
}

#[test]
fn what_the_parser_accepts_of_files_with_random_changes_the_schema_accepts() {
    let mut bytes = blake3::Hasher::new().finalize_xof();
    let mut below = |limit: usize| {
        let mut number = [0; 8];
        bytes.fill(&mut number);
        usize::try_from(u64::from_le_bytes(number) % limit as u64).unwrap()
    };
    let bases: Vec<&str> = CASES.accepted.iter().map(|it| &*it.file).collect();
    let others: toml::Table = toml::from_str(
        "it = [0, -1, 1, 3, 0.5, 1.0, -0.25, 1e7, nan, inf, 100000000, '', 'x', '$share', '$level', 'order', \
         'closest', 'order > 0.1 for 3', true, [], [1], [0.5, 2], ['order'], {}, {ramp = [0, 1]}, {kind = 'all'}, \
         {count = 1}, {select = {count = 1}}, 2, 4, \
         0.75, 2020-01-01]",
    )
    .unwrap();
    let others = others["it"].as_array().unwrap();
    let (mut accepted, mut rejected) = (0, 0);
    for round in 0..2000 {
        // The first one has all keys, and takes longest.
        let base = match round % 8 {
            0 => bases[0],
            _ => bases[1 + below(bases.len() - 1)],
        };
        let mut file = toml::Value::Table(toml::from_str(base).unwrap());
        for _ in 0..=below(2) {
            let mut found = Vec::new();
            places(&file, &[], &mut found);
            let place = &found[below(found.len())];
            let from = found[below(found.len())].clone();
            let other = match below(3) {
                0 => Some(value_at(&mut file, &from).clone()),
                _ => Some(others[below(others.len())].clone()),
            };
            let (key, table) = place.split_last().unwrap();
            match (value_at(&mut file, table), below(4)) {
                (toml::Value::Table(fields), 0) => drop(fields.remove(key)),
                (toml::Value::Table(fields), 1) => {
                    let new = from.last().unwrap().clone();
                    fields.extend(other.map(|other| (new, other)));
                }
                _ => *value_at(&mut file, place) = other.unwrap(),
            }
        }
        // `compare` is called for it.
        match Plan::parse(&toml::to_string(&file).unwrap()) {
            Ok(_) => accepted += 1,
            Err(_) => rejected += 1,
        }
    }
    assert!(
        accepted > 200 && rejected > 200,
        "{accepted} accepted, {rejected} rejected"
    );
}

#[test]
fn the_schema_has_the_keys_that_the_parser_reads() {
    let read = |text: &str| -> BTreeSet<String> {
        let error = toml::from_str::<File>(text).err().unwrap().to_string();
        let (_, expected) = error.split_once("expected one of").unwrap();
        let quoted = expected.split('`').skip(1).step_by(2);
        quoted.map(str::to_owned).collect()
    };
    let names = |keys: Vec<(&str, &str, Value)>| -> BTreeSet<String> {
        keys.into_iter().map(|(key, ..)| key.to_owned()).collect()
    };
    assert_eq!(read("unknown = 1"), names(file_keys()));
    assert_eq!(read("[measure]\nunknown = 1"), names(measure_keys()));
}
