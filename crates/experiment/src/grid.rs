//! What varies: axes with their values, and every choice of one value from each.

use std::ops::Range;

use jostle_physics::model::selection::share;
use jostle_proto::Spec;
use toml::{Spanned, Value};

use crate::error::PlanError;
use crate::file::{Source, Table};

/// What a `[[grid]]` may vary, in the order in which names of runs tell it.
pub const AXES: [&str; 13] = [
    "pi1",
    "pi2",
    "pi3",
    "pi4",
    "n",
    "informed",
    "informed_fraction",
    "contacts",
    "dt",
    "stepping",
    "relinearise",
    "attraction",
    "noise",
];

/// One `[[grid]]`.
pub struct Grid {
    /// Its axes, in the order of [`AXES`], each with its values.
    pub axes: Vec<(&'static str, Vec<Spanned<Value>>)>,
    /// Runs at each of its points.
    pub replicates: u64,
    /// Where it begins in the file.
    pub place: Range<usize>,
}

/// One value from each axis of a grid, and what they make of `[spec]`.
pub struct Choice {
    /// The swarm, its seed aside.
    pub spec: Spec,
    /// How many individuals are informed.
    pub informed: usize,
    values: Vec<(&'static str, Value)>,
}

/// Checks `[spec]`: it holds what `create` knows, but for what an experiment sets itself.
///
/// # Errors
///
/// [`PlanError::Field`].
pub fn common(source: Source<'_>, spec: &Table) -> Result<toml::Table, PlanError> {
    for (key, value) in spec {
        if key.get_ref() == "seed" {
            let reason = "the seeds of an experiment's runs come from its own seed: move it up";
            return Err(source.refuse(&key.span(), reason));
        }
        check(source, key.get_ref(), value)?;
    }
    let entries = spec.iter();
    Ok(entries
        .map(|(key, value)| (key.get_ref().clone(), value.get_ref().clone()))
        .collect())
}

/// Reads every `[[grid]]`; without one there is a single point.
///
/// # Errors
///
/// [`PlanError::Field`].
pub fn grids(
    source: Source<'_>,
    tables: &[Table],
    replicates: u64,
    most: u64,
) -> Result<Vec<Grid>, PlanError> {
    if tables.is_empty() {
        return Ok(vec![Grid {
            axes: Vec::new(),
            replicates,
            place: 0..0,
        }]);
    }
    let read = |table| read_grid(source, table, replicates, most);
    tables.iter().map(read).collect()
}

fn read_grid(
    source: Source<'_>,
    table: &Table,
    replicates: u64,
    most: u64,
) -> Result<Grid, PlanError> {
    let places = table.keys().map(Spanned::span);
    let mut grid = Grid {
        axes: Vec::new(),
        replicates,
        place: places.min_by_key(|place| place.start).unwrap_or(0..0),
    };
    for (key, value) in table {
        let key_place = key.span();
        let key = key.get_ref().as_str();
        if key == "replicates" {
            let number = value.get_ref().as_integer();
            let number = number.and_then(|number| u64::try_from(number).ok());
            let number = Spanned::new(value.span(), number.unwrap_or(0));
            grid.replicates = source.whole(key, Some(&number), 0, [1, most])?;
            continue;
        }
        let Some(axis) = AXES.into_iter().find(|axis| *axis == key) else {
            let axes = AXES.join(", ");
            let reason = format!("{key} is no axis: those are {axes}, and replicates");
            return Err(source.refuse(&key_place, reason));
        };
        let values = match value.get_ref() {
            Value::Array(values) if values.is_empty() => {
                return Err(source.refuse(&value.span(), format!("{key} has no value")));
            }
            Value::Array(values) => {
                let values = values.iter().cloned();
                values.map(|it| Spanned::new(value.span(), it)).collect()
            }
            _ => vec![value.clone()],
        };
        for value in &values {
            check(source, axis, value)?;
        }
        grid.axes.push((axis, values));
    }
    grid.axes
        .sort_by_key(|(axis, _)| AXES.iter().position(|it| it == axis));
    let both = ["informed", "informed_fraction"].map(|axis| grid.has(axis));
    if both == [true, true] {
        let reason = "informed and informed_fraction are one thing: leave out one of them";
        return Err(source.refuse(&grid.place, reason));
    }
    Ok(grid)
}

/// Checks one value by itself: whether it is of a kind that the key may have.
fn check(source: Source<'_>, key: &str, value: &Spanned<Value>) -> Result<(), PlanError> {
    let refuse = |reason: String| Err(source.refuse(&value.span(), reason));
    match (key, value.get_ref()) {
        ("informed", Value::Integer(count)) if *count >= 0 => return Ok(()),
        ("informed", _) => return refuse("informed is a number of individuals".to_owned()),
        ("informed_fraction", it) => {
            return match number(it) {
                Some(fraction) if (0.0..=1.0).contains(&fraction) => Ok(()),
                _ => refuse("informed_fraction is a share of n, within [0, 1]".to_owned()),
            };
        }
        _ => {}
    }
    let mut table = toml::Table::new();
    table.insert("n".to_owned(), Value::Integer(1));
    table.insert(key.to_owned(), value.get_ref().clone());
    match table.try_into::<Spec>() {
        Ok(_) => Ok(()),
        Err(error) => refuse(format!("{key}: {}", error.message())),
    }
}

fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Integer(number) => Some(*number as f64),
        Value::Float(number) => Some(*number),
        _ => None,
    }
}

