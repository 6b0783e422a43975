//! The JSON Schema of an experiment's file, for editors.
//!
//! It is assembled from the tables of which the parser is made, and from the schemas of the messages. Only
//! the parser knows places in the file, and some of what it rejects no schema can express: `schema/cases.toml`
//! has an example of each.
//!
//! The dialect is draft-07, which editors of TOML read.

mod parts;

use std::collections::BTreeSet;

use jostle_measures::{Definition, definitions};
use jostle_proto::keys::NAME_RULE;
use jostle_proto::verbs::{MAX_CHANGES, SwarmVerb};
use jostle_proto::{AXES, Axis, contract};
use serde_json::{Map, Value, json};

use crate::grid::{INFORMED, SHARES, taken};
use crate::limits::{
    MAX_BLOCKS, MAX_COLUMNS, MAX_INDIVIDUALS, MAX_RUNS, REPLICATES, SEEDS, STEPS_BETWEEN,
};
use crate::protocol::keys::{KEYS, Kind, STOP, TIMINGS, VERBS, dependent, named};
use crate::start::FIXED;

use parts::{Schemas, described, has, list, reference, table, whole};

/// The name of the schema, beside those of the messages.
pub const SCHEMA: &str = "experiment.file";

/// The pattern of the name of a variable.
const VARIABLE: &str = "[A-Za-z][A-Za-z0-9_]*";

/// Returns the JSON Schema (draft-07) of an experiment's file.
///
/// It accepts each file that [`Plan::of`](crate::Plan::of) accepts, with two exceptions: a value of `[spec]`
/// outside its range that each `[[grid]]` replaces, and a list in place of a table, whose fields the parser
/// reads in their order.
#[must_use]
pub fn schema() -> Value {
    let mut definitions = Schemas::new();
    let spec = spec(&mut definitions);
    let grid = grid(&spec);
    let at = at(&mut definitions);
    for (name, schema) in [
        ("spec", spec),
        ("grid", grid),
        ("at", at),
        ("stop", stop()),
        ("measure", measure()),
        ("column", column()),
        ("ramp", ramp()),
        ("without_ramp", without_ramp()),
    ] {
        definitions.insert(name.to_owned(), schema);
    }
    let mut schema = of_keys(file_keys(), &["name", "duration"]);
    for (key, schema) in schema["properties"].as_object().into_iter().flatten() {
        // An editor shows the description of what a reference refers to.
        if let Some(definition) = definitions.get_mut(key)
            && definition["description"].is_null()
        {
            definition["description"] = schema["description"].clone();
        }
    }
    schema["$schema"] = json!("http://json-schema.org/draft-07/schema#");
    schema["title"] = json!("An experiment of jostle");
    schema["dependencies"] = dependencies();
    schema["if"] = json!({"anyOf": has(["grid", "points", "start"].into_iter())});
    schema["else"] = has_n();
    schema["definitions"] = Value::Object(definitions);
    schema
}

/// What a part of the file accepts in place of a number.
#[derive(Clone, Copy)]
enum Part {
    /// Nothing.
    Spec,
    /// A variable, or a ramp.
    Block,
}

impl Part {
    /// Returns the name that a type of the messages has among the definitions.
    fn name(self, of_message: &str) -> String {
        match self {
            Part::Spec => format!("spec.{of_message}"),
            Part::Block => format!("at.{of_message}"),
        }
    }

    /// Adds the schema of a message and what it refers to; returns a reference to it.
    fn add(self, message: &str, definitions: &mut Schemas) -> Value {
        let schema = contract::schema(message).map(|it| it.to_value());
        let schema = schema.unwrap_or_default();
        for (name, nested) in schema["$defs"].as_object().into_iter().flatten() {
            definitions.insert(self.name(name), self.converted(nested));
        }
        definitions.insert(self.name(message), self.converted(&schema));
        reference(&self.name(message))
    }

