//! The arguments of a verb in a block, and the ramps in them.

use jostle_convert::change;
use jostle_physics::simulation::Change;
use jostle_proto::verbs;
use serde::Deserialize as _;
use toml::Value;

use crate::file::in_words;

/// A part of the time of a block that counts as rounding.
pub(super) const ROUNDING: f64 = 1e-9;

/// Converts a verb with its arguments.
pub fn to_change(verb: &str, args: &Value) -> Result<Change, String> {
    let mut table = toml::Table::new();
    table.insert("verb".to_owned(), Value::String(verb.to_owned()));
    table.insert("args".to_owned(), args.clone());
    let message: verbs::Change =
        Value::Table(table)
            .try_into()
            .map_err(|error: toml::de::Error| {
                let select = args.get("select").and_then(Value::as_table);
                match select.filter(|it| it.len() != 1).and(selectors()) {
                    Some(selectors) => format!("{verb}: select has {selectors}"),
                    None => format!("{verb}: {}", in_words(error.message())),
                }
            })?;
    change::change(message).map_err(|error| format!("{verb}: {error}"))
}

/// Returns the selectors as the error of an unknown one lists them: `one of …`.
fn selectors() -> Option<String> {
    let error = verbs::Select::deserialize(Value::String(String::new())).err()?;
    let (_, selectors) = error.message().split_once(", expected ")?;
    Some(selectors.trim_end().to_owned())
}

/// Returns the ends of a ramp, `{ ramp = [from, to] }`; none if the value is no ramp. The error is
/// the reason if it is malformed.
fn ramp(value: &Value) -> Option<Result<[f64; 2], String>> {
    let table = value.as_table()?;
    let ends = table.get("ramp")?;
    let number = |value: &Value| match value {
        Value::Integer(number) => Some(*number as f64),
        Value::Float(number) => Some(*number).filter(|number| number.is_finite()),
        _ => None,
    };
    let ends = ends.as_array().map(Vec::as_slice);
    Some(match (table.len(), ends) {
        (1, Some([from, to])) => match (number(from), number(to)) {
            (Some(from), Some(to)) => Ok([from, to]),
            _ => Err("a ramp is between two numbers".to_owned()),
        },
        _ => Err("give a ramp as { ramp = [first, last] }".to_owned()),
    })
}

pub fn has_ramp(value: &Value) -> bool {
    match value {
        Value::Table(table) => ramp(value).is_some() || table.values().any(has_ramp),
        Value::Array(items) => items.iter().any(has_ramp),
        _ => false,
    }
}

/// Checks the ramps of a value. The error is a text in the value, and the reason.
pub fn check_ramps(value: &Value, is_repeated: bool) -> Result<(), (String, String)> {
    let error = |reason: String| ("ramp".to_owned(), reason);
    match ramp(value) {
        Some(Err(reason)) => return Err(error(reason)),
        Some(Ok(_)) if !is_repeated => {
            let reason =
                "a ramp requires every: add the time between two executions, such as every = 5"
                    .to_owned();
            return Err(error(reason));
        }
        Some(Ok(_)) => return Ok(()),
        None => {}
    }
    match value {
        Value::Table(table) => table
            .values()
            .try_for_each(|it| check_ramps(it, is_repeated)),
        Value::Array(items) => items.iter().try_for_each(|it| check_ramps(it, is_repeated)),
        _ => Ok(()),
    }
}

/// Returns `value` with every ramp replaced by its number at this share of its time.
pub fn at_share(value: &Value, share: f64) -> Value {
    if let Some(Ok([from, to])) = ramp(value) {
        // Exact at both ends.
        return Value::Float(match share >= 1.0 - ROUNDING {
            true => to,
            false => from + (to - from) * share,
        });
    }
    match value {
        Value::Table(table) => {
            let entries = table.iter();
            Value::Table(
                entries
                    .map(|(key, it)| (key.clone(), at_share(it, share)))
                    .collect(),
            )
        }
        Value::Array(items) => Value::Array(items.iter().map(|it| at_share(it, share)).collect()),
        _ => value.clone(),
    }
}
