//! The form `NAME` or `NAME(ARGUMENT)` by which a measure is chosen.

use std::fmt;
use std::ops::RangeBounds;
use std::str::FromStr;

use jostle_physics::simulation::steps_in;

use crate::definition::{Argument, Definition, Lag, shortest};
use crate::error::{MAX_COSTLY_INDIVIDUALS, MeasureError, TooCostly};
use crate::registry::definitions;
use crate::view::View;

/// A measure that is chosen by name, with its argument: `order`, `msd(5)`, `clusters.count(0.1)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measure {
    /// Its index in [`definitions`].
    index: usize,
    /// Its argument, which may be the default; `None` if it has none.
    argument: Option<f64>,
}

impl Measure {
    /// Whether its cost is above n, and `n` above [`MAX_COSTLY_INDIVIDUALS`].
    #[must_use]
    pub fn is_too_costly(&self, n: usize) -> bool {
        n > MAX_COSTLY_INDIVIDUALS && self.definition().cost != "n"
    }

    /// Checks that the measure is evaluated for `n` individuals beside live swarms.
    ///
    /// # Errors
    ///
    /// [`TooCostly`].
    pub fn check_size(&self, n: usize) -> Result<(), TooCostly> {
        match self.is_too_costly(n) {
            true => Err(TooCostly {
                measure: self.to_string(),
                n,
            }),
            false => Ok(()),
        }
    }

    /// Returns all measures that need no past, in the order of [`definitions`]; each has the default
    /// argument.
    #[must_use]
    pub fn all_of_one_state() -> Vec<Self> {
        let measure = |(index, definition): (usize, &Definition)| {
            let argument = match definition.argument {
                Some(argument) => Some(argument.default?),
                None => None,
            };
            (!definition.needs_past()).then_some(Self { index, argument })
        };
        definitions()
            .iter()
            .enumerate()
            .filter_map(measure)
            .collect()
    }

    /// Evaluates the measure, in its unit.
    ///
    /// It is undefined, `None`, where its formula is: for an empty group, for too few individuals,
    /// without informed individuals or a common direction of them, or if the past has no frame of the
    /// step that it needs. It is never infinite or NaN.
    #[must_use]
    pub fn evaluate(&self, view: &View<'_>) -> Option<f64> {
        if view.state().configuration.n() == 0 {
            return None;
        }
        let value = (self.definition().evaluate)(view, self.argument.unwrap_or(0.0))?;
        value.is_finite().then_some(value)
    }

    /// Announces the measure: those of clusters and contacts then share one search of neighbours, at the largest
    /// gap of all.
    pub fn announce(&self, view: &View<'_>) {
        if let Some(gap) = self.gap() {
            view.expect_gap(gap);
        }
    }

    /// Returns the value as [`Measure::evaluate`], which is called once for equal measures of a view.
    #[must_use]
    pub fn value(&self, view: &View<'_>) -> Option<f64> {
        let lag = self.lag(view.state().parameters.dt);
        if lag > 0 && view.state().step.checked_sub(lag)? < view.first() {
            return None;
        }
        let key = (self.index, self.argument);
        view.value(key, lag > 0, |view| self.evaluate(view))
    }

    /// Returns the definition.
    #[must_use]
    pub fn definition(&self) -> &'static Definition {
        &definitions()[self.index]
    }

    /// Returns the argument, which may be the default; `None` if it has none.
    #[must_use]
    pub fn argument(&self) -> Option<f64> {
        self.argument
    }

    /// Returns the gap within which it needs the pairs of individuals, in body sizes, if it does.
    pub(crate) fn gap(&self) -> Option<f64> {
        let argument = self.definition().argument?;
        (argument.name == "gap").then_some(self.argument?)
    }

    /// Returns how many steps of `dt` the past reaches back, which [`Past::new`](crate::Past::new)
    /// takes: 0, 1, or those of the lag.
    #[must_use]
    pub fn lag(&self, dt: f64) -> u64 {
        match self.definition().lag {
            Lag::None => 0,
            Lag::Step => 1,
            Lag::Argument => steps_in(self.argument.unwrap_or(0.0), dt),
        }
    }
}

impl FromStr for Measure {
    type Err = MeasureError;

    /// Parses `NAME` or `NAME(ARGUMENT)`; spaces around a name or an argument are ignored.
    fn from_str(text: &str) -> Result<Self, MeasureError> {
        let (name, argument) = match text.split_once('(') {
            None => (text.trim(), None),
            Some((name, rest)) => match rest.trim_end().strip_suffix(')') {
                Some(argument) => (name.trim(), Some(argument.trim())),
                None => return Err(MeasureError::Open(text.trim().to_owned())),
            },
        };
        let named = |definition: &Definition| definition.name == name;
        let index = definitions()
            .iter()
            .position(named)
            .ok_or_else(|| MeasureError::unknown(name))?;
        let Definition {
            name,
            argument: definition,
            ..
        } = definitions()[index];
        let argument = match (definition, argument) {
            (None, None) => None,
            (None, Some(_)) => return Err(MeasureError::NoArgument { name }),
            (Some(argument), None) => {
                let default = argument.default;
                Some(default.ok_or(MeasureError::Missing { name, argument })?)
            }
            (Some(argument), Some(text)) => Some(argument.parse(name, text)?),
        };
        Ok(Self { index, argument })
    }
}

