//! Grids of varied values: axes with their values, and the choices of one value from each axis.

use std::collections::BTreeSet;
use std::ops::Range;

use jostle_measures::definitions;
use jostle_physics::model::selection::share;
use jostle_physics::simulation::ChangeError;
use jostle_proto::{AXES, Axis, Spec};
use jostle_results::{COLUMNS, FAULT, OCCASIONAL_COLUMNS};
use toml::{Spanned, Value};

use crate::error::PlanError;
use crate::file::{Source, Table, in_words, is_of_name};
use crate::limits::REPLICATES;
use crate::protocol::Variables;
use crate::start::{Base, FIXED};

/// What the axes are that are not fields of a spec.
pub const INFORMED: [(&str, &str); 2] = [
    (
        "informed",
        "How many individuals are informed, from the start: a whole number up to `n`.",
    ),
    (
        "informed_fraction",
        "The share of the individuals that are informed, from the start: 0 to 1. `informed_fraction * n` is \
         rounded, halves upwards.",
    ),
];

/// The range of `informed_fraction`.
pub const SHARES: [f64; 2] = [0.0, 1.0];

/// One `[[grid]]`.
pub struct Grid {
    /// Its axes, in the order of [`AXES`], and then its variables by name.
    pub axes: Vec<Varied>,
    /// Runs at each of its points.
    pub replicates: u64,
    /// The span of its first key in the file.
    pub span: Range<usize>,
}

/// Where the name of a run has a varied value.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Place {
    /// An axis, by its index in [`AXES`].
    Axis(usize),
    /// A variable: after the axes, by name.
    Variable,
}

/// An axis or a variable of a grid.
pub struct Varied {
    name: String,
    place: Place,
    values: Vec<Spanned<Value>>,
}

/// One value from each axis of a grid, and `[spec]` with these values.
pub struct Choice {
    /// The spec of the swarm, except for its seed.
    pub spec: Spec,
    /// How many individuals are informed.
    pub informed: usize,
    /// The values of the variables.
    pub variables: Variables,
    values: Vec<(String, Value)>,
}

/// Checks `[spec]` and returns its entries. It may contain the fields of `create` except `seed`.
///
/// # Errors
///
/// [`PlanError::Field`] for an unknown field or a value of a wrong kind.
pub fn common(
    source: Source<'_>,
    spec: &Table,
    base: Option<&Base>,
) -> Result<toml::Table, PlanError> {
    let mut fields = base.map(Base::fields).unwrap_or_default();
    for (key, value) in spec {
        if key.get_ref() == "seed" {
            let reason = "seed is not a field of [spec]: move it to the top of the file";
            return Err(source.reject(&key.span(), reason));
        }
        if INFORMED.iter().any(|(axis, _)| axis == key.get_ref()) {
            let key_text = key.get_ref();
            let reason = format!(
                "{key_text} is not a field of [spec]: write it in a [[grid]], as {key_text} = {}",
                value.get_ref()
            );
            return Err(source.reject(&key.span(), &reason));
        }
        check(source, key.get_ref(), value)?;
        let given = (key.get_ref().clone(), value.get_ref().clone());
        if base.is_some()
            && let Some(reason) = contradiction(&fields, &given)
        {
            return Err(source.reject(&value.span(), reason));
        }
        fields.extend([given]);
    }
    Ok(fields)
}

/// Returns why a field of `[spec]` contradicts the fields of a snapshot; none if it does not.
fn contradiction(fields: &toml::Table, (key, value): &(String, Value)) -> Option<String> {
    if key == "start" {
        return Some("start is that of the snapshot: leave it out".to_owned());
    }
    let own = fields.get(key).and_then(number);
    match FIXED.contains(&key.as_str()) && own != number(value) {
        true => Some(format!(
            "{key} = {value} contradicts the snapshot, whose {key} is {}: leave it out",
            own.unwrap_or_default()
        )),
        false => None,
    }
}

