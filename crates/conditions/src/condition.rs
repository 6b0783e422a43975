//! Conditions and their normal form.

use std::fmt;

use jostle_measures::Measure;
use jostle_physics::simulation::steps_in;

/// A condition, in its normal form: nested `and`s and `or`s are joined.
#[derive(Clone, Debug, PartialEq)]
pub struct Condition {
    pub(crate) root: Node,
    /// In the order of the text.
    pub(crate) comparisons: Vec<Comparison>,
}

/// A part of a condition.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Node {
    /// The comparison with this index.
    Comparison(usize),
    /// All of these hold.
    All(Vec<Node>),
    /// Any of these holds.
    Any(Vec<Node>),
}

/// A measure that is compared with a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparison {
    /// The measure. While it is undefined the comparison does not hold.
    pub measure: Measure,
    /// How it is compared.
    pub operator: Operator,
    /// What it is compared with, in the unit of the measure.
    pub number: f64,
    /// How long the comparison must have held, in time units; none if not at all.
    pub duration: Option<f64>,
}

/// How a measure is compared with a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operator {
    /// `<`
    Less,
    /// `<=`
    AtMost,
    /// `>`
    Greater,
    /// `>=`
    AtLeast,
}

impl Condition {
    /// Returns the comparisons, in the order of the text.
    #[must_use]
    pub fn comparisons(&self) -> &[Comparison] {
        &self.comparisons
    }

    /// Returns the measures, each as often as it is compared.
    pub fn measures(&self) -> impl Iterator<Item = &Measure> {
        self.comparisons.iter().map(|it| &it.measure)
    }

    /// Returns the number of earlier steps whose states the measures need.
    #[must_use]
    pub fn lag(&self, dt: f64) -> u64 {
        let lags = self.comparisons.iter().map(|it| it.measure.lag(dt));
        lags.max().unwrap_or(0)
    }
}

/// By how much rounding may move a value beyond the range of its measure.
const ROUNDING: f64 = 1e-9;

impl Condition {
    /// Returns why the condition never holds, if so: the numbers of comparisons without which it does
    /// not hold are beyond the ranges of their measures.
    #[must_use]
    pub fn never_holds(&self) -> Option<String> {
        self.impossible(&self.root, None)
    }

    /// Returns why the condition cannot hold within this many steps: a comparison is beyond the range
    /// of its measure, or its duration is longer than the steps.
    #[must_use]
    pub fn never_holds_within(&self, steps: u64, dt: f64) -> Option<String> {
        self.impossible(&self.root, Some((steps, dt)))
    }

    /// Returns the reason of the first comparison that makes a part impossible; none if it may hold.
    fn impossible(&self, node: &Node, left: Option<(u64, f64)>) -> Option<String> {
        match node {
            Node::Comparison(index) => self.comparisons[*index].impossible(left),
            Node::All(nodes) => nodes.iter().find_map(|it| self.impossible(it, left)),
            Node::Any(nodes) => {
                let parts: Option<Vec<_>> =
                    nodes.iter().map(|it| self.impossible(it, left)).collect();
                parts?.into_iter().next()
            }
        }
    }
}

impl Comparison {
    /// Returns why it never holds, or not within this many steps of this length.
    fn impossible(&self, left: Option<(u64, f64)>) -> Option<String> {
        if !self.is_possible() {
            let definition = self.measure.definition();
            return Some(format!(
                "{self} never holds: the range of {} is {}; give a number within it",
                definition.name, definition.range
            ));
        }
        let (left, dt) = left?;
        let steps = self.steps(dt);
        (steps > left).then(|| {
            format!(
                "{self} never holds: its duration is {steps} steps, and {left} are left; give a shorter \
                 one"
            )
        })
    }

    /// Whether a value in the range of the measure fulfils it, or one beyond it by rounding.
    fn is_possible(&self) -> bool {
        let (least, greatest) = self.measure.definition().limits();
        match self.operator {
            Operator::Less | Operator::AtMost => self.number >= least - ROUNDING,
            Operator::Greater | Operator::AtLeast => self.number <= greatest + ROUNDING,
        }
    }

    /// Returns whether `value`, the measure's, fulfils it; a duration does not count here.
    #[must_use]
    pub fn is_fulfilled_by(&self, value: Option<f64>) -> bool {
        let number = self.number;
        value.is_some_and(|value| match self.operator {
            Operator::Less => value < number,
            Operator::AtMost => value <= number,
            Operator::Greater => value > number,
            Operator::AtLeast => value >= number,
        })
    }

    /// Returns its duration in steps of `dt`; 0 without one.
    #[must_use]
    pub fn steps(&self, dt: f64) -> u64 {
        self.duration.map_or(0, |time| steps_in(time, dt))
    }
}

impl fmt::Display for Condition {
    /// Writes the normal form, which [`Condition::parse`] reads.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.write(formatter, &self.root, false)
    }
}

impl Condition {
    fn write(&self, to: &mut fmt::Formatter<'_>, node: &Node, in_all: bool) -> fmt::Result {
        let (nodes, word) = match node {
            Node::Comparison(index) => return write!(to, "{}", self.comparisons[*index]),
            Node::All(nodes) => (nodes, " and "),
            Node::Any(nodes) => (nodes, " or "),
        };
        // Only an `or` within an `and` needs parentheses.
        let (open, close) = match node {
            Node::Any(_) if in_all => ("(", ")"),
            _ => ("", ""),
        };
        to.write_str(open)?;
        for (index, part) in nodes.iter().enumerate() {
            if index > 0 {
                to.write_str(word)?;
            }
            self.write(to, part, matches!(node, Node::All(_)))?;
        }
        to.write_str(close)
    }
}

impl fmt::Display for Comparison {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            measure,
            operator,
            number,
            duration,
        } = self;
        write!(to, "{measure} {operator} {}", shortest(*number))?;
        match duration {
            Some(duration) => write!(to, " for {}", shortest(*duration)),
            None => Ok(()),
        }
    }
}

impl fmt::Display for Operator {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        to.write_str(match self {
            Operator::Less => "<",
            Operator::AtMost => "<=",
            Operator::Greater => ">",
            Operator::AtLeast => ">=",
        })
    }
}

/// Returns the shortest text that is read as this number: `20`, `0.9`, `1e-9`.
fn shortest(number: f64) -> String {
    let text = format!("{number:?}");
    text.strip_suffix(".0").map_or(text.clone(), str::to_owned)
}
