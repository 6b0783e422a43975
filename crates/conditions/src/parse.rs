//! The parser, from the grammar in `condition.pest`.

use jostle_measures::Measure;
use pest::Parser;
use pest::error::{ErrorVariant, InputLocation};
use pest::iterators::Pair;

use crate::condition::{Comparison, Condition, Node, Operator};
use crate::error::{ConditionError, Problem};

/// The longest text, in bytes.
const MAX_LENGTH: usize = 1000;

/// The deepest nesting of parentheses. The parser and the evaluation are recursive.
const MAX_DEPTH: usize = 32;

/// The grammar, from which the derive macro generates `Rule`.
pub(crate) mod grammar {
    #[derive(pest_derive::Parser)]
    #[grammar = "condition.pest"]
    pub struct Grammar;
}

use grammar::{Grammar, Rule};

impl Condition {
    /// Parses a condition without variables.
    ///
    /// # Errors
    ///
    /// [`ConditionError`] with the column.
    pub fn parse(text: &str) -> Result<Self, ConditionError> {
        Self::parse_with(text, |_| None)
    }

    /// Parses a condition whose numbers may be variables, such as `$share`. `value` returns the value
    /// of a variable.
    ///
    /// # Errors
    ///
    /// [`ConditionError`] with the column.
    pub fn parse_with(
        text: &str,
        value: impl Fn(&str) -> Option<f64>,
    ) -> Result<Self, ConditionError> {
        parse(text, &value)
    }
}

/// Parses a condition; `value` returns the value of a variable.
fn parse(text: &str, value: &dyn Fn(&str) -> Option<f64>) -> Result<Condition, ConditionError> {
    let pair = parsed(Rule::condition, text)?;
    let mut reader = Reader {
        text,
        value,
        comparisons: Vec::new(),
    };
    let root = reader.node(pair)?;
    Ok(Condition {
        root,
        comparisons: reader.comparisons,
    })
}

/// Parses a text of the grammar's `rule`; its only part.
pub(crate) fn parsed(rule: Rule, text: &str) -> Result<Pair<'_, Rule>, ConditionError> {
    let reject = |at, problem| Err(error(text, at, problem));
    if text.chars().count() > MAX_LENGTH {
        return reject(
            0,
            Problem::TooLong("a condition has at most 1000 characters"),
        );
    }
    let mut depth = 0usize;
    for (at, character) in text.char_indices() {
        match character {
            '(' => depth += 1,
            ')' => depth = depth.saturating_sub(1),
            _ => {}
        }
        if depth > MAX_DEPTH {
            let problem = Problem::TooLong("parentheses are nested more than 32 deep");
            return reject(at, problem);
        }
    }
    let mut parsed = Grammar::parse(rule, text).map_err(|failure| {
        let at = match failure.location {
            InputLocation::Pos(at) | InputLocation::Span((at, _)) => at,
        };
        let expected = match &failure.variant {
            ErrorVariant::ParsingError { positives, .. } => expected(positives),
            ErrorVariant::CustomError { message } => message.clone(),
        };
        error(text, at, Problem::Syntax(expected))
    })?;
    let whole = parsed.next().into_iter().flat_map(Pair::into_inner).next();
    whole.map_or_else(|| reject(0, Problem::Syntax("a condition".to_owned())), Ok)
}

pub(crate) fn error(text: &str, at: usize, problem: Problem) -> ConditionError {
    let before = text.get(..at).unwrap_or(text);
    let column = before.chars().count() + 1;
    ConditionError { column, problem }
}

