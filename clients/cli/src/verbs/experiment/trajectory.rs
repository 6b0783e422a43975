//! The trajectory of a run: the positions and headings of all individuals over time.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::Path;

use jostle_proto::SeriesPage;
use jostle_results::table::trajectory::{About, csv};
use jostle_results::table::{Trajectory, TrajectoryWriter};
use serde_json::json;

use crate::arguments::ResultsArguments;
use crate::bound::{self, Bound};
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::output;
use crate::verbs::experiment::over_time::Pages;
use crate::verbs::experiment::series::check_run;

/// Prints the trajectory of a run, or writes it to a file.
pub async fn results(
    context: &Context,
    arguments: &ResultsArguments,
    run: &str,
) -> Result<(), Failure> {
    let Context { client, output } = context;
    check_run("--trajectory", run)?;
    let query = ("series", run, ";of=individuals");
    let mut rows = Rows {
        pages: Pages::new(client, &arguments.name, query),
        bound: Bound::new(usize::MAX),
    };
    let Some(out) = &arguments.out else {
        rows.bound.rest = bound::most(output.json, arguments.limit, arguments.all);
        if output.json {
            return output.document(&rows.document(run).await?);
        }
        rows.print().await?;
        if rows.bound.left_out > 0 {
            output.note(&bound::note(rows.bound.left_out, "row"));
        }
        return Ok(());
    };
    let is_csv = match out.extension().and_then(|extension| extension.to_str()) {
        Some("csv") => true,
        Some("parquet") => false,
        _ => {
            let problem = "a trajectory is one file: name FILE.parquet or FILE.csv";
            return Err(Failure::argument(out.display(), problem));
        }
    };
    if out.exists() && !arguments.force {
        let problem = "exists: name another, or --force replaces it";
        return Err(Failure::argument(out.display(), problem));
    }
    jostle_atomic_file::remove_abandoned(out);
    let rows = match is_csv {
        true => rows.write_csv(out).await?,
        false => rows.write_parquet(out).await?,
    };
    let document = json!({
        "experiment": arguments.name,
        "run": run,
        "rows": rows,
        "written": [out.display().to_string()],
    });
    let text = format!(
        "wrote {} of run {run:?} to {}",
        format::count(rows, "row"),
        out.display()
    );
    output.print(&document, &text)
}

/// The rows of a trajectory.
struct Rows<'a> {
    pages: Pages<'a>,
    bound: Bound,
}

impl Rows<'_> {
    /// Fetches the next page; none at the end.
    async fn next(&mut self) -> Result<Option<(Trajectory, Option<About>)>, Failure> {
        let Some(page): Option<SeriesPage> = self.pages.next(&mut self.bound).await? else {
            return Ok(None);
        };
        let pairs = page.about.clone().map(Vec::into_iter);
        let about = pairs.map(|pairs| pairs.map(|it| (it.key, it.value)).collect());
        Ok(Some((rows(page)?, about)))
    }

    async fn print(&mut self) -> Result<(), Failure> {
        let mut is_first = true;
        while let Some((rows, _)) = self.next().await? {
            output::write(lines(&csv(&rows), is_first))?;
            is_first = false;
        }
        Ok(())
    }

    async fn document(&mut self, run: &str) -> Result<serde_json::Value, Failure> {
        let (mut all, mut about) = (Trajectory::default(), None);
        while let Some((rows, first)) = self.next().await? {
            all.extend(&rows);
            about = about.or(first);
        }
        Ok(json!({
            "run": run,
            "about": about,
            "step": all.step,
            "time": all.time,
            "id": all.id,
            "x": all.x,
            "y": all.y,
            "alpha": all.alpha,
            "informed": all.informed,
            "left_out": self.bound.left_out,
        }))
    }

    /// Writes a file; returns the number of rows.
    async fn write_parquet(&mut self, out: &Path) -> Result<u64, Failure> {
        let (mut writer, mut count) = (None, 0);
        while let Some((rows, about)) = self.next().await? {
            let writer = match &mut writer {
                Some(writer) => writer,
                none => {
                    let begun = TrajectoryWriter::begin(out, &about.unwrap_or_default());
                    none.insert(begun.map_err(Failure::results)?)
                }
            };
            writer.append(&rows).map_err(Failure::results)?;
            count += rows.len() as u64;
        }
        if let Some(writer) = writer {
            writer.finish().map_err(Failure::results)?;
        }
        Ok(count)
    }

    /// Writes a file; returns the number of rows.
    async fn write_csv(&mut self, out: &Path) -> Result<u64, Failure> {
        let fail = |error| Failure::file(out.display(), error);
        let mut file = jostle_atomic_file::begin(out).map_err(fail)?;
        let mut count = 0;
        while let Some((rows, _)) = self.next().await? {
            let text = csv(&rows);
            file.write_all(lines(&text, count == 0).as_bytes())
                .map_err(fail)?;
            count += rows.len() as u64;
        }
        jostle_atomic_file::publish(file, out).map_err(fail)?;
        Ok(count)
    }
}

/// Returns CSV with its header, or without.
fn lines(csv: &str, has_header: bool) -> &str {
    match csv.split_once('\n') {
        Some((_, lines)) if !has_header => lines,
        _ => csv,
    }
}

/// Returns the rows of a page.
fn rows(page: SeriesPage) -> Result<Trajectory, Failure> {
    #![expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "steps and ids are whole numbers"
    )]
    let count = page.step.len();
    let columns = page.measures.into_iter().map(|it| (it.name, it.value));
    let mut columns: BTreeMap<String, Vec<f64>> = columns.collect();
    let mut column = |name: &str| {
        let values = columns.remove(name).filter(|it| it.len() == count);
        values.ok_or_else(|| {
            // An earlier version has no trajectories and rejects the query.
            Failure::defect(format!(
                "the daemon sent a trajectory without a column {name}"
            ))
        })
    };
    let (id, informed) = (column("id")?, column("informed")?);
    Ok(Trajectory {
        step: page.step.iter().map(|step| *step as u64).collect(),
        id: id.iter().map(|id| *id as u32).collect(),
        x: column("x")?,
        y: column("y")?,
        alpha: column("alpha")?,
        informed: informed.iter().map(|it| *it > 0.0).collect(),
        time: page.time,
    })
}
