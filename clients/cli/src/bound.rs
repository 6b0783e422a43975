//! How much of what may be long a document has.

use crate::format;

/// The most entries of a document, unless `--limit` or `--all` is given: a megabyte at most.
const MAX_ENTRIES: usize = 1000;

/// Returns how many entries are printed at most.
pub fn most(is_json: bool, limit: Option<usize>, all: bool) -> usize {
    match (limit, is_json) {
        (Some(limit), _) => limit,
        (None, true) if !all => MAX_ENTRIES,
        (None, _) => usize::MAX,
    }
}

/// Says how many entries are left out.
pub fn note(left_out: u64, noun: &str) -> String {
    let more = format::count(left_out, noun);
    format!("{more} more: a higher --limit or --all prints them")
}

/// The entries that are still to be printed, and how many are left out.
#[derive(Clone, Copy, Debug)]
pub struct Bound {
    /// How many may follow.
    pub rest: usize,
    /// How many were left out.
    pub left_out: u64,
}

impl Bound {
    /// Begins with so many entries that may follow.
    pub fn new(most: usize) -> Self {
        Self {
            rest: most,
            left_out: 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn documents_have_a_bound_unless_another_is_given() {
        for (is_json, limit, all, expected) in [
            (true, None, false, 1000),
            (true, Some(7), false, 7),
            (true, Some(70_000), false, 70_000),
            (true, None, true, usize::MAX),
            (false, None, false, usize::MAX),
            (false, Some(7), false, 7),
        ] {
            assert_eq!(most(is_json, limit, all), expected);
        }
    }
}
