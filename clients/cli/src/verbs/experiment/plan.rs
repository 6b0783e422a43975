//! `experiment plan`: splits an experiment into parts for several machines. Needs no daemon.

use std::num::NonZero;

use jostle_experiment::shell::operand;
use jostle_experiment::{MODEL_VERSION, Plan, Subset, missing};
use serde_json::{Value, json};

use super::slurm::{self, Part};
use crate::arguments::{Emit, PlanArguments};
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::table::table;
use crate::verbs::results;

/// The largest number of runs in a list that is an argument of a command.
const MAX_RUNS_OF_LIST: usize = 10_000;

/// Prints how an experiment is split.
pub fn plan(output: Output, arguments: &PlanArguments) -> Result<(), Failure> {
    let files = super::read(output, &arguments.file)
        .map_err(|problem| Failure::argument("FILE", problem))?;
    let plan = Plan::of(files)
        .map_err(|error| Failure::argument(arguments.file.display(), error.to_string()))?;
    let left = match arguments.missing.as_slice() {
        [] => Subset::all(&plan),
        folders => missing(&plan, folders).map_err(results::failure)?,
    };
    let of = match (arguments.parts, arguments.secs) {
        (Some(parts), _) => parts.get(),
        // A list of runs is one argument of a command, of at most 128 KiB.
        (None, Some(secs)) => parts_of(left.expected_secs(&plan), secs)
            .max(left.indices().len().div_ceil(MAX_RUNS_OF_LIST)),
        (None, None) if arguments.missing.is_empty() => 1,
        (None, None) => left.indices().len().div_ceil(MAX_RUNS_OF_LIST),
    };
    // Empty parts would be elements of a job array without work.
    let of = of.min(plan.runs().len()).max(1);
    // Parts of the whole plan have a number; parts of the missing runs are lists of runs.
    let is_by_number = arguments.parts.is_some() || arguments.missing.is_empty();
    let parts = match is_by_number {
        true => incomplete(&plan, &left, of)?,
        false => left.split(&plan, of),
    };
    let parts: Vec<Part> = (1..)
        .zip(parts)
        .map(|(number, runs)| Part { number, runs })
        .filter(|part| !part.runs.indices().is_empty())
        .collect();
    if parts.is_empty() {
        output.note("no run is missing");
        return match output.json && arguments.emit.is_none() {
            true => output.data("[]"),
            false => Ok(()),
        };
    }
    let folder = match &arguments.out {
        Some(folder) => operand(folder.trim_end_matches('/')),
        None => format!("{}-parts", plan.name),
    };
    let document = |part: &Part| document(arguments, &plan, part, of, &folder, is_by_number);
    match arguments.emit {
        Some(Emit::Slurm) if !is_by_number => Err(Failure::argument(
            "--emit slurm",
            "with --missing a job array needs --parts, the number of parts of the first \
                      array",
        )),
        Some(Emit::Slurm) => {
            let file = operand(&arguments.file.display().to_string());
            for name in [&file, &folder] {
                // It would end a comment of the script.
                if name.contains(char::is_control) {
                    return Err(Failure::argument(
                        format!("{name:?}"),
                        "a script cannot contain control characters: rename it",
                    ));
                }
            }
            let script = slurm::script(&plan, &file, &parts, of, &folder);
            output.data(script.trim_end())
        }
        Some(Emit::Jsonl) => {
            for part in &parts {
                output.document(&document(part))?;
            }
            Ok(())
        }
        None if output.json => output.document(&parts.iter().map(document).collect::<Vec<_>>()),
        None => {
            let rows = parts.iter().map(|part| {
                [
                    format!("{}/{of}", part.number),
                    part.runs.indices().len().to_string(),
                    format::duration(part.runs.expected_secs(&plan)),
                ]
            });
            output.data(&table(["part", "runs", "expected"], rows.collect()))
        }
    }
}

/// The parts of the whole plan that are not finished.
fn incomplete(plan: &Plan, left: &Subset, of: usize) -> Result<Vec<Subset>, Failure> {
    let whole = Subset::all(plan).split(plan, of);
    let parts: Vec<Subset> = whole.iter().map(|part| part.and(left)).collect();
    let is_cut = |(part, whole): (&Subset, &Subset)| !part.indices().is_empty() && part != whole;
    match parts.iter().zip(&whole).position(is_cut) {
        None => Ok(parts),
        Some(index) => Err(Failure::argument(
            "--parts",
            format!(
                "some runs of part {}/{of} are finished: use the number of parts that the folders were \
                 executed with, or leave out --parts",
                index + 1
            ),
        )),
    }
}

/// The number of parts that take `secs` each; saturates.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "positive, and bounded by the number of runs afterwards"
)]
fn parts_of(total_secs: f64, secs: f64) -> usize {
    NonZero::new((total_secs / secs).ceil() as usize).map_or(1, NonZero::get)
}

/// A part as JSON, with the command that executes it.
fn document(
    arguments: &PlanArguments,
    plan: &Plan,
    part: &Part,
    of: usize,
    folder: &str,
    is_by_number: bool,
) -> Value {
    let name = format!("{}/{of}", part.number);
    let runs = part.runs.to_string();
    let which = if is_by_number {
        ["--part", &name]
    } else {
        ["--runs", &runs]
    };
    let file = operand(&arguments.file.display().to_string());
    let target = match (is_by_number, part.runs.indices()) {
        (false, [first, ..]) => format!("{folder}/runs-{}", first + 1),
        _ => format!("{folder}/part-{}", part.number),
    };
    let command = ["jostled", "run", &file, which[0], which[1], "-o", &target];
    json!({
        "part": name, "runs": runs, "count": part.runs.indices().len(),
        "expected_secs": part.runs.expected_secs(plan),
        "longest_secs": part.runs.longest_secs(plan), "model_version": MODEL_VERSION,
        "command": command,
    })
}
