//! The parameters of queries, which a selector gives after the key's `?`.

/// A parameter of a query.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct QueryParameter {
    /// Its name.
    pub name: &'static str,
    /// Its valid values, for errors; empty if any text is one, or another error says them.
    pub range: &'static str,
    /// What it is, after its range.
    pub doc: &'static str,
}

/// How many entries a page has at most if the query says nothing, and if it asks for more.
pub const PAGE_ENTRIES: usize = 256;
/// The largest `limit` of a page.
pub const MAX_PAGE_ENTRIES: usize = 1000;
/// The same of a page of a run's time series, which has as many entries if the query says nothing.
pub const MAX_RUN_ENTRIES: usize = 40_000;

/// What a whole number is, in words.
const WHOLE: &str = "a whole number";

const fn parameter(name: &'static str, range: &'static str, doc: &'static str) -> QueryParameter {
    QueryParameter { name, range, doc }
}

/// A parameter that may be any text.
const fn text(name: &'static str, doc: &'static str) -> QueryParameter {
    parameter(name, "", doc)
}

/// Of `state`.
pub const STATE: &[QueryParameter] = &[parameter("format", "`json` or `cbor`", ", the default")];

/// Of `get/measures`.
pub const MEASURES: &[QueryParameter] = &[
    text(
        "names",
        "the measures, separated by commas, such as `order,clusters.count(0.1)`; by default all that need \
         no earlier state",
    ),
    parameter(
        "histogram",
        "`pair_correlation` or `neighbour_density`",
        ", instead of measures",
    ),
    parameter(
        "bins",
        "a whole number from 1 to 10000, of `neighbour_density` to 200",
        ", 50 by default: how many bins an axis of the histogram has",
    ),
    parameter(
        "max",
        "a number above 0, at most 1e6",
        ", 10 by default: the longest distance in the histogram, body sizes",
    ),
];

/// Of a page of entries that are numbered.
pub const PAGE: &[QueryParameter] = &[
    parameter(
        "after",
        WHOLE,
        ", 0 by default: the reply has only entries with higher numbers",
    ),
    parameter(
        "limit",
        "a whole number from 1 to 1000",
        ", 256 by default: the reply has at most this number of entries",
    ),
];

/// Of a page of a run's time series.
pub const PAGE_OF_RUN: &[QueryParameter] = &[
    text("run", "the name of the run, as in the results"),
    parameter(
        "after",
        WHOLE,
        ", 0 by default: the reply has only entries with higher numbers; the first entry is number 1",
    ),
    parameter(
        "limit",
        "a whole number from 1 to 40000",
        ", the default: the reply has at most this number of entries",
    ),
];

/// The same, and what an entry is of.
pub const PAGE_OF_SERIES: &[QueryParameter] = &[
    PAGE_OF_RUN[0],
    PAGE_OF_RUN[1],
    PAGE_OF_RUN[2],
    parameter(
        "of",
        "`individuals`",
        " for the trajectory of the run, in which an entry is an individual at a step; left out for the \
         measures",
    ),
];

/// Of `get/journal`.
pub const PAGE_OF_JOURNAL: &[QueryParameter] = &[
    PAGE[0],
    PAGE[1],
    parameter(
        "line",
        WHOLE,
        ", `next` of the page before: where in the journal this page begins",
    ),
    parameter(
        "from_step",
        WHOLE,
        ": the reply has only commands applied at this step or later, of any epoch",
    ),
    parameter(
        "to_step",
        WHOLE,
        ": the reply has only commands applied at this step or earlier",
    ),
    text("verb", "a verb: the reply has only these commands"),
    text(
        "client",
        "the reply has only commands of this client, or of each client of this user",
    ),
];

/// Of `get/audit`.
pub const PAGE_OF_AUDIT: &[QueryParameter] = &[
    PAGE[0],
    parameter(
        "before",
        WHOLE,
        ": the reply has only lines with lower numbers, the newest of them",
    ),
    PAGE[1],
    text("user", "the reply has only commands of this user"),
    text("client", "the reply has only commands of this client"),
    text("verb", "the reply has only commands with this verb"),
    text(
        "name",
        "the reply has only commands on the swarm, experiment or recording of this name",
    ),
    parameter(
        "from_time",
        "seconds since 1970",
        ": the reply has only lines with a command at or after this time",
    ),
    parameter(
        "to_time",
        "seconds since 1970",
        ": the reply has only lines with a command at or before this time",
    ),
];

/// Of `get/verify`.
pub const VERIFY: &[QueryParameter] = &[parameter(
    "timeout_secs",
    "a number above 0, at most 3600",
    ", 60 by default: the replay ends after this time, and the reply is `deadline_exceeded`",
)];

/// What `replicates` of `get/experiment` can be.
pub const REPLICATES: &str = "a whole number from 1 to 100000";

/// Of `get/experiment`.
pub const EXPORT: &[QueryParameter] = &[
    parameter(
        "replicates",
        REPLICATES,
        ": the file has so many runs, with other seeds than the swarm",
    ),
    text(
        "setpoints",
        "the name of a file, of letters, digits, `.`, `-` and `_`: the file of the experiment names this \
         CSV, which `setpoints` of the reply contains, instead of containing it",
    ),
];

/// Of `get/wait`.
pub const WAIT: &[QueryParameter] = &[
    parameter(
        "step",
        WHOLE,
        ": the reply is sent when the swarm reaches this step",
    ),
    parameter(
        "phase",
        "`paused`, `running` or `faulted`",
        ": the reply is sent when the swarm is in this phase",
    ),
    text(
        "event",
        "the name of a condition, given to `when` as `event`: the reply is sent once it has held, or if the \
         swarm has faulted; it is `not_found` if no such condition waits and none of the newest commands is \
         that it held",
    ),
    text(
        "condition",
        "a condition, such as `order > 0.9 for 20`: the reply is sent when it holds, in the present state or \
         after a later step, or if the swarm has faulted",
    ),
    text(
        "id",
        "with `condition`: the id of the wait, which has the form of a name. The client holds the token of \
         this id; a query that repeats the id and the condition continues the wait. Over HTTP the connection \
         holds the wait, and the id may be left out",
    ),
    parameter(
        "timeout_secs",
        "a number above 0, at most 30",
        ": the reply is `deadline_exceeded` after this time, or earlier if more than 1024 requests wait for \
         the swarm",
    ),
];

/// Of `get/recording`.
pub const RECORDING: &[QueryParameter] = &[
    text("name", "the recording"),
    parameter(
        "part",
        WHOLE,
        ", 0 by default: the number of a complete part",
    ),
    parameter(
        "offset",
        WHOLE,
        ", 0 by default: the byte at which the piece begins",
    ),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_words_have_the_numbers() {
        let limit = |of: &[QueryParameter]| {
            let mut limits = of.iter().filter(|it| it.name == "limit");
            limits.next().map(|it| format!("{}{}", it.range, it.doc))
        };
        let page =
            format!("a whole number from 1 to {MAX_PAGE_ENTRIES}, {PAGE_ENTRIES} by default");
        for of in [PAGE, PAGE_OF_JOURNAL, PAGE_OF_AUDIT] {
            assert!(limit(of).is_some_and(|it| it.starts_with(&page)));
        }
        let of_run = format!("a whole number from 1 to {MAX_RUN_ENTRIES}, the default");
        for of in [PAGE_OF_RUN, PAGE_OF_SERIES] {
            assert!(limit(of).is_some_and(|it| it.starts_with(&of_run)));
        }
    }
}