/// Checks that grids vary no axis that a snapshot determines.
///
/// # Errors
///
/// [`PlanError`] at the values of such an axis.
pub fn check_varied(source: Source<'_>, grids: &[Grid]) -> Result<(), PlanError> {
    for grid in grids {
        for axis in FIXED {
            if grid.has(axis) {
                let reason = format!("the snapshot of start determines {axis}: leave it out");
                return Err(source.reject(&grid.span_of(axis), reason));
            }
        }
    }
    Ok(())
}

/// Reads every `[[grid]]`. A file without a grid has one grid with a single point. `used` are the
/// variables that the protocol uses.
///
/// # Errors
///
/// [`PlanError::Field`].
pub fn grids(
    source: Source<'_>,
    tables: &[Table],
    used: &BTreeSet<String>,
    replicates: u64,
) -> Result<Vec<Grid>, PlanError> {
    if tables.is_empty() {
        return Ok(vec![Grid {
            axes: Vec::new(),
            replicates,
            span: 0..0,
        }]);
    }
    let read = |table| read_grid(source, table, used, replicates);
    tables.iter().map(read).collect()
}

fn read_grid(
    source: Source<'_>,
    table: &Table,
    used: &BTreeSet<String>,
    replicates: u64,
) -> Result<Grid, PlanError> {
    let spans = table.keys().map(Spanned::span);
    let mut grid = Grid {
        axes: Vec::new(),
        replicates,
        span: spans.min_by_key(|span| span.start).unwrap_or(0..0),
    };
    for (key, value) in table {
        let key_span = key.span();
        let key = key.get_ref().as_str();
        if key == "replicates" {
            let number = value.get_ref().as_integer();
            let number = number.and_then(|number| u64::try_from(number).ok());
            let number = Spanned::new(value.span(), number.unwrap_or(0));
            grid.replicates = source.whole(key, Some(&number), 0, REPLICATES)?;
            continue;
        }
        let place = check_axis(source, key, &key_span, used)?;
        let values = match value.get_ref() {
            Value::Array(values) if values.is_empty() => {
                return Err(source.reject(&value.span(), format!("{key} has no value")));
            }
            Value::Array(values) => {
                let values = values.iter().cloned();
                values.map(|it| Spanned::new(value.span(), it)).collect()
            }
            _ => vec![value.clone()],
        };
        check_zeros(source, key, &values)?;
        grid.add(source, (key, place), values)?;
    }
    grid.finished(source)
}

/// Returns the names of the axes, as a list in a message.
pub fn axes() -> String {
    let names: Vec<&str> = AXES.iter().map(|it| it.name.as_str()).collect();
    names.join(", ")
}

/// Returns the place of a name.
///
/// No axis is used as `$name`. In a stored experiment a later axis of which the name is used so is
/// therefore a variable of an earlier version.
fn place(axes: &[Axis], source: Source<'_>, name: &str, used: &BTreeSet<String>) -> Place {
    let index = axes.iter().position(|it| it.name == name);
    match index.filter(|&it| !(axes[it].is_later && source.is_stored && used.contains(name))) {
        Some(index) => Place::Axis(index),
        None => Place::Variable,
    }
}

/// Checks the name of an axis or a variable, and returns its place.
///
/// # Errors
///
/// [`PlanError`] at `span`.
pub fn check_axis(
    source: Source<'_>,
    key: &str,
    span: &Range<usize>,
    used: &BTreeSet<String>,
) -> Result<Place, PlanError> {
    let place = place(&AXES, source, key, used);
    let reason = if place != Place::Variable {
        return Ok(place);
    } else if !(key.starts_with(char::is_alphabetic) && key.chars().all(is_of_name)) {
        format!("invalid name {key:?} of a variable: use letters, digits and '_'")
    } else if !used.contains(key) {
        let axes = axes();
        format!(
            "unknown axis {key:?}: use one of {axes}, replicates, or a variable that an [[at]] or \
             [stop] uses as \"${key}\""
        )
    } else if taken().any(|name| name == key) && !(source.is_stored && is_later_taken(key)) {
        format!(
            "{key:?} is a column of the results, a measure or a field of [spec]: rename the variable"
        )
    } else {
        return Ok(place);
    };
    Err(source.reject(span, reason))
}

