//! Comma-separated text, for spreadsheets.

#[cfg(feature = "files")]
mod file;

use std::io::Write;

use super::{axes, extra_names, has_faults};
use crate::{COLUMNS, Cell, FAULT, ResultRow};

#[cfg(feature = "files")]
pub use file::{read, write};

pub fn write_to(to: impl Write, runs: &[ResultRow], extra: &[String]) -> Result<(), csv::Error> {
    let mut writer = csv::WriterBuilder::new()
        // The header is written below, so that a table without rows has one too.
        .has_headers(false)
        .from_writer(to);
    let extra = extra_names(runs, extra);
    let names = COLUMNS.iter().map(|column| column.name);
    let has_faults = has_faults(runs);
    let fault = has_faults.then_some(FAULT);
    writer.write_record(names.chain(extra.iter().copied()).chain(fault))?;
    for run in runs {
        let extra = extra.iter().map(|name| axes::cell(run, name));
        let fault = has_faults.then(|| {
            run.fault
                .as_deref()
                .map_or(Cell::Absent, |it| Cell::Text(it.into()))
        });
        writer.serialize(run.cells().chain(extra).chain(fault).collect::<Vec<_>>())?;
    }
    Ok(writer.flush()?)
}