    /// Converts a schema of the messages, which is of draft 2020-12. TOML has no null.
    fn converted(self, schema: &Value) -> Value {
        let Value::Object(fields) = schema else {
            return schema.clone();
        };
        let all = |schemas: &Value| -> Vec<Value> {
            let schemas = schemas.as_array().into_iter().flatten();
            let schemas = schemas.filter(|schema| schema["type"] != "null");
            schemas.map(|schema| self.converted(schema)).collect()
        };
        let mut schema = Map::new();
        for (key, value) in fields {
            let value = match (key.as_str(), value) {
                (
                    "$schema" | "$defs" | "title" | "format" | "x-unit" | "x-changed-by"
                    | "x-range" | "x-usual",
                    _,
                )
                | ("default", Value::Null) => continue,
                ("properties", Value::Object(properties)) => {
                    let properties = properties.iter();
                    let properties = properties.map(|(key, it)| (key.clone(), self.converted(it)));
                    Value::Object(properties.collect())
                }
                ("items" | "additionalProperties", value) => self.converted(value),
                ("anyOf", value) if all(value).len() == 1 => {
                    schema.insert("allOf".to_owned(), json!(all(value)));
                    continue;
                }
                ("oneOf" | "anyOf" | "allOf", value) => json!(all(value)),
                ("type", Value::Array(types)) => {
                    let mut types = types.iter().filter(|kind| *kind != "null");
                    types.next().cloned().unwrap_or_default()
                }
                // In draft-07 nothing stands beside a reference.
                ("$ref", Value::String(place)) => {
                    let name = self.name(place.trim_start_matches("#/$defs/"));
                    schema.insert("allOf".to_owned(), json!([reference(&name)]));
                    continue;
                }
                (_, value) => value.clone(),
            };
            schema.insert(key.clone(), value);
        }
        if let Some(Value::String(text)) = schema.get_mut("description")
            && let Some(unit) = fields.get("x-unit").and_then(Value::as_str)
            && unit != "1"
        {
            *text += &format!(" Unit: {unit}.");
        }
        self.number(Value::Object(one_key(&schema).unwrap_or(schema)))
    }

    /// Adds what may stand in place of a number.
    fn number(self, schema: Value) -> Value {
        let in_place = match (self, schema["type"].as_str()) {
            (Part::Block, Some("number")) => InPlace::VariableOrRamp,
            (Part::Block, Some("integer")) => InPlace::Variable,
            _ => InPlace::Nothing,
        };
        or(schema, in_place)
    }
}

/// What stands in place of a number.
#[derive(Clone, Copy, PartialEq)]
enum InPlace {
    /// Nothing.
    Nothing,
    /// A variable.
    Variable,
    /// A variable or a ramp.
    VariableOrRamp,
}

/// Returns the schema of a number, or of what stands in its place. Each keyword is of one type, so an
/// editor names the one that a value violates, which it does not within `anyOf`; and it shows no
/// description beside `allOf`.
fn or(mut number: Value, in_place: InPlace) -> Value {
    if in_place == InPlace::Nothing {
        return number;
    }
    number["pattern"] = json!(format!(r"^\${VARIABLE}$"));
    let mut types = vec![number["type"].take(), json!("string")];
    if in_place == InPlace::VariableOrRamp {
        types.push(json!("object"));
        number["properties"] = json!({"ramp": reference("ramp")});
        number["required"] = json!(["ramp"]);
        number["additionalProperties"] = json!(false);
    }
    number["type"] = json!(types);
    number
}

/// Returns a choice of tables with one key each as one table with one of these keys; `None` if it is none.
fn one_key(schema: &Map<String, Value>) -> Option<Map<String, Value>> {
    let mut properties = Schemas::new();
    for variant in schema.get("oneOf")?.as_array()? {
        let required = variant["required"].as_array()?;
        let own = variant["properties"].as_object()?;
        let (Some((key, value)), 1, 1) = (own.iter().next(), own.len(), required.len()) else {
            return None;
        };
        let doc = variant["description"].as_str().unwrap_or_default();
        let value = match value["const"].is_null() {
            true => described(doc, value.clone()),
            false => return None,
        };
        properties.insert(key.clone(), value);
    }
    let mut one = table(&properties, &[]);
    one["minProperties"] = json!(1);
    one["maxProperties"] = json!(1);
    one["description"] = schema.get("description").cloned().unwrap_or_default();
    match one {
        Value::Object(one) => Some(one),
        _ => None,
    }
}

