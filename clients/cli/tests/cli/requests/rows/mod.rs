//! The table: the effect of each argument of each verb on the requests or the output.

mod commands;
mod jobs;
mod queries;

use crate::requests::row::Row;

/// Every row. The first of a verb has only options that all its rows have.
pub fn rows() -> Vec<Row> {
    [
        commands::creating(),
        commands::steering(),
        commands::individuals(),
        commands::copies(),
        queries::inspecting(),
        queries::watching(),
        jobs::recordings(),
        jobs::experiments(),
        jobs::local(),
    ]
    .concat()
}