/// Checks one value by itself: its kind, and for the informed individuals its range.
fn check(source: Source<'_>, key: &str, value: &Spanned<Value>) -> Result<(), PlanError> {
    let reject = |reason: String| Err(source.reject(&value.span(), reason));
    match (key, value.get_ref()) {
        ("informed", Value::Integer(count)) if *count >= 0 => return Ok(()),
        ("informed", _) => return reject("informed must be a whole number, 0 or more".to_owned()),
        ("informed_fraction", it) => {
            return match number(it) {
                Some(fraction) if (SHARES[0]..=SHARES[1]).contains(&fraction) => Ok(()),
                _ => reject("informed_fraction must be a number within [0, 1]".to_owned()),
            };
        }
        _ => {}
    }
    let mut table = toml::Table::new();
    table.insert("n".to_owned(), Value::Integer(1));
    table.insert(key.to_owned(), value.get_ref().clone());
    match table.try_into::<Spec>() {
        Ok(_) => Ok(()),
        Err(error) => reject(format!("{key}: {}", in_words(error.message()))),
    }
}

/// Names that variables could have in earlier versions: columns of faults, of series and trajectories,
/// and of the printed table.
const LATER_TAKEN: [&str; 7] = [FAULT, "step", "id", "x", "y", "alpha", "runs"];

fn is_later_taken(name: &str) -> bool {
    LATER_TAKEN.contains(&name) || Axis::of(name).is_some_and(|it| it.is_later)
}

/// Returns the names that a variable must not have: those of fields, columns and measures.
pub fn taken() -> impl Iterator<Item = String> {
    let fields = toml::Table::try_from(Spec::new(1)).unwrap_or_default();
    let columns = COLUMNS.iter().map(|column| column.name);
    let measures = definitions().iter().map(|measure| measure.name);
    let others = LATER_TAKEN.into_iter().chain(["rate", "start"]);
    let others = others.chain(OCCASIONAL_COLUMNS).chain(columns);
    let names = others.chain(measures).map(str::to_owned);
    fields.into_iter().map(|(name, _)| name).chain(names)
}

/// Checks the value of a variable: a finite number.
fn check_variable(source: Source<'_>, key: &str, value: &Spanned<Value>) -> Result<(), PlanError> {
    match number(value.get_ref()) {
        Some(number) if number.is_finite() => Ok(()),
        _ => Err(source.reject(&value.span(), format!("{key}: a variable is a number"))),
    }
}

