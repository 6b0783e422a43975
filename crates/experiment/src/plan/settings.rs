//! Reads the settings that all runs share: `seeds` and `[measure]`.

use jostle_measures::{Measure, MeasureError};
use toml::Spanned;

use super::Columns;
use crate::error::PlanError;
use crate::file::{File, Measure as MeasureTable, Source};
use crate::limits::{MAX_BLOCKS, MAX_COLUMNS, MAX_RUNS, SEEDS, STEPS_BETWEEN};
use crate::protocol::first_span;

/// Checks the number of blocks and of columns.
pub fn check_sizes(source: Source<'_>, file: &File) -> Result<(), PlanError> {
    if let Some(first) = file.at.get(MAX_BLOCKS) {
        let span = first_span(first);
        return Err(source.reject(&span, format!("a file has at most {MAX_BLOCKS} [[at]]")));
    }
    if let Some(first) = file.measure.columns.get(MAX_COLUMNS) {
        let reason = format!("[measure] has at most {MAX_COLUMNS} columns");
        return Err(source.reject(&first.span(), reason));
    }
    Ok(())
}

/// Reads the seeds of the runs; none if they are derived.
pub fn seeds(source: Source<'_>, file: &File) -> Result<Option<Vec<u64>>, PlanError> {
    let Some(seeds) = &file.seeds else {
        return Ok(None);
    };
    let first = seeds.first().map_or(0..0, Spanned::span);
    let grids = file.grid.iter().flat_map(|table| table.keys());
    let mut of_grids = grids.filter(|key| key.get_ref() == "replicates");
    let reason = if file.replicates.is_some() || of_grids.next().is_some() {
        "seeds and replicates exclude each other: leave out replicates"
    } else if seeds.is_empty() || seeds.len() as u64 > MAX_RUNS {
        "seeds: give at least one"
    } else if is_repeated(seeds) {
        "seeds: a seed is given twice: its runs would be the same"
    } else {
        let whole = |seed| source.whole("seeds", Some(seed), 0, SEEDS);
        return seeds.iter().map(whole).collect::<Result<_, _>>().map(Some);
    };
    Err(source.reject(&first, reason))
}

fn is_repeated(seeds: &[Spanned<u64>]) -> bool {
    let mut sorted: Vec<u64> = seeds.iter().map(|seed| *seed.get_ref()).collect();
    sorted.sort_unstable();
    sorted.windows(2).any(|pair| pair[0] == pair[1])
}

/// Reads the chosen columns of `[measure]`.
pub fn columns(
    source: Source<'_>,
    file: &MeasureTable,
    duration: f64,
) -> Result<Columns, PlanError> {
    let every = source.whole("every", file.every.as_ref(), 1, STEPS_BETWEEN)?;
    let from = file.from.as_ref().map_or(0.0, |from| *from.get_ref());
    if let Some(given) = &file.from
        && !(from >= 0.0 && from < duration)
    {
        let reason = format!("from = {from} is outside [0, {duration}), the time of a run");
        return Err(source.reject(&given.span(), reason));
    }
    let mut measures: Vec<Measure> = Vec::new();
    for name in &file.columns {
        let reject = |reason: String| source.reject(&name.span(), reason);
        let measure: Measure = name
            .get_ref()
            .parse()
            .map_err(|error: MeasureError| reject(error.to_string()))?;
        if measures.contains(&measure) {
            return Err(reject(format!("{measure} is given twice")));
        }
        measures.push(measure);
    }
    let series_every = file.series_every.as_ref();
    let series = source.whole("series_every", series_every, 0, STEPS_BETWEEN)?;
    if let Some(given) = series_every
        && measures.is_empty()
    {
        let reason = "series_every without columns: list the measures in columns of [measure]";
        return Err(source.reject(&given.span(), reason));
    }
    Ok(Columns {
        measures,
        from,
        every,
        series_every: (series > 0).then_some(series),
    })
}
