//! Reads the `[[at]]` blocks and `[stop]` of a file for one condition of a plan.

use std::ops::Range;

use jostle_conditions::{Condition, ConditionError, Problem};
use jostle_physics::simulation::{Change, steps_in};
use jostle_proto::{Axis, verbs};
use toml::{Spanned, Value};

use super::arguments::{check_ramps, to_change};
use super::block::{Block, Changes, Timing, Trigger};
use super::keys::{Kind, STOP, TIMINGS, VERBS, dependent, named};
use super::setting::Setting;
use crate::error::PlanError;
use crate::file::{Source, Table};

/// Returns the span of the first key of a block, or that of the block if it is empty.
pub fn first_span(table: &Spanned<Table>) -> Range<usize> {
    let spans = table.get_ref().keys().map(Spanned::span);
    spans
        .min_by_key(|span| span.start)
        .unwrap_or_else(|| table.span())
}

/// Returns why an axis is no variable, and the remedy; none of another name.
fn no_variable(name: &str) -> Option<String> {
    Axis::of(name)?;
    let mut reason = format!(
        "\"${name}\" is no variable: {name} is an axis, which gives a parameter its values; give a \
         variable of another name the values in the [[grid]], such as my_{name} = [0.1, 0.2]"
    );
    let settings = toml::Table::from_iter([(name.to_owned(), Value::Float(1.0))]);
    if to_change("set", &Value::Table(settings)).is_ok() {
        reason +=
            &format!(", and the parameter its value with set = {{ {name} = \"$my_{name}\" }}");
    }
    Some(reason)
}

/// Reads the blocks of one condition of a plan.
#[derive(Clone, Copy)]
pub struct Resolver<'a> {
    pub source: Source<'a>,
    pub setting: Setting<'a>,
}

impl Resolver<'_> {
    /// Reads a block with its changes.
    pub fn block(&self, table: &Spanned<Table>) -> Result<Block, PlanError> {
        let mut block = self.template(table)?;
        let first = self.converted(&block, table.get_ref(), 0)?;
        if block.has_ramp() {
            // A change is checked at both ends of its ramps.
            self.converted(&block, table.get_ref(), block.executions() - 1)?;
        } else {
            block.changes = Changes::Fixed(first);
        }
        Ok(block)
    }

    /// Reads a block whose commands are not converted.
    pub fn template(&self, table: &Spanned<Table>) -> Result<Block, PlanError> {
        let span = first_span(table);
        let table = table.get_ref();
        let (timing, draw) = self.timing(table, &span)?;
        let mut verbs = Vec::new();
        for (key, value) in table {
            let name = key.get_ref().as_str();
            if VERBS.contains(&name) {
                verbs.push((key, value));
            } else if named(name).is_none() {
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
        Ok(Block {
            line: self.source.line(&span),
            timing,
            draw,
            changes: Changes::Template(templates),
        })
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
                    let keys = STOP.join(" and ");
                    let reason = format!("unknown key {unknown:?}: [stop] has {keys}");
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
            let problem = match &problem {
                Problem::Variable(name) => no_variable(name),
                _ => None,
            }
            .unwrap_or_else(|| problem.to_string());
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
        let timings = TIMINGS.iter().map(|(timing, _)| *timing);
        let given: Vec<&str> = timings.filter(|it| entry(it).is_some()).collect();
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
        for (dependent, timings) in dependent() {
            if let Some((key, _)) = entry(dependent).filter(|_| !timings.contains(&kind)) {
                let reason = format!("{dependent} requires {}", timings.join(" or "));
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
                    (
                        "from",
                        steps_in(from, dt) >= steps,
                        is_late(format!("from = {from}")),
                    ),
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
        let is_interval = named(key).is_some_and(|it| it.kind == Kind::Interval);
        if number.is_finite() && (number > 0.0 || number == 0.0 && !is_interval) {
            return Ok(number);
        }
        let least = if is_interval { "above 0" } else { "0 or more" };
        let reason = format!("{key}: give a time in time units, {least}");
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
            let name = variable.trim_start_matches('$');
            let reason = no_variable(name).unwrap_or_else(|| {
                format!(
                    "unknown variable {variable:?}: a [[grid]] gives its values, such as {name} = [0.1, 0.2]"
                )
            });
            self.reject(value, &variable, reason)
        })
    }

    /// Returns the error at `text` within a value.
    fn reject(&self, value: &Spanned<Value>, text: &str, reason: String) -> PlanError {
        let span = self.source.find(&value.span(), text);
        self.source.reject(&span, reason)
    }
}
