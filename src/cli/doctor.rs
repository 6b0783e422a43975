//! `jostled doctor`: says before an upgrade what it will do.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;
use jostle_physics::plural::counted;
use serde_json::json;

use crate::cli::table::aligned;
use crate::cli::{note, print};
use crate::doctor::{self, Marked, Report, Results, Swarm};

/// The exit code if something cannot be read, or the daemon would not start.
const EXIT_PROBLEM: u8 = 1;

/// In place of a value that is not known.
const NONE: &str = "-";

/// Say what this version will do with the swarms, experiments and results of an earlier one.
#[derive(Args, Clone, Debug)]
pub struct Options {
    /// Folders of `jostled run`, or folders that contain some.
    #[arg(value_name = "FOLDER")]
    folders: Vec<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Examines a data folder and the folders of the options, prints what was found and returns the exit code.
/// Only where the data folder was not set (`is_default`), it may lack data beside other folders.
pub fn run(options: &Options, data: &Path, is_default: bool) -> ExitCode {
    let is_optional = is_default && !options.folders.is_empty();
    let is_left_out = is_optional && !doctor::is_data_folder(data);
    let report = doctor::examine((!is_left_out).then_some(data), &options.folders);
    let printed = match options.json {
        true => print(&format!("{}\n", json!(report))),
        false => print(&text(&report)),
    };
    for problem in &report.problems {
        note(&format_args!("jostled: {problem}"));
    }
    match report.problems.is_empty() || printed != ExitCode::SUCCESS {
        true => printed,
        false => ExitCode::from(EXIT_PROBLEM),
    }
}

fn text(report: &Report) -> String {
    let known = |value: Option<String>| value.unwrap_or_else(|| NONE.to_owned());
    let swarm = |it: &Swarm| {
        let checkpoint = it.checkpoint.as_ref();
        [
            it.name.clone(),
            known(checkpoint.and_then(|it| Some(it.phase?.name().to_owned()))),
            known(checkpoint.map(|it| it.step.to_string())),
            known(checkpoint.map(|it| it.model_version.to_string())),
            it.message.clone(),
        ]
    };
    let results = |it: &Results| {
        [
            it.name.clone(),
            known(it.phase.map(|phase| phase.to_string())),
            known(it.runs.map(|it| format!("{}/{}", it.finished, it.runs))),
            known(it.runs.map(|it| it.model_version.to_string())),
            it.message.clone(),
        ]
    };
    let what = "with this version";
    let tables = [
        table(
            ["swarm", "phase", "checkpoint", "model", what],
            report.swarms.iter().map(swarm),
        ),
        table(
            ["experiment", "phase", "finished", "model", what],
            report.experiments.iter().map(results),
        ),
        table(
            ["folder", "phase", "finished", "model", what],
            report.folders.iter().map(results),
        ),
    ];
    let mut text = String::new();
    for table in tables.iter().filter(|it| !it.is_empty()) {
        text.push_str(table);
        text.push('\n');
    }
    if report.recordings > 0 {
        let recordings = counted(report.recordings, "recording");
        // Writing to a string does not fail.
        let _ = writeln!(text, "{recordings}: not affected\n");
    }
    let summary = match report.problems.len() {
        0 => String::new(),
        problems => format!("; {}", counted(problems, "problem")),
    };
    let _ = writeln!(
        text,
        "{} (jostled {}, model version {}){summary}",
        marks(report),
        report.version,
        report.model_version
    );
    text
}

/// The sentence at the end.
fn marks(report: &Report) -> String {
    let Marked {
        swarms,
        experiments,
        folders,
    } = report.marked;
    let all = [
        (swarms, report.swarms.len(), "swarm"),
        (experiments, report.experiments.len(), "experiment"),
        (folders, report.folders.len(), "folder"),
    ];
    if all.iter().all(|(marked, ..)| *marked == 0) {
        return match report.problems.is_empty() {
            true => "nothing will be marked".to_owned(),
            false => "nothing that can be read will be marked".to_owned(),
        };
    }
    let existing = all.into_iter().filter(|(_, all, _)| *all > 0);
    let parts: Vec<String> = existing
        .map(|(marked, all, noun)| format!("{marked} of {}", counted(all, noun)))
        .collect();
    let (last, before) = parts.split_last().expect("something is marked");
    match before.is_empty() {
        true => format!("{last} will be marked"),
        false => format!("{} and {last} will be marked", before.join(", ")),
    }
}

/// A table of the columns that have a value; empty without rows.
fn table(header: [&str; 5], rows: impl Iterator<Item = [String; 5]>) -> String {
    let rows: Vec<_> = rows.collect();
    // Of folders no phase is known.
    let is_shown = |column: usize| rows.iter().any(|row| row[column] != NONE);
    let columns: Vec<usize> = (0..header.len())
        .filter(|column| is_shown(*column))
        .collect();
    let shown = |row: &[String; 5]| columns.iter().map(|&it| row[it].clone()).collect();
    let header = (!rows.is_empty()).then(|| header.map(str::to_owned));
    let lines: Vec<Vec<String>> = header.iter().chain(&rows).map(shown).collect();
    aligned(&lines)
}
