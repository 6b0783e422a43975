//! Variables: keys of a `[[grid]]` whose values the protocol uses, as `"$name"`.

use std::collections::BTreeSet;

use toml::Value;

use crate::file::{Table, is_of_name};

/// The values of the variables of one condition of a plan, by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Variables(pub Vec<(String, Value)>);

impl Variables {
    /// Returns the value of a variable.
    pub fn value(&self, name: &str) -> Option<&Value> {
        let Self(values) = self;
        values.iter().find(|(it, _)| it == name).map(|(_, it)| it)
    }

    /// Returns the value of a variable as a number.
    pub fn number(&self, name: &str) -> Option<f64> {
        match self.value(name)? {
            Value::Integer(number) => Some(*number as f64),
            Value::Float(number) => Some(*number),
            _ => None,
        }
    }

    /// Returns `value` with every `"$name"` in it replaced.
    ///
    /// # Errors
    ///
    /// The text of the first variable without a value.
    pub fn replace(&self, value: &Value) -> Result<Value, String> {
        Ok(match value {
            Value::String(text) => match text.strip_prefix('$') {
                Some(name) => self.value(name).cloned().ok_or_else(|| text.clone())?,
                None => value.clone(),
            },
            Value::Array(items) => {
                let items: Result<_, _> = items.iter().map(|item| self.replace(item)).collect();
                Value::Array(items?)
            }
            Value::Table(entries) => {
                let entries: Result<toml::Table, String> = entries
                    .iter()
                    .map(|(key, value)| Ok((key.clone(), self.replace(value)?)))
                    .collect();
                Value::Table(entries?)
            }
            _ => value.clone(),
        })
    }
}

/// Returns the names of all variables that tables use.
pub fn used<'a>(tables: impl Iterator<Item = &'a Table>) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for value in tables.flat_map(|table| table.values()) {
        collect(value.get_ref(), &mut names);
    }
    names
}

fn collect(value: &Value, names: &mut BTreeSet<String>) {
    match value {
        // A condition can contain several.
        Value::String(text) => names.extend(text.split('$').skip(1).map(|rest| {
            let name = rest.chars().take_while(|&it| is_of_name(it));
            name.collect::<String>()
        })),
        Value::Array(items) => items.iter().for_each(|item| collect(item, names)),
        Value::Table(entries) => entries.values().for_each(|item| collect(item, names)),
        _ => {}
    }
}
