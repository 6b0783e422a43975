//! Selections of things by what they have, in the grammar of conditions.

use pest::iterators::Pair;

use crate::condition::Node;
use crate::error::{ConditionError, Problem};
use crate::parse::grammar::Rule;
use crate::parse::{error, parsed};

/// What things have: a name, and the words that it can be; none if it is a number.
pub type Field = (&'static str, &'static [&'static str]);

/// A value of a field, or what it is compared with.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// A number.
    Number(f64),
    /// A word.
    Word(String),
}

/// Comparisons of fields, joined by `and` and `or`.
#[derive(Clone, Debug, PartialEq)]
pub struct Selection {
    root: Node,
    tests: Vec<Test>,
}

/// A field that is compared with a value.
#[derive(Clone, Debug, PartialEq)]
struct Test {
    field: &'static str,
    relation: String,
    value: Value,
}

impl Selection {
    /// Parses a selection of things with these fields.
    ///
    /// # Errors
    ///
    /// [`ConditionError`] with the column.
    pub fn parse(text: &str, fields: &[Field]) -> Result<Self, ConditionError> {
        let pair = parsed(Rule::selection, text)?;
        let mut tests = Vec::new();
        let root = node(text, pair, fields, &mut tests)?;
        Ok(Self { root, tests })
    }

    /// Returns whether it selects a thing with these values. Without a value of a field no comparison
    /// of it holds.
    pub fn selects(&self, value: impl Fn(&str) -> Option<Value>) -> bool {
        self.holds(&self.root, &value)
    }

    fn holds(&self, node: &Node, value: &dyn Fn(&str) -> Option<Value>) -> bool {
        match node {
            Node::Comparison(index) => {
                let test = &self.tests[*index];
                value(test.field).is_some_and(|value| test.holds(&value))
            }
            Node::All(nodes) => nodes.iter().all(|it| self.holds(it, value)),
            Node::Any(nodes) => nodes.iter().any(|it| self.holds(it, value)),
        }
    }
}

impl Test {
    fn holds(&self, value: &Value) -> bool {
        match (value, &self.value) {
            (Value::Number(is), Value::Number(number)) => match self.relation.as_str() {
                "<" => is < number,
                "<=" => is <= number,
                ">" => is > number,
                ">=" => is >= number,
                "!=" => is != number,
                _ => is == number,
            },
            (is, word) => (is == word) == (self.relation == "="),
        }
    }
}

fn node(
    text: &str,
    pair: Pair<'_, Rule>,
    fields: &[Field],
    tests: &mut Vec<Test>,
) -> Result<Node, ConditionError> {
    let is_all = match pair.as_rule() {
        Rule::test => {
            tests.push(test(text, pair, fields)?);
            return Ok(Node::Comparison(tests.len() - 1));
        }
        rule => rule == Rule::every,
    };
    let parts = pair.into_inner();
    let parts = parts.filter(|it| !matches!(it.as_rule(), Rule::and | Rule::or));
    let nodes = parts.map(|part| node(text, part, fields, tests));
    let nodes = nodes.collect::<Result<Vec<_>, _>>()?;
    Ok(match is_all {
        true => Node::All(nodes),
        false => Node::Any(nodes),
    })
}

fn test(text: &str, pair: Pair<'_, Rule>, fields: &[Field]) -> Result<Test, ConditionError> {
    let at = pair.as_span().start();
    let reject = |problem| Err(error(text, at, Problem::Selection(problem)));
    let mut parts = pair.into_inner().map(|part| part.as_str().trim());
    let (Some(name), Some(relation), Some(value)) = (parts.next(), parts.next(), parts.next())
    else {
        unreachable!("the grammar requires a field, a relation and a value");
    };
    let Some((field, words)) = fields.iter().find(|(field, _)| *field == name) else {
        let names: Vec<&str> = fields.iter().map(|(field, _)| *field).collect();
        return reject(format!(
            "unknown field {name}: use one of {}",
            names.join(", ")
        ));
    };
    let value = match (words, value.parse::<f64>()) {
        ([], Ok(number)) if number.is_finite() => Value::Number(number),
        ([], _) => {
            return reject(format!(
                "{name} is compared with a number, not with {value}"
            ));
        }
        (words, _) if !words.contains(&value) => {
            let words = words.join(", ");
            return reject(format!("{name} is never {value}: it is one of {words}"));
        }
        (_, _) if !["=", "!="].contains(&relation) => {
            return reject(format!("{name} is a word: compare it by = or !="));
        }
        _ => Value::Word(value.to_owned()),
    };
    Ok(Test {
        field,
        relation: relation.to_owned(),
        value,
    })
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    const FIELDS: [Field; 3] = [
        ("n", &[]),
        ("order", &[]),
        ("phase", &["paused", "running"]),
    ];

    /// Whether a thing of 200 that runs, without an order, is selected.
    fn selects(text: &str) -> bool {
        Selection::parse(text, &FIELDS)
            .unwrap()
            .selects(|field| match field {
                "n" => Some(Value::Number(200.0)),
                "phase" => Some(Value::Word("running".into())),
                _ => None,
            })
    }

    #[test]
    fn fields_are_compared_and_joined_as_in_conditions() {
        for text in [
            "n >= 200 and phase = running",
            "n=2e2",
            "n < 3 or n > 3 and phase != paused",
            "(n < 3 or n > 3) and (phase = running)",
            "n <= 200\nand n != 5",
        ] {
            assert!(selects(text), "{text}");
        }
        for text in [
            "n > 200",
            "phase = paused",
            "n < 3 or phase = paused",
            "order >= 0",
            "order < 0 or order != 3",
            "(n < 3 or n > 3) and phase != running",
        ] {
            assert!(!selects(text), "{text}");
        }
    }

    #[test]
    fn what_is_wrong_is_named_with_its_column() {
        for (text, expected) in [
            (
                "n > 3 and m = 1",
                "column 11: unknown field m: use one of n, order, phase",
            ),
            (
                "n = many",
                "column 1: n is compared with a number, not with many",
            ),
            (
                "phase = runing",
                "column 1: phase is never runing: it is one of paused, running",
            ),
            (
                "phase > paused",
                "column 1: phase is a word: compare it by = or !=",
            ),
            ("n", "column 2: expected `=`, `!=`, "),
            ("n = 3 for 2", "column 7: expected "),
        ] {
            let error = Selection::parse(text, &FIELDS).unwrap_err().to_string();
            assert!(error.starts_with(expected), "{error}");
        }
        let deep = format!("{}n = 1{}", "(".repeat(33), ")".repeat(33));
        assert!(Selection::parse(&deep, &FIELDS).is_err());
    }
}