/// Names what may follow, in the words of the grammar's users.
fn expected(rules: &[Rule]) -> String {
    let mut names: Vec<&str> = rules
        .iter()
        .map(|rule| match rule {
            Rule::measure | Rule::comparison => "a measure, such as order",
            Rule::group => "`(`",
            Rule::field | Rule::test => "a field, such as n",
            Rule::relation => "`=`, `!=`, `<`, `<=`, `>` or `>=`",
            Rule::value | Rule::word => "a number or a word",
            Rule::choice => "`(`",
            Rule::operator => "`<`, `<=`, `>` or `>=`",
            Rule::number | Rule::literal | Rule::variable => "a number",
            Rule::duration => "a duration, in time units",
            Rule::and => "`and`",
            Rule::or => "`or`",
            Rule::lasting => "`for`",
            Rule::EOI => "the end of the text",
            _ => "a condition, such as order > 0.9",
        })
        .collect();
    names.dedup();
    match names.split_last() {
        Some((last, [])) => (*last).to_owned(),
        Some((last, others)) => format!("{} or {last}", others.join(", ")),
        None => "a condition, such as order > 0.9".to_owned(),
    }
}

struct Reader<'a> {
    text: &'a str,
    value: &'a dyn Fn(&str) -> Option<f64>,
    comparisons: Vec<Comparison>,
}

impl Reader<'_> {
    fn node(&mut self, pair: Pair<'_, Rule>) -> Result<Node, ConditionError> {
        match pair.as_rule() {
            Rule::comparison => self.comparison(pair),
            Rule::either | Rule::both | Rule::group => {
                let is_all = pair.as_rule() == Rule::both;
                let mut nodes = Vec::new();
                for part in pair.into_inner() {
                    if matches!(part.as_rule(), Rule::and | Rule::or) {
                        continue;
                    }
                    match (is_all, self.node(part)?) {
                        // Nested parts of the same kind are joined.
                        (true, Node::All(inner)) | (false, Node::Any(inner)) => nodes.extend(inner),
                        (_, node) => nodes.push(node),
                    }
                }
                Ok(match (is_all, nodes.len()) {
                    (_, 1) => nodes.remove(0),
                    (true, _) => Node::All(nodes),
                    (false, _) => Node::Any(nodes),
                })
            }
            rule => unreachable!("{rule:?} is no part of a condition"),
        }
    }

    fn comparison(&mut self, pair: Pair<'_, Rule>) -> Result<Node, ConditionError> {
        let (mut measure, mut operator, mut number, mut duration) = (None, None, None, None);
        for part in pair.into_inner() {
            let at = part.as_span().start();
            match part.as_rule() {
                Rule::measure => {
                    let parsed = part.as_str().parse::<Measure>();
                    measure = Some(
                        parsed
                            .map_err(|it| error(self.text, at, Problem::Measure(Box::new(it))))?,
                    );
                }
                Rule::operator => {
                    operator = Some(match part.as_str() {
                        "<" => Operator::Less,
                        "<=" => Operator::AtMost,
                        ">" => Operator::Greater,
                        _ => Operator::AtLeast,
                    });
                }
                Rule::number => number = Some(self.number(&part)?),
                Rule::duration => {
                    let time = self.number(&part)?;
                    if time <= 0.0 {
                        return Err(error(self.text, at, Problem::Duration(time)));
                    }
                    duration = Some(time);
                }
                _ => {}
            }
        }
        let (Some(measure), Some(operator), Some(number)) = (measure, operator, number) else {
            unreachable!("the grammar requires a measure, an operator and a number");
        };
        self.comparisons.push(Comparison {
            measure,
            operator,
            number,
            duration,
        });
        Ok(Node::Comparison(self.comparisons.len() - 1))
    }

    fn number(&self, pair: &Pair<'_, Rule>) -> Result<f64, ConditionError> {
        let (text, at) = (pair.as_str().trim(), pair.as_span().start());
        let number = match text.strip_prefix('$') {
            Some(name) => (self.value)(name)
                .ok_or_else(|| error(self.text, at, Problem::Variable(name.to_owned())))?,
            None => text.parse().unwrap_or(f64::NAN),
        };
        match number.is_finite() {
            true => Ok(number),
            false => Err(error(self.text, at, Problem::NotFinite(text.to_owned()))),
        }
    }
}
