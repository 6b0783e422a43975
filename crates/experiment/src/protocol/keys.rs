//! The keys of an `[[at]]` and of `[stop]`.

/// What the value of a key is.
#[derive(Clone, Copy, PartialEq)]
pub enum Kind {
    /// A time in time units, 0 or more.
    Time,
    /// A time in time units, above 0.
    Interval,
    /// A whole number, 0 or more.
    Whole,
    /// A condition.
    Condition,
}

/// A key of a block beside its verbs.
pub struct Key {
    pub name: &'static str,
    pub kind: Kind,
    /// What it is, with its unit.
    pub doc: &'static str,
}

const fn key(name: &'static str, kind: Kind, doc: &'static str) -> Key {
    Key { name, kind, doc }
}

/// The keys of a block that say when it is executed, and the key of its draws.
pub const KEYS: [Key; 7] = [
    key(
        "time",
        Kind::Time,
        "Executed once, at the first step at or after this time, in time units.",
    ),
    key("step", Kind::Whole, "Executed once, at this step."),
    key(
        "every",
        Kind::Interval,
        "Executed repeatedly, from `from` to `until`: the time between two executions, in time units.",
    ),
    key(
        "from",
        Kind::Time,
        "The time of the first execution, or from which the condition is evaluated, in time units; 0 if \
         left out.",
    ),
    key(
        "until",
        Kind::Time,
        "The latest time of an execution, in time units; the end of the run if left out.",
    ),
    key(
        "when",
        Kind::Condition,
        "Executed, or the run ended, once this condition holds: comparisons of measures with numbers, \
         joined by `and` and `or`, such as \"order > 0.9 for 20 and drift > $limit\".",
    ),
    key(
        "draw",
        Kind::Whole,
        "The number of its first command, which seeds the draws of that command together with the seed of \
         the run.",
    ),
];

/// The keys of which a block has one, each with those that require it.
pub const TIMINGS: [(&str, &[&str]); 4] = [
    ("time", &[]),
    ("step", &[]),
    ("every", &["from", "until"]),
    ("when", &["from"]),
];

/// The keys of `[stop]`, the first of which is required.
pub const STOP: [&str; 2] = ["when", "from"];

/// The verbs of a block, those of `batch`.
pub const VERBS: [&str; 5] = ["set", "inform", "uninform", "inject", "remove"];

/// Returns the key of this name.
pub fn named(name: &str) -> Option<&'static Key> {
    KEYS.iter().find(|key| key.name == name)
}

/// Returns the keys that require one of [`TIMINGS`], each with those.
pub fn dependent() -> impl Iterator<Item = (&'static str, Vec<&'static str>)> {
    KEYS.iter().filter_map(|key| {
        let timings = TIMINGS.iter().filter(|(_, keys)| keys.contains(&key.name));
        let timings: Vec<&str> = timings.map(|(timing, _)| *timing).collect();
        (!timings.is_empty()).then_some((key.name, timings))
    })
}