impl Grid {
    /// Whether it varies or sets `axis`.
    pub fn has(&self, axis: &str) -> bool {
        self.axes.iter().any(|(it, _)| *it == axis)
    }

    /// How many points it has; none if they cannot be counted.
    pub fn size(&self) -> Option<u64> {
        let mut lengths = self.axes.iter().map(|(_, values)| values.len() as u64);
        lengths.try_fold(1u64, u64::checked_mul)
    }

    /// Its choice number `index`, the last axis varying fastest.
    ///
    /// # Errors
    ///
    /// [`PlanError::Field`] when the values do not go together.
    pub fn choice(
        &self,
        source: Source<'_>,
        common: &toml::Table,
        mut index: usize,
    ) -> Result<Choice, PlanError> {
        let mut values = Vec::with_capacity(self.axes.len());
        for (axis, listed) in self.axes.iter().rev() {
            values.push((*axis, listed[index % listed.len()].clone()));
            index /= listed.len();
        }
        values.reverse();
        let (mut table, mut told) = (common.clone(), None);
        for (axis, value) in &values {
            if axis.starts_with("informed") {
                told = Some((*axis, value));
            } else {
                table.insert((*axis).to_owned(), value.get_ref().clone());
            }
        }
        if !table.contains_key("n") {
            let reason = "n is given neither by [spec] nor by this grid";
            return Err(source.refuse(&self.place, reason));
        }
        let spec: Spec = table.try_into().map_err(|error: toml::de::Error| {
            source.refuse(&self.place, error.message().to_owned())
        })?;
        let informed = match told {
            Some((axis, told)) => count_informed(&spec, axis, told.get_ref())
                .map_err(|reason| source.refuse(&told.span(), reason))?,
            None => 0,
        };
        let values = values.into_iter();
        Ok(Choice {
            spec,
            informed,
            values: values
                .map(|(axis, value)| (axis, value.into_inner()))
                .collect(),
        })
    }
}

/// How many are informed, told as a count or a share.
///
/// A share that rounds to nobody is refused: whoever asks for a tenth of three and gets none
/// would compare runs with leaders to runs without.
fn count_informed(spec: &Spec, axis: &str, told: &Value) -> Result<usize, String> {
    let told = number(told).unwrap_or_default();
    if axis == "informed" && told > spec.n as f64 {
        return Err(format!("informed = {told} is more than n = {}", spec.n));
    }
    let fraction = match axis {
        "informed" => told / spec.n as f64,
        _ => told,
    };
    let n = usize::try_from(spec.n).unwrap_or(usize::MAX);
    let count = share(n, fraction).map_err(|error| error.to_string())?;
    if count == 0 && told > 0.0 {
        return Err(format!(
            "{axis} = {told} of n = {n} is nobody: leave out this n, or give it a [[grid]] of its \
             own"
        ));
    }
    if count > 0 && spec.pi2 == 0.0 {
        return Err("nobody is informed by a weight of 0: set pi2 above 0".to_owned());
    }
    Ok(count)
}

impl Choice {
    /// Names it by what `varied` lists: `pi1=4 n=50`, and the same however 4 was written.
    pub fn name(&self, varied: &[&'static str]) -> String {
        let spec = toml::Table::try_from(&self.spec).unwrap_or_default();
        let own = |axis| self.values.iter().find(|(it, _)| *it == axis);
        let tell = |axis: &&'static str| {
            let value = match *axis {
                // Who does not say it one way may have said it the other.
                "informed" | "informed_fraction" => &own(*axis)?.1,
                _ => spec.get(*axis)?,
            };
            Some(format!("{axis}={}", show(value)))
        };
        let told: Vec<String> = varied.iter().filter_map(tell).collect();
        told.join(" ")
    }
}

fn show(value: &Value) -> String {
    match value {
        Value::Float(number) => number.to_string(),
        Value::String(text) => text.clone(),
        Value::Table(table) => {
            let kind = table.get("kind").map(show).unwrap_or_default();
            let others = table.iter().filter(|(key, _)| *key != "kind");
            others.fold(kind, |told, (_, value)| format!("{told}:{}", show(value)))
        }
        other => other.to_string(),
    }
}