/// Returns the schema of `[spec]`: the fields of `create` but `seed`.
fn spec(definitions: &mut Schemas) -> Value {
    Part::Spec.add("create.args", definitions);
    // Only what the spec refers to: not `create` itself.
    definitions.remove(&Part::Spec.name("create.args"));
    let mut spec = definitions.remove(&Part::Spec.name("Spec"));
    let spec = spec.get_or_insert_default();
    spec["description"] = json!("What all runs share; a [[grid]] replaces its values.");
    spec["properties"]["n"]["maximum"] = json!(MAX_INDIVIDUALS);
    if let Some(fields) = spec.as_object_mut() {
        // A [[grid]] may give it.
        fields.remove("required");
    }
    if let Some(properties) = spec["properties"].as_object_mut() {
        properties.remove("seed");
    }
    spec.take()
}

/// Returns the schema of a `[[grid]]`.
fn grid(spec: &Value) -> Value {
    let mut properties = Schemas::new();
    for axis in AXES.iter().map(|it| it.name.as_str()) {
        let mut own = match axis {
            "informed" => json!({"type": "integer", "minimum": 0}),
            "informed_fraction" => {
                json!({"type": "number", "minimum": SHARES[0], "maximum": SHARES[1]})
            }
            _ => spec["properties"][axis].clone(),
        };
        let doc = own.as_object_mut().and_then(|it| it.remove("description"));
        let informed = INFORMED.iter().find(|(it, _)| *it == axis);
        let doc = doc.or(informed.map(|(_, doc)| json!(doc)));
        let doc = doc.as_ref().and_then(Value::as_str).unwrap_or_default();
        properties.insert(axis.to_owned(), described(doc, one_or_more(own)));
    }
    properties.insert(
        "replicates".to_owned(),
        described("Runs of each of its conditions.", whole(REPLICATES)),
    );
    let names: BTreeSet<String> = taken().filter(|it| Axis::of(it).is_none()).collect();
    let mut grid = table(&properties, &[]);
    let doc =
        "A variable, which an [[at]] or [stop] uses as \"$name\": a number or a list of numbers.";
    grid["additionalProperties"] = described(doc, one_or_more(json!({"type": "number"})));
    grid["propertyNames"] = json!({"pattern": format!("^{VARIABLE}$"), "not": {"enum": names}});
    grid["not"] = json!({"required": INFORMED.map(|(axis, _)| axis)});
    grid
}

/// Returns the schema of a value, or of a list of values.
fn one_or_more(value: Value) -> Value {
    let mut several = list(&value);
    several["minItems"] = json!(1);
    if value["type"].is_null() {
        return json!({"anyOf": [value, several]});
    }
    // As in `or`.
    let mut both = value.clone();
    both["type"] = json!([value["type"], "array"]);
    both["items"] = value;
    both["minItems"] = json!(1);
    both
}

/// Returns the schema of an `[[at]]`.
fn at(definitions: &mut Schemas) -> Value {
    let own = KEYS.iter().map(|key| key.name);
    let mut properties = keys(own);
    for verb in VERBS {
        let of_verb = SwarmVerb::of(verb).map(SwarmVerb::definition);
        let (args, doc) = of_verb.map_or(("", ""), |it| (it.args, it.doc));
        let one = Part::Block.add(args, definitions);
        if let Some(of_tables) = definitions[&Part::Block.name(args)].as_object_mut() {
            of_tables.remove("type");
        }
        // As in `or`.
        let either = json!({
            "type": ["object", "array"],
            "allOf": [one],
            "items": {"type": "object", "allOf": [one]},
            "maxItems": MAX_CHANGES,
        });
        let doc = format!("{doc} A list executes the verb several times.");
        properties.insert(verb.to_owned(), described(&doc, either));
    }
    let doc = "A block of the protocol: when it is executed, and its commands. A number may also be \"$name\", \
               the value of a variable of a [[grid]], and with `every` { ramp = [first, last] }.";
    let mut at = described(doc, table(&properties, &[]));
    at["dependencies"] = dependent()
        .map(|(key, timings)| (key.to_owned(), json!({"anyOf": has(timings.into_iter())})))
        .collect();
    // Not within `allOf`, beside which an editor completes no keys.
    at["oneOf"] = has(TIMINGS.iter().map(|(timing, _)| *timing));
    at["anyOf"] = has(VERBS.into_iter());
    at["if"] = json!({"required": ["every"]});
    at["else"] = reference("without_ramp");
    at
}

