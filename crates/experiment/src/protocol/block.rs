//! One `[[at]]` block: when it is executed, and its changes.

use std::ops::Range;

use jostle_conditions::{Condition, ConditionError, Held};
use jostle_convert::change;
use jostle_measures::View;
use jostle_physics::model::selection::Selection;
use jostle_physics::simulation::{Change, Placement, Simulation, steps_in};
use jostle_proto::verbs;
use toml::{Spanned, Value};

use super::setting::Setting;
use crate::error::PlanError;
use crate::file::{Source, Table, in_words};
use crate::limits::MAX_INDIVIDUALS;

/// The keys of a block that say when it is executed, and the key of its draws.
const KEYS: [&str; 7] = ["time", "step", "every", "from", "until", "when", "draw"];

/// The verbs of a block, those of `batch`.
const VERBS: [&str; 5] = ["set", "inform", "uninform", "inject", "remove"];

/// A part of the time of a block that counts as rounding.
const ROUNDING: f64 = 1e-9;

/// A block of a protocol.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    /// Its first line in the file.
    pub line: usize,
    /// When it is executed.
    timing: Timing,
    /// The key of the draws of its first change, together with the seed of the run. None continues
    /// the numbering of the changes.
    pub draw: Option<u64>,
    changes: Changes,
}

#[derive(Clone, Debug, PartialEq)]
enum Timing {
    /// Once, at this step.
    Step(u64),
    /// Repeatedly, in time units.
    Repeated { from: f64, until: f64, every: f64 },
    /// Once, when this holds.
    When(Trigger),
}

/// A condition that is evaluated from a step on.
#[derive(Clone, Debug, PartialEq)]
pub struct Trigger {
    /// The condition.
    pub condition: Condition,
    /// The first step at which it is evaluated.
    pub from: u64,
}

impl Trigger {
    /// Evaluates the condition on the state after `step` steps, as [`Condition::observe`].
    pub fn observe(&self, view: &View<'_>, step: u64, dt: f64, held: &mut Held) -> bool {
        step >= self.from && self.condition.observe(view, step, dt, held)
    }
}

#[derive(Clone, Debug, PartialEq)]
enum Changes {
    Fixed(Vec<Change>),
    /// Verbs with their arguments, which contain ramps.
    Ramp(Vec<(String, Value)>),
}

impl Block {
    /// Returns the step at which the block is executed after `executed` executions; none if it is not
    /// executed again, or under a condition.
    pub fn step(&self, executed: u64, dt: f64) -> Option<u64> {
        match self.timing {
            Timing::Step(step) => (executed == 0).then_some(step),
            Timing::Repeated { from, until, every } => {
                let time = from + executed as f64 * every;
                (time <= until * (1.0 + ROUNDING)).then(|| steps_in(time, dt))
            }
            Timing::When(_) => None,
        }
    }

    /// Returns what triggers the block, once; none if it is executed at steps.
    pub fn trigger(&self) -> Option<&Trigger> {
        match &self.timing {
            Timing::When(trigger) => Some(trigger),
            Timing::Step(_) | Timing::Repeated { .. } => None,
        }
    }

    /// Returns the number of executions, at most.
    fn executions(&self) -> u64 {
        match self.timing {
            Timing::Step(_) | Timing::When(_) => 1,
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "positive, and saturates"
            )]
            Timing::Repeated { from, until, every } => {
                ((until - from) / every * (1.0 + ROUNDING)) as u64 + 1
            }
        }
    }

    /// Returns the changes of an execution, by the number of executions before it.
    ///
    /// # Errors
    ///
    /// The reason if a value of a ramp is invalid.
    pub fn changes(&self, executed: u64) -> Result<Vec<Change>, String> {
        let templates = match &self.changes {
            Changes::Fixed(changes) => return Ok(changes.clone()),
            Changes::Ramp(templates) => templates,
        };
        let share = match self.timing {
            Timing::Repeated { from, until, every } if until > from => {
                (executed as f64 * every / (until - from)).min(1.0)
            }
            _ => 0.0,
        };
        let changes = templates.iter();
        changes
            .map(|(verb, args)| to_change(verb, &at_share(args, share)))
            .collect()
    }
}

/// Reads the blocks of one condition of a plan.
#[derive(Clone, Copy)]
pub struct Resolver<'a> {
    pub source: Source<'a>,
    pub setting: Setting<'a>,
}

