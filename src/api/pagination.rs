//! `get/events` and `get/journal`: what came after a number.

use crate::convert::commands::{CommandError, selector};

/// How many records an answer holds unless told otherwise, and at most.
const LIMIT: usize = 256;
const MOST: usize = 1000;

/// Reads of which run, after which number and how many at most, from a selector's parameters.
///
/// # Errors
///
/// [`CommandError`] when one is unknown or outside its range, or there is no run.
pub fn read_series<'a>(
    parameters: impl Iterator<Item = (&'a str, &'a str)>,
    most: usize,
) -> Result<(&'a str, u64, usize), CommandError> {
    let (mut run, mut after, mut limit) = (None, 0, most);
    for (name, value) in selector(parameters, &["run", "after", "limit"])? {
        match name {
            "run" => run = Some(value),
            "after" => after = value.parse().map_err(|_| wrong("after"))?,
            _ => limit = up_to(most, value)?,
        }
    }
    let run = run.ok_or(CommandError::Field {
        field: "run",
        problem: "is missing: name one as the results have it",
    })?;
    Ok((run, after, limit))
}

/// Reads after which number and how many at most, from a selector's parameters.
///
/// # Errors
///
/// [`CommandError`] when one is unknown or outside its range.
pub fn read<'a>(
    parameters: impl Iterator<Item = (&'a str, &'a str)>,
) -> Result<(u64, usize), CommandError> {
    let (mut after, mut limit) = (0, LIMIT);
    for (name, value) in selector(parameters, &["after", "limit"])? {
        match name {
            "after" => after = value.parse().map_err(|_| wrong("after"))?,
            _ => limit = up_to(MOST, value)?,
        }
    }
    Ok((after, limit))
}

fn up_to(most: usize, value: &str) -> Result<usize, CommandError> {
    let number = value.parse().ok();
    number
        .filter(|number| (1..=most).contains(number))
        .ok_or_else(|| wrong("limit"))
}

fn wrong(field: &'static str) -> CommandError {
    CommandError::Field {
        field,
        problem: "is not a whole number in its range; `;` is what parts two parameters",
    }
}