/// Returns the schema of `[stop]`.
fn stop() -> Value {
    let mut stop = table(&keys(STOP.into_iter()), &[]);
    let [when, from] = STOP;
    stop["dependencies"] = json!({from: [when]});
    stop
}

/// Returns the schemas of keys of a block.
fn keys(names: impl Iterator<Item = &'static str>) -> Schemas {
    let keys = names.filter_map(named).map(|key| {
        let value = match key.kind {
            Kind::Time => json!({"type": "number", "minimum": 0}),
            Kind::Interval => json!({"type": "number", "exclusiveMinimum": 0}),
            Kind::Whole => json!({"type": "integer", "minimum": 0}),
            Kind::Condition => json!({"type": "string"}),
        };
        let value = match key.kind {
            Kind::Condition => value,
            _ => or(value, InPlace::Variable),
        };
        (key.name.to_owned(), described(key.doc, value))
    });
    keys.collect()
}

/// Returns the schema of one of `columns`: a measure, with its argument.
fn column() -> Value {
    let pattern = |definition: &Definition| {
        let name = definition.name.replace('.', "\\.");
        let argument = r"\([\s\S]*\)";
        match definition.argument {
            None => name,
            Some(it) if it.default.is_some() => format!(r"{name}\s*({argument})?"),
            Some(_) => format!(r"{name}\s*{argument}"),
        }
    };
    let patterns: Vec<String> = definitions().iter().map(pattern).collect();
    // An editor completes the names of those whose argument may be left out.
    let complete = |it: &&Definition| it.argument.is_none_or(|it| it.default.is_some());
    let names = definitions().iter().filter(complete).map(|it| it.name);
    let doc =
        "A measure, such as `milling` or `msd(5)`: `jostle measures` lists all with their units.";
    let any = json!([
        {"enum": names.collect::<Vec<_>>()},
        {"pattern": format!(r"^\s*({})\s*$", patterns.join("|"))},
    ]);
    described(doc, json!({"type": "string", "anyOf": any}))
}

/// Returns the schema of the ends of a ramp.
fn ramp() -> Value {
    let mut ends = list(&or(json!({"type": "number"}), InPlace::Variable));
    ends["minItems"] = json!(2);
    ends["maxItems"] = json!(2);
    let doc =
        "With `every`: the first and the last value of a number that changes linearly in time.";
    described(doc, ends)
}

/// Returns the schema of what contains no ramp.
fn without_ramp() -> Value {
    let own = reference("without_ramp");
    json!({"properties": {"ramp": false}, "additionalProperties": own, "items": own})
}

/// The keys of a file, each with what it is and its schema. A test compares their names with those of the
/// parser.
fn file_keys() -> Vec<(&'static str, &'static str, Value)> {
    vec![
        (
            "name",
            "The experiment's name: lowercase letters, digits, '-' and '_', the first a letter or digit.",
            json!({"type": "string", "pattern": NAME_RULE}),
        ),
        (
            "duration",
            "The duration of a run, in time units: body sizes over free speed.",
            json!({"type": "number", "exclusiveMinimum": 0}),
        ),
        (
            "seed",
            "The seed from which the seeds of all runs are derived; 0 if left out.",
            whole(SEEDS),
        ),
        (
            "replicates",
            "Runs of each condition; 1 if left out. A `[[grid]]` may have its own.",
            whole(REPLICATES),
        ),
        (
            "seeds",
            "The seeds of the runs of each condition, instead of `replicates`.",
            json!({ "type": "array", "items": whole(SEEDS), "minItems": 1, "maxItems": MAX_RUNS, "uniqueItems": true }),
        ),
        (
            "spec",
            "What all runs share: the parameters of a swarm but `seed`.",
            reference("spec"),
        ),
        (
            "points",
            "The CSV of the conditions, instead of `[[grid]]`: its name, relative to the folder of this file.",
            json!({"type": "string"}),
        ),
        (
            "start",
            "The snapshot from which every run starts: its name, relative to the folder of this file.",
            json!({"type": "string"}),
        ),
        (
            "setpoints",
            "The CSV of the set-points of every run: its name, relative to the folder of this file, or its text.",
            json!({"type": "string"}),
        ),
        (
            "grid",
            "What varies: every combination of the values of a `[[grid]]` is a condition.",
            list(&reference("grid")),
        ),
        (
            "at",
            "The blocks of the protocol: commands at times, at steps, or when a condition holds.",
            json!({"type": "array", "items": reference("at"), "maxItems": MAX_BLOCKS}),
        ),
        (
            "stop",
            "What ends a run before its duration.",
            reference("stop"),
        ),
        (
            "measure",
            "Measurements in addition to the table of results.",
            reference("measure"),
        ),
    ]
}