impl Resolver<'_> {
    pub fn block(&self, table: &Table) -> Result<Block, PlanError> {
        let spans = table.keys().map(Spanned::span);
        let span = spans.min_by_key(|span| span.start).unwrap_or(0..0);
        let (timing, draw) = self.timing(table, &span)?;
        let mut verbs = Vec::new();
        for (key, value) in table {
            let name = key.get_ref().as_str();
            if VERBS.contains(&name) {
                verbs.push((key, value));
            } else if !KEYS.contains(&name) {
                let reason = format!(
                    "unknown key {name:?}: an [[at]] has one of time, step, every or when, and one \
                     or more of {}",
                    VERBS.join(", ")
                );
                return Err(self.source.reject(&key.span(), reason));
            }
        }
        if verbs.is_empty() {
            let reason = format!("[[at]] without a command: give {}", VERBS.join(", "));
            return Err(self.source.reject(&span, reason));
        }
        // In the order of the file.
        verbs.sort_by_key(|(key, _)| key.span().start);
        let mut templates = Vec::new();
        for (key, value) in verbs {
            let args = self.replaced(value)?;
            let list = match args {
                Value::Array(list) => list,
                one => vec![one],
            };
            for args in list {
                check_ramps(&args, matches!(timing, Timing::Repeated { .. }))
                    .map_err(|(text, reason)| self.reject(value, &text, reason))?;
                templates.push((key.get_ref().clone(), args));
            }
        }
        if templates.is_empty() {
            let reason = "[[at]] without a command: its lists of commands are empty";
            return Err(self.source.reject(&span, reason));
        }
        if templates.len() > verbs::MAX_CHANGES {
            let reason = format!("an [[at]] has at most {} commands", verbs::MAX_CHANGES);
            return Err(self.source.reject(&span, reason));
        }
        let is_ramp = templates.iter().any(|(_, args)| has_ramp(args));
        let mut block = Block {
            line: self.source.line(&span),
            timing,
            draw,
            changes: Changes::Ramp(templates),
        };
        let first = self.converted(&block, table, 0)?;
        if is_ramp {
            // A change is checked at both ends of its ramps.
            self.converted(&block, table, block.executions() - 1)?;
        } else {
            block.changes = Changes::Fixed(first);
        }
        Ok(block)
    }

    /// Reads `[stop]`; none if it is empty.
    pub fn stop(&self, table: &Table) -> Result<Option<Trigger>, PlanError> {
        let (mut condition, mut from, mut first) = (None, 0, 0..0);
        for (key, value) in table {
            first = key.span();
            match key.get_ref().as_str() {
                "when" => condition = Some(self.condition(value)?),
                "from" => from = self.from(value)?,
                unknown => {
                    let reason = format!("unknown key {unknown:?}: [stop] has when and from");
                    return Err(self.source.reject(&first, reason));
                }
            }
        }
        if condition.is_none() && !table.is_empty() {
            return Err(self
                .source
                .reject(&first, "[stop] without a condition: give when"));
        }
        Ok(condition.map(|condition| Trigger { condition, from }))
    }

    /// Reads the time from which a condition is evaluated; returns its step.
    fn from(&self, value: &Spanned<Value>) -> Result<u64, PlanError> {
        let (from, duration) = (self.time(value, "from")?, self.setting.duration);
        let step = steps_in(from, self.setting.spec.parameters.dt);
        if step < self.setting.steps() {
            return Ok(step);
        }
        let reason = format!("from = {from} is not before the end, duration = {duration}");
        Err(self.source.reject(&value.span(), reason))
    }

    /// Reads a condition.
    fn condition(&self, value: &Spanned<Value>) -> Result<Condition, PlanError> {
        let Some(text) = value.get_ref().as_str() else {
            let reason = "give a condition as text, such as \"order > 0.9 for 20\"";
            return Err(self.source.reject(&value.span(), reason));
        };
        let variables = self.setting.variables;
        Condition::parse_with(text, |name| variables.number(name)).map_err(|error| {
            let ConditionError { column, problem } = error;
            let (line, start) = self.source.place(&value.span());
            // The column is known if the text stands in the file as it is, after a quote.
            let span = value.span();
            let is_plain = self.source.find(&span, text).start == span.start + 1;
            PlanError::Field {
                line,
                column: start + if is_plain { column } else { 0 },
                reason: format!("condition {text:?}: {problem}"),
            }
        })
    }

    /// Checks the changes of all blocks against the spec; `tables` are the blocks in the file.
    pub fn check(
        &self,
        blocks: &[Block],
        tables: &[Table],
        checker: &Option<Simulation>,
    ) -> Result<(), PlanError> {
        let mut added = 0u64;
        for block in blocks {
            for change in block.changes(0).unwrap_or_default() {
                if let Change::Inject { place, .. } = change {
                    let count = match place {
                        Placement::At(poses) => poses.len(),
                        Placement::Border(count) | Placement::Within(count, _) => count,
                    } as u64;
                    added = added.saturating_add(count.saturating_mul(block.executions()));
                }
            }
        }
        let n = self.setting.spec.n as u64;
        for (block, table) in blocks.iter().zip(tables) {
            let ends = [0, block.executions() - 1];
            for change in ends
                .iter()
                .flat_map(|&at| block.changes(at).unwrap_or_default())
            {
                let checked = checker.as_ref().map_or(Ok(()), |it| it.check(&change));
                let checked = checked.map_err(|error| error.to_string());
                let checked = checked.and_then(|()| check_selection(&change, n, added));
                checked.map_err(|reason| {
                    let verb = verb_of(&change);
                    let key = table.keys().find(|key| key.get_ref() == verb);
                    let span = key.map_or(0..0, Spanned::span);
                    self.source.reject(&span, format!("{verb}: {reason}"))
                })?;
            }
        }
        Ok(())
    }

    fn converted(
        &self,
        block: &Block,
        table: &Table,
        executed: u64,
    ) -> Result<Vec<Change>, PlanError> {
        block.changes(executed).map_err(|reason| {
            let verb = reason.split(':').next().unwrap_or_default();
            let key = table.keys().find(|key| key.get_ref() == verb);
            let span = key.map_or(0..0, Spanned::span);
            self.source.reject(&span, reason)
        })
    }

    fn timing(
        &self,
        table: &Table,
        span: &Range<usize>,
    ) -> Result<(Timing, Option<u64>), PlanError> {
        let entry = |key: &str| table.iter().find(|(it, _)| it.get_ref() == key);
        let given: Vec<&str> = ["time", "step", "every", "when"]
            .into_iter()
            .filter(|key| entry(key).is_some())
            .collect();
        let [kind] = given[..] else {
            let reason = match given[..] {
                [] => "[[at]] without a time: give time, step, every or when".to_owned(),
                _ => format!(
                    "{} exclude each other: give one of them",
                    given.join(" and ")
                ),
            };
            return Err(self.source.reject(span, reason));
        };
        for (wrong, kinds, reason) in [
            (
                "from",
                &["every", "when"][..],
                "from requires every or when",
            ),
            ("until", &["every"], "until requires every"),
        ] {
            if let Some((key, _)) = entry(wrong).filter(|_| !kinds.contains(&kind)) {
                return Err(self.source.reject(&key.span(), reason));
            }
        }
        let draw = entry("draw").map(|(_, value)| self.whole(value, "draw"));
        let draw = draw.transpose()?;
        let (_, value) = entry(kind).expect("found above");
        let steps = self.setting.steps();
        let dt = self.setting.spec.parameters.dt;
        let duration = self.setting.duration;
        let is_late = |what: String| format!("{what} is not before the end, duration = {duration}");
        let timing = match kind {
            "when" => Timing::When(Trigger {
                condition: self.condition(value)?,
                from: entry("from").map_or(Ok(0), |(_, value)| self.from(value))?,
            }),
            "step" => {
                let step = self.whole(value, "step")?;
                if step >= steps {
                    let reason = format!("step = {step} is not before the end, step {steps}");
                    return Err(self.source.reject(&value.span(), reason));
                }
                Timing::Step(step)
            }
            "time" => {
                let time = self.time(value, "time")?;
                let step = steps_in(time, dt);
                if step >= steps {
                    let reason = is_late(format!("time = {time}"));
                    return Err(self.source.reject(&value.span(), reason));
                }
                Timing::Step(step)
            }
            _ => {
                let every = self.time(value, "every")?;
                if every < dt {
                    let reason = format!("every = {every} is shorter than a step, dt = {dt}");
                    return Err(self.source.reject(&value.span(), reason));
                }
                let time = |key| {
                    entry(key)
                        .map(|(_, value)| self.time(value, key))
                        .transpose()
                };
                let from = time("from")?.unwrap_or(0.0);
                let until = time("until")?.unwrap_or(duration);
                for (key, is_wrong, reason) in [
                    ("from", from >= duration, is_late(format!("from = {from}"))),
                    (
                        "until",
                        until < from,
                        format!("until = {until} is before from = {from}"),
                    ),
                    (
                        "until",
                        until > duration,
                        format!("until = {until} is after the end, duration = {duration}"),
                    ),
                ] {
                    if is_wrong {
                        let span = entry(key).map_or(span.clone(), |(_, it)| it.span());
                        return Err(self.source.reject(&span, reason));
                    }
                }
                Timing::Repeated { from, until, every }
            }
        };
        Ok((timing, draw))
    }

    fn time(&self, value: &Spanned<Value>, key: &str) -> Result<f64, PlanError> {
        let number = match self.replaced(value)? {
            Value::Integer(number) => number as f64,
            Value::Float(number) => number,
            _ => f64::NAN,
        };
        if number.is_finite() && number >= 0.0 {
            return Ok(number);
        }
        let reason = format!("{key}: give a time in time units, 0 or more");
        Err(self.source.reject(&value.span(), reason))
    }

    fn whole(&self, value: &Spanned<Value>, key: &str) -> Result<u64, PlanError> {
        let number = self.replaced(value)?.as_integer();
        let number = number.and_then(|number| u64::try_from(number).ok());
        number.ok_or_else(|| {
            let reason = format!("{key}: give a whole number, 0 or more");
            self.source.reject(&value.span(), reason)
        })
    }

    fn replaced(&self, value: &Spanned<Value>) -> Result<Value, PlanError> {
        let replaced = self.setting.variables.replace(value.get_ref());
        replaced.map_err(|variable| {
            let reason = format!(
                "unknown variable {variable:?}: a [[grid]] gives its values, such as {} = [0.1, 0.2]",
                variable.trim_start_matches('$')
            );
            self.reject(value, &variable, reason)
        })
    }

    /// Returns the error at `text` within a value.
    fn reject(&self, value: &Spanned<Value>, text: &str, reason: String) -> PlanError {
        let span = self.source.find(&value.span(), text);
        self.source.reject(&span, reason)
    }
}