/// Rejects -0, which would be a condition beside that of 0, and was one in earlier versions.
fn check_zeros(source: Source<'_>, key: &str, values: &[Spanned<Value>]) -> Result<(), PlanError> {
    let is_negative_zero = |value: &Value| {
        let number = value.as_float();
        number.is_some_and(|it| it == 0.0 && it.is_sign_negative())
    };
    let mut values = values.iter();
    match values.find(|it| is_negative_zero(it.get_ref())) {
        Some(value) if !source.is_stored => {
            Err(source.reject(&value.span(), format!("{key}: write 0 for -0")))
        }
        _ => Ok(()),
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
    /// Adds the values of an axis or a variable, each of which is checked by itself.
    ///
    /// # Errors
    ///
    /// [`PlanError`] at the first value that is wrong.
    pub fn add(
        &mut self,
        source: Source<'_>,
        (name, place): (&str, Place),
        values: Vec<Spanned<Value>>,
    ) -> Result<(), PlanError> {
        for value in &values {
            match place {
                Place::Axis(_) => check(source, name, value)?,
                Place::Variable => check_variable(source, name, value)?,
            }
        }
        let name = name.to_owned();
        self.axes.push(Varied {
            name,
            place,
            values,
        });
        Ok(())
    }

    /// Returns the grid with its axes sorted.
    ///
    /// # Errors
    ///
    /// [`PlanError`] if two axes exclude each other.
    pub fn finished(mut self, source: Source<'_>) -> Result<Self, PlanError> {
        self.axes.sort_by_key(|it| (it.place, it.name.clone()));
        let both = ["informed", "informed_fraction"].map(|axis| self.has(axis));
        if both == [true, true] {
            let reason = "informed and informed_fraction exclude each other: leave out one of them";
            return Err(source.reject(&self.span, reason));
        }
        Ok(self)
    }

    /// Returns the span of the values of an axis, or that of the grid if it has none.
    pub fn span_of(&self, axis: &str) -> Range<usize> {
        let found = self.axes.iter().find(|it| it.name == axis);
        found.map_or(self.span.clone(), |it| it.values[0].span())
    }

    /// Returns whether the grid has values for `axis`.
    pub fn has(&self, axis: &str) -> bool {
        self.axes.iter().any(|it| it.name == axis)
    }

    /// Returns its axes and variables.
    pub fn names(&self) -> impl Iterator<Item = (Place, &str)> {
        self.axes.iter().map(|it| (it.place, it.name.as_str()))
    }

    /// Returns the number of points; none if it exceeds a `u64`.
    pub fn size(&self) -> Option<u64> {
        let mut lengths = self.axes.iter().map(|it| it.values.len() as u64);
        lengths.try_fold(1u64, u64::checked_mul)
    }

    /// Returns the choice with number `index`; the last axis varies fastest.
    ///
    /// # Errors
    ///
    /// [`PlanError::Field`] if the values are invalid together.
    pub fn choice(
        &self,
        source: Source<'_>,
        common: &toml::Table,
        mut index: usize,
    ) -> Result<Choice, PlanError> {
        let mut values = Vec::with_capacity(self.axes.len());
        for axis in self.axes.iter().rev() {
            let listed = &axis.values;
            values.push((axis, listed[index % listed.len()].clone()));
            index /= listed.len();
        }
        values.reverse();
        let (mut table, mut given) = (common.clone(), None);
        let mut variables = Variables::default();
        for (axis, value) in &values {
            let name = axis.name.clone();
            if axis.place == Place::Variable {
                variables.0.push((name, value.get_ref().clone()));
            } else if name.starts_with("informed") {
                given = Some((axis.name.as_str(), value));
            } else {
                table.insert(name, value.get_ref().clone());
            }
        }
        if !table.contains_key("n") {
            let reason = "n is given neither by [spec] nor here: give n";
            return Err(source.reject(&self.span, reason));
        }
        let spec: Spec = table.try_into().map_err(|error: toml::de::Error| {
            source.reject(&self.span, in_words(error.message()))
        })?;
        let informed = match given {
            Some((axis, value)) => count_informed(&spec, axis, value.get_ref())
                .map_err(|reason| source.reject(&value.span(), reason))?,
            None => 0,
        };
        let values = values.into_iter();
        Ok(Choice {
            spec,
            informed,
            variables,
            values: values
                .map(|(axis, value)| (axis.name.clone(), value.into_inner()))
                .collect(),
        })
    }
}

/// Returns the number of informed individuals; `axis` says whether `value` is a count or a
/// fraction.
///
/// A fraction above 0 that rounds to no individual is rejected: otherwise a grid would compare runs
/// with informed individuals with runs without.
fn count_informed(spec: &Spec, axis: &str, value: &Value) -> Result<usize, String> {
    let given = number(value).unwrap_or_default();
    if axis == "informed" && given > spec.n as f64 {
        return Err(format!("informed = {given} is more than n = {}", spec.n));
    }
    let fraction = match axis {
        "informed" => given / spec.n as f64,
        _ => given,
    };
    let n = usize::try_from(spec.n).unwrap_or(usize::MAX);
    let count = share(n, fraction).map_err(|error| error.to_string())?;
    if count == 0 && given > 0.0 {
        return Err(format!(
            "{axis} = {given} of n = {n} selects no individual: leave out this n, or give it a \
             [[grid]] of its own"
        ));
    }
    if count > 0 && spec.pi2 == 0.0 {
        return Err(ChangeError::Weightless.to_string());
    }
    Ok(count)
}

impl Choice {
    /// Returns its name, which lists the values of the axes and variables in `varied`: `pi1=4 n=50`.
    /// The name does not depend on the notation of a number, such as 4 or 4.0.
    pub fn name(&self, varied: &BTreeSet<(Place, &str)>) -> String {
        let spec = toml::Table::try_from(&self.spec).unwrap_or_default();
        let own = |axis: &str| self.values.iter().find(|(it, _)| it == axis);
        let entry = |(place, name): &(Place, &str)| {
            let value = match place {
                Place::Axis(_) => spec.get(*name),
                Place::Variable => None,
            };
            // A grid can lack a variable, and how many are informed.
            let value = value.or_else(|| Some(&own(name)?.1))?;
            Some(format!("{name}={}", show(value)))
        };
        let entries: Vec<String> = varied.iter().filter_map(entry).collect();
        entries.join(" ")
    }
}

fn show(value: &Value) -> String {
    match value {
        Value::Float(number) => number.to_string(),
        Value::String(text) => text.clone(),
        Value::Table(table) => {
            let kind = table.get("kind").map(show).unwrap_or_default();
            let others = table.iter().filter(|(key, _)| *key != "kind");
            others.fold(kind, |text, (_, value)| format!("{text}:{}", show(value)))
        }
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    const STORED: Source<'_> = Source {
        toml: "",
        points: None,
        is_stored: true,
    };

    #[test]
    fn a_variable_of_a_stored_experiment_stays_one_beside_a_later_axis_of_its_name() {
        let axes = [("pi3", false), ("later", true)].map(|(name, is_later)| Axis {
            name: name.to_owned(),
            is_text: false,
            is_later,
        });
        let both = BTreeSet::from(["pi3", "later"].map(str::to_owned));
        let new = Source {
            is_stored: false,
            ..STORED
        };
        for (source, name, used, expected) in [
            (STORED, "later", &both, Place::Variable),
            (STORED, "later", &BTreeSet::new(), Place::Axis(1)),
            (new, "later", &both, Place::Axis(1)),
            (STORED, "pi3", &both, Place::Axis(0)),
            (STORED, "other", &both, Place::Variable),
        ] {
            assert!(place(&axes, source, name, used) == expected, "{name}");
        }
    }

    #[test]
    fn a_variable_with_the_name_of_a_field_changes_no_spec_and_names_its_runs() {
        let values = [0.25, 0.5].map(|it| Spanned::new(0..0, Value::Float(it)));
        let mut grid = Grid {
            axes: Vec::new(),
            replicates: 1,
            span: 0..0,
        };
        grid.add(STORED, ("noise", Place::Variable), values.into())
            .unwrap();
        let common = toml::Table::from_iter([("n".to_owned(), Value::Integer(3))]);
        let choice = grid.choice(STORED, &common, 1).unwrap();
        assert_eq!(choice.spec.noise, 0.0);
        assert_eq!(choice.variables.number("noise"), Some(0.5));
        assert_eq!(choice.name(&grid.names().collect()), "noise=0.5");
        // Another grid of the file lacks it.
        let lacking = Choice {
            values: Vec::new(),
            ..choice
        };
        assert_eq!(lacking.name(&grid.names().collect()), "");
    }
}
