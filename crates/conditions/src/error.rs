//! Errors in the text of a condition.

use jostle_measures::MeasureError;
use thiserror::Error;

/// Why the text of a condition is rejected.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("column {column}: {problem}")]
pub struct ConditionError {
    /// The column in characters, from 1.
    pub column: usize,
    /// What is wrong there, and the remedy.
    pub problem: Problem,
}

/// What is wrong with the text of a condition.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Problem {
    /// The text is none of the grammar.
    #[error("expected {0}")]
    Syntax(String),
    /// A measure is unknown, or its argument is wrong.
    #[error("{0}")]
    Measure(Box<MeasureError>),
    /// A number is too large for a double.
    #[error("{0} is not a finite number")]
    NotFinite(String),
    /// A duration is negative or zero.
    #[error("a duration of {0} is not above 0: leave out `for`, or give a time above 0")]
    Duration(f64),
    /// A variable has no value.
    #[error(
        "unknown variable ${0}: an experiment file gives its values in a [[grid]], such as {0} = [0.1, 0.2]"
    )]
    Variable(String),
    /// A selection compares something that there is not, or compares it with what it never is.
    #[error("{0}")]
    Selection(String),
    /// The condition is too long or too deeply nested.
    #[error("{0}")]
    TooLong(&'static str),
}