/// Converts a verb with its arguments.
fn to_change(verb: &str, args: &Value) -> Result<Change, String> {
    let mut table = toml::Table::new();
    table.insert("verb".to_owned(), Value::String(verb.to_owned()));
    table.insert("args".to_owned(), args.clone());
    let message: verbs::Change = Value::Table(table)
        .try_into()
        .map_err(|error: toml::de::Error| format!("{verb}: {}", in_words(error.message())))?;
    change::change(message).map_err(|error| format!("{verb}: {error}"))
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

fn has_ramp(value: &Value) -> bool {
    match value {
        Value::Table(table) => ramp(value).is_some() || table.values().any(has_ramp),
        Value::Array(items) => items.iter().any(has_ramp),
        _ => false,
    }
}

/// Checks the ramps of a value. The error is a text in the value, and the reason.
fn check_ramps(value: &Value, is_repeated: bool) -> Result<(), (String, String)> {
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
fn at_share(value: &Value, share: f64) -> Value {
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

/// Checks that the individuals of a selection can exist: `n` at the start, and at most `added`.
fn check_selection(change: &Change, n: u64, added: u64) -> Result<(), String> {
    let selection = match change {
        Change::Inject {
            place: Placement::Border(count) | Placement::Within(count, _),
            ..
        } if *count as u64 > MAX_INDIVIDUALS => {
            return Err(format!(
                "count = {count} is above the limit of {MAX_INDIVIDUALS}"
            ));
        }
        Change::Inform { selection, .. } => selection,
        Change::Uninform(selection) | Change::Remove(selection) => selection,
        Change::Set(_) | Change::Inject { .. } => return Ok(()),
    };
    let most = n.saturating_add(added);
    let group = match added {
        0 => format!("the group has {n} individuals"),
        _ => format!("the group has {n} individuals and at most {added} are added"),
    };
    match selection {
        Selection::Ids(ids) => match ids.iter().find(|&&id| u64::from(id) >= most) {
            Some(id) => Err(format!("select.ids: {id} cannot exist: {group}")),
            None => Ok(()),
        },
        Selection::Count(count) | Selection::Foremost { count, .. } if *count as u64 > most => {
            Err(format!("select: {count} individuals are too many: {group}"))
        }
        _ => Ok(()),
    }
}

fn verb_of(change: &Change) -> &'static str {
    match change {
        Change::Set(_) => "set",
        Change::Inform { .. } => "inform",
        Change::Uninform(_) => "uninform",
        Change::Inject { .. } => "inject",
        Change::Remove(_) => "remove",
    }
}