/// The keys of `[measure]`.
fn measure_keys() -> Vec<(&'static str, &'static str, Value)> {
    vec![
        (
            "columns",
            "Measures whose means are columns of the table of results, such as `milling` or `msd(5)`.",
            json!({ "type": "array", "items": reference("column"), "maxItems": MAX_COLUMNS, "uniqueItems": true }),
        ),
        (
            "from",
            "The time from which these are measured, in time units; 0 if left out.",
            json!({"type": "number", "minimum": 0}),
        ),
        (
            "every",
            "Steps between two measurements of these; 1 if left out.",
            whole(STEPS_BETWEEN),
        ),
        (
            "order_every",
            "Steps between two entries of the order's time series; no series if left out.",
            whole(STEPS_BETWEEN),
        ),
        (
            "series_every",
            "Steps between two entries of the time series of `columns`; no series if left out.",
            whole(STEPS_BETWEEN),
        ),
        (
            "record_every",
            "Steps between two frames of the trajectories; no trajectories if left out.",
            whole(STEPS_BETWEEN),
        ),
        (
            "touch",
            "Whether contacts are measured, in a table of their own; not with `[[at]]`.",
            json!({"type": "boolean"}),
        ),
    ]
}

/// Returns the schema of a table with these keys and no others.
fn of_keys(keys: Vec<(&str, &str, Value)>, required: &[&str]) -> Value {
    let keys = keys.into_iter();
    let properties = keys.map(|(key, doc, schema)| (key.to_owned(), described(doc, schema)));
    table(&properties.collect(), required)
}

/// Returns the schema of `[measure]`.
fn measure() -> Value {
    let mut measure = of_keys(measure_keys(), &[]);
    measure["dependencies"] = json!({
        "series_every": {"required": ["columns"], "properties": {"columns": {"minItems": 1}}},
    });
    measure
}

/// Returns the schema of a file whose `[spec]` has `n`.
fn has_n() -> Value {
    json!({"required": ["spec"], "properties": {"spec": {"required": ["n"]}}})
}

/// Returns what a key of the file requires and excludes.
fn dependencies() -> Value {
    let fixed = FIXED.map(|axis| (axis.to_owned(), json!(false)));
    let fixed = Value::Object(fixed.into_iter().collect());
    let touch = json!({"required": ["touch"], "properties": {"touch": {"const": true}}});
    json!({
        "grid": {
            "if": {"anyOf": [{"required": ["start"]}, has_n()]},
            "else": {"properties": {"grid": {"items": {"required": ["n"]}}}},
        },
        "measure": {
            "if": {"properties": {"measure": touch}},
            "then": {"properties": {"at": {"maxItems": 0}}},
        },
        "points": {"properties": {"grid": {"maxItems": 0}}},
        "seeds": {"properties": {
            "replicates": false,
            "grid": {"items": {"properties": {"replicates": false}}},
        }},
        "start": {"properties": {
            "grid": {"items": {"properties": fixed}},
            "spec": {"properties": {"start": false}},
        }},
    })
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
pub mod tests;
