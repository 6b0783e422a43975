//! `get/events` and `get/journal`: what came after a number.

use crate::command::{CommandError, selector};

/// How many records an answer holds unless told otherwise, and at most.
const LIMIT: usize = 256;
const MOST: usize = 1000;

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
        let wrong = |field| CommandError::Field {
            field,
            problem: "is not a whole number in its range; `;` is what parts two parameters",
        };
        match name {
            "after" => after = value.parse().map_err(|_| wrong("after"))?,
            _ => {
                let number = value.parse().ok();
                let allowed = number.filter(|number| (1..=MOST).contains(number));
                limit = allowed.ok_or_else(|| wrong("limit"))?;
            }
        }
    }
    Ok((after, limit))
}