impl Argument {
    fn parse(self, name: &'static str, text: &str) -> Result<f64, MeasureError> {
        let value = text.parse().ok().filter(|value: &f64| value.is_finite());
        let value = value.ok_or_else(|| MeasureError::NotANumber {
            name,
            argument: self,
            text: text.to_owned(),
        })?;
        match self.range.contains(&value) {
            // Without the sign of -0.
            true => Ok(value + 0.0),
            false => Err(MeasureError::OutOfRange {
                name,
                argument: self,
                value,
            }),
        }
    }
}

impl fmt::Display for Measure {
    /// Writes the normal form, which [`Measure::from_str`] reads: without an argument that is the
    /// default.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Definition { name, argument, .. } = self.definition();
        let default = argument.and_then(|argument| argument.default);
        match self.argument {
            Some(value) if default != Some(value) => {
                write!(formatter, "{name}({})", shortest(value))
            }
            _ => formatter.write_str(name),
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn parse(text: &str) -> Measure {
        text.parse().unwrap()
    }

    fn error(text: &str) -> String {
        text.parse::<Measure>().unwrap_err().to_string()
    }

    #[test]
    fn every_definition_is_complete_and_its_text_is_read_again() {
        for (index, definition) in definitions().iter().enumerate() {
            let Definition {
                name,
                unit,
                formula,
                source,
                range,
                cost,
                argument,
                ..
            } = *definition;
            for text in [name, unit, formula, source, range] {
                assert!(!text.is_empty() && !text.contains('\n'), "{name}");
            }
            assert!(["n", "n log n"].contains(&cost), "{name}");
            let is_plain = |c: char| c.is_ascii_alphanumeric() || "_.-".contains(c);
            assert!(name.chars().all(is_plain), "{name}");
            let others = &definitions()[index + 1..];
            assert!(
                others.iter().all(|other| other.name != name),
                "{name} twice"
            );
            let text = match argument {
                Some(_) => format!("{name}(0.25)"),
                None => name.to_owned(),
            };
            let measure = parse(&text);
            assert_eq!((measure.to_string(), measure.index), (text, index));
            let Some(argument) = argument else { continue };
            match argument.default {
                Some(default) => {
                    assert_eq!(parse(&format!("{name}({default})")), parse(name));
                    assert_eq!(parse(name).to_string(), name);
                    assert_eq!(parse(name).argument(), Some(default));
                }
                None => assert!(error(name).contains(argument.name), "{name}"),
            }
        }
    }

    #[test]
    fn the_measures_of_one_state_are_all_but_those_of_motion() {
        let names: Vec<String> = Measure::all_of_one_state()
            .iter()
            .map(ToString::to_string)
            .collect();
        assert_eq!(names.len(), definitions().len() - 4);
        assert_eq!(names[0], "order");
        assert!(names.contains(&"clusters.count".to_owned()));
        for name in ["turning_rate", "speed.informed", "speed.others", "msd"] {
            assert!(names.iter().all(|it| !it.starts_with(name)), "{name}");
        }
    }

    #[test]
    fn texts_have_a_normal_form() {
        for (text, normal) in [
            (" order ", "order"),
            ("msd( 5 )", "msd(5)"),
            ("msd (5.0) ", "msd(5)"),
            ("msd(1e-9)", "msd(1e-9)"),
            ("clusters.count(0.001)", "clusters.count"),
            ("clusters.count(-0)", "clusters.count(0)"),
        ] {
            assert_eq!(parse(text).to_string(), normal);
            assert_eq!(parse(normal), parse(text));
        }
    }

    #[test]
    fn errors_name_the_remedy() {
        for (text, part) in [
            ("ordr", "did you mean `order`?"),
            ("Order", "did you mean `order`?"),
            ("drfit", "did you mean `drift`?"),
            ("clusters", "did you mean `clusters.count`?"),
            ("neighbor_gap.q05", "did you mean `neighbour_gap.q05`?"),
            ("xyz", "there are order, nematic, "),
            ("", "there are order, nematic, "),
            ("order(3)", "leave out the parentheses"),
            ("msd", "requires its lag in s/v0: write msd(lag)"),
            ("msd(5", "closing parenthesis"),
            ("msd(5) x", "closing parenthesis"),
            ("msd()", "no finite number: ``"),
            ("msd(five)", "no finite number: `five`"),
            ("msd(inf)", "no finite number"),
            ("msd(1e999)", "no finite number"),
            ("msd(0)", "the lag of `msd` is 0, it must be above 0 s/v0"),
            ("msd(-1)", "it must be above 0 s/v0"),
            ("clusters.n_eff(2.5)", "it must be 0 to 2 body sizes"),
        ] {
            assert!(error(text).contains(part), "{text}: {}", error(text));
        }
    }

    #[test]
    fn lags_are_in_steps() {
        for (text, steps) in [
            ("order", 0),
            ("clusters.count(2)", 0),
            ("turning_rate", 1),
            ("speed.informed", 1),
            ("speed.others", 1),
            ("msd(0.06)", 3),
            ("msd(0.061)", 4),
            ("msd(1e-300)", 1),
            ("msd(1e300)", 1 << 53),
        ] {
            assert_eq!(parse(text).lag(0.02), steps, "{text}");
        }
    }
}
