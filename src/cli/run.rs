//! `jostled run`: executes an experiment without a daemon.

use std::error::Error;
use std::io::{BufWriter, IsTerminal as _, Write as _};
use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use jostle_physics::plural::counted;
use serde_json::json;
use signal_hook::consts::{SIGINT, SIGTERM};

use crate::cli::{duration, note};
use jostle_experiment::shell::{operand, quoted};
use jostle_experiment::stdout::{self, StdoutError};
use jostle_experiment::{
    DryRun, Execution, ExecutionControl, Files, Folder, FolderError, MODEL_VERSION, Outcome, Plan,
    PlanError, Progress, Subset, SubsetError, execute, folder_again, start_remark, unfinished,
};

/// The interval between updates of the progress bar, and between checks for a signal.
const UPDATE_INTERVAL: Duration = Duration::from_millis(50);

/// The interval between progress lines without a terminal.
const LINE_INTERVAL: Duration = Duration::from_secs(10);

/// The number of runs that ended early that are listed.
const MAX_LISTED: usize = 10;

/// The exit code after SIGINT or SIGTERM.
const INTERRUPTED: u8 = 130;

/// After this time a second signal ends the process without checkpoints and tables. Some programs,
/// such as `timeout`, send a signal twice: to the process and to its group.
const FORCE_AFTER: Duration = Duration::from_secs(1);

/// Execute an experiment without a daemon; finished runs are not executed again.
#[derive(Args, Clone, Debug)]
pub struct Options {
    /// Experiment file (TOML).
    file: PathBuf,
    /// Folder of the results; an interrupted experiment in it is resumed.
    #[arg(
        short,
        long,
        value_name = "FOLDER",
        required_unless_present = "dry_run"
    )]
    output: Option<PathBuf>,
    /// Execute only part K of N; parts have nearly equal expected times. FOLDER is created when
    /// the part is complete, unless it exists before. `jostle results merge` merges all parts.
    #[arg(long, value_name = "K/N", value_parser = part)]
    part: Option<SelectedRuns>,
    /// Execute only these runs, such as `17,18,40-60`; `--dry-run` lists their numbers.
    #[arg(long, value_name = "LIST", conflicts_with = "part")]
    runs: Option<String>,
    /// Interval between checkpoints of each run, such as `5m`; also written on Ctrl-C and
    /// SIGTERM. The next execution resumes from them, with the same results.
    #[arg(long, value_name = "DURATION", value_parser = duration::parse, conflicts_with = "dry_run")]
    checkpoint: Option<Duration>,
    /// Number of runs executed in parallel [default: number of cores].
    #[arg(long, value_name = "N")]
    threads: Option<NonZero<usize>>,
    /// If another version of the model executed the runs in FOLDER: execute all runs again, in a folder beside
    /// it, `FOLDER-model2` under version 2.
    #[arg(long, conflicts_with = "dry_run")]
    again: bool,
    /// Print JSON.
    #[arg(long)]
    json: bool,
    /// List the runs with their numbers and seeds; on stderr show the protocol of the first one and
    /// estimate processor time and disk space from about a second of steps. Writes nothing.
    #[arg(long, conflicts_with = "output")]
    dry_run: bool,
}

impl Options {
    fn selected_runs(&self) -> SelectedRuns {
        let runs = || self.runs.clone().map(SelectedRuns::Runs);
        self.part.clone().or_else(runs).unwrap_or(SelectedRuns::All)
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum SelectedRuns {
    /// All of them.
    All,
    /// Part `number` of `of`, which count from 1.
    Part { number: usize, of: usize },
    /// Those with these numbers, such as `17,18,40-60`.
    Runs(String),
}

impl SelectedRuns {
    fn subset(&self, plan: &Plan) -> Result<Subset, SubsetError> {
        match self {
            SelectedRuns::All => Ok(Subset::all(plan)),
            SelectedRuns::Part { number, of } => Subset::part(plan, *number, *of),
            SelectedRuns::Runs(text) => Subset::parse(plan, text),
        }
    }

    /// A label of the part in a file's name; none for all runs.
    fn label(&self) -> Option<String> {
        match self {
            SelectedRuns::All => None,
            SelectedRuns::Part { number, of } => Some(format!("{number}-of-{of}")),
            SelectedRuns::Runs(text) => {
                let hash = blake3::hash(text.as_bytes()).to_hex();
                Some(format!("runs-{}", &hash[..8]))
            }
        }
    }

    /// The options that select it on the command line, with a space before them.
    fn options(&self) -> String {
        match self {
            SelectedRuns::All => String::new(),
            SelectedRuns::Part { number, of } => format!(" --part {number}/{of}"),
            SelectedRuns::Runs(text) => format!(" --runs {}", quoted(text)),
        }
    }
}

fn part(text: &str) -> Result<SelectedRuns, String> {
    let parsed = text.split_once('/').and_then(|(number, of)| {
        let (number, of) = (number.parse().ok()?, of.parse().ok()?);
        Some(SelectedRuns::Part { number, of })
    });
    parsed.ok_or_else(|| {
        "use the number of the part and the number of parts, such as 3/40".to_owned()
    })
}

/// Executes an experiment and returns the exit code.
pub fn run(options: &Options) -> Result<u8, Box<dyn Error>> {
    let file = options.file.display();
    let files = Files::read(&options.file)?;
    for warning in files.warnings(&options.file) {
        note(&format_args!("jostled: warning: {warning}"));
    }
    let failed = |error: &PlanError| format!("failed to plan {file}: {error}");
    let (plan, accepted) = Plan::new_or_stored(files).map_err(|error| failed(&error))?;
    let selected = options.selected_runs();
    let subset = selected
        .subset(&plan)
        .map_err(|error| format!("failed to select runs of {file}: {error}"))?;
    let Some(output) = &options.output else {
        accepted.as_ref().map_err(failed)?;
        stdout::unless_closed(list(&plan, &subset, options.json))?;
        let dry_run = DryRun::of(&plan, &subset)?;
        // Standard output has the runs alone, for programs.
        match options.json {
            true => {
                let summary = format!("{}\n", json!({"summary": dry_run}));
                stdout::unless_closed(stdout::write(summary.as_bytes()))?;
            }
            false => note(&dry_run),
        }
        return Ok(0);
    };
    // Removes a final `.`, to which no folder can be renamed.
    let output = output.components().collect::<PathBuf>();
    let open = |output: PathBuf| {
        let target = Target::of(output, &selected);
        if !Files::stored(&target.path).is_ok_and(|files| files == plan.files) {
            accepted.as_ref().map_err(failed)?;
        }
        let folder = Folder::open(&target.path, &plan);
        Ok::<_, Box<dyn Error>>((target, folder))
    };
    let (mut target, mut folder) = open(output.clone())?;
    if let Err(FolderError::OtherModel { theirs, .. }) = folder {
        if !options.again {
            return Err(other_model(options, &output, theirs));
        }
        (target, folder) = open(folder_again(&output))?;
    }
    let mut folder = folder?;
    if let Some(version) = plan.start_model_version() {
        note(&format_args!("jostled: {}", start_remark(version)));
    }
    let lacking = folder.lacking().and(&subset);
    if !lacking.indices().is_empty() {
        let count = counted(lacking.indices().len(), "run");
        note(&format_args!(
            "jostled: {count} of {} lack files and are executed again: {lacking}",
            folder.path().display()
        ));
    }
    let control = ExecutionControl::new();
    let interrupted = Arc::new(AtomicBool::new(false));
    let has_time_passed = Arc::new(AtomicBool::new(false));
    let mut interrupted_at = None;
    for signal in [SIGINT, SIGTERM] {
        let code = i32::from(INTERRUPTED);
        signal_hook::flag::register_conditional_shutdown(signal, code, has_time_passed.clone())
            .and_then(|_| signal_hook::flag::register(signal, interrupted.clone()))
            .map_err(|error| format!("failed to register signal handlers: {error}"))?;
    }
    let cores = || thread::available_parallelism().unwrap_or(NonZero::<usize>::MIN);
    let threads = options.threads.unwrap_or_else(cores).get();
    let outcome = thread::scope(|scope| {
        let (folder, control) = (&mut folder, &control);
        let execution = Execution {
            plan: &plan,
            subset: &subset,
            threads,
            checkpoint_every: options.checkpoint,
        };
        let executing = scope.spawn(move || execute(execution, folder, control));
        let mut display = Display::new(options.json);
        while !executing.is_finished() {
            if interrupted.load(Ordering::Relaxed) {
                control.cancel();
                let since = interrupted_at.get_or_insert_with(Instant::now);
                if since.elapsed() >= FORCE_AFTER {
                    has_time_passed.store(true, Ordering::Relaxed);
                }
            }
            display.show(&control.progress());
            thread::sleep(UPDATE_INTERVAL);
        }
        display.clear();
        executing.join()
    });
    let outcome = outcome
        .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        .map_err(|error| format!("failed to execute the experiment: {error}"))?;
    if target.is_renamed && !outcome.is_cancelled {
        folder.rename(&target.output)?;
    }
    let text = describe_outcome(options, folder.path(), &outcome, &control.progress());
    let written = stdout::write(text.as_bytes());
    if outcome.is_cancelled && !options.json {
        let output = options.output.as_deref().unwrap_or(folder.path());
        let command = command(options, output);
        note(&format_args!("jostled: interrupted; `{command}` continues"));
    }
    stdout::unless_closed(written)?;
    Ok(if outcome.is_cancelled { INTERRUPTED } else { 0 })
}

/// Where results are written.
struct Target {
    /// The folder of the results.
    output: PathBuf,
    /// The folder in which they are computed.
    path: PathBuf,
    /// Whether `path` is renamed to `output` when all runs are finished.
    is_renamed: bool,
}

impl Target {
    /// A part is renamed when it is complete, unless the folder exists, such as a mount.
    fn of(output: PathBuf, selected: &SelectedRuns) -> Self {
        let exists = std::fs::symlink_metadata(&output).is_ok();
        let label = selected.label().filter(|_| !exists);
        let path = label.as_ref().map(|label| unfinished(&output, label));
        Self {
            is_renamed: path.is_some(),
            path: path.unwrap_or_else(|| output.clone()),
            output,
        }
    }
}

/// The error of a folder whose runs another version of the model executed; with `--json` also on standard
/// output, for programs.
fn other_model(options: &Options, output: &Path, theirs: u32) -> Box<dyn Error> {
    let again = folder_again(output);
    let message = format!(
        "version {theirs} of the model executed the runs in {}, and this program has {MODEL_VERSION}: they remain \
         readable, and none is added; `{} --again` executes all of them again, in {}",
        output.display(),
        command(options, output),
        again.display()
    );
    if options.json {
        let details = json!({"model_version": theirs, "again": again.to_string_lossy()});
        let error = json!({"code": "conflict", "message": message, "details": details});
        let document = format!("{}\n", json!({"error": error}));
        if let Err(error) = stdout::unless_closed(stdout::write(document.as_bytes())) {
            return error.into();
        }
    }
    message.into()
}

/// Lists runs without executing them.
fn list(plan: &Plan, subset: &Subset, is_json: bool) -> Result<(), StdoutError> {
    let mut out = BufWriter::new(std::io::stdout().lock());
    for &index in subset.indices() {
        let run = &plan.runs()[index];
        let point = plan.point(run);
        let number = index + 1;
        match is_json {
            true => writeln!(
                out,
                "{}",
                json!({"number": number, "run": run.name, "seed": run.seed, "n": point.spec.n,
                    "informed": point.informed, "steps": point.steps,
                    "expected_secs": point.expected_secs()})
            ),
            false => writeln!(out, "{number}\t{}\t{}", run.seed, run.name),
        }?;
    }
    Ok(out.flush()?)
}

/// The progress: a bar on a terminal, else a line at each interval.
struct Display {
    bar: Option<ProgressBar>,
    printed: Instant,
    is_quiet: bool,
}

impl Display {
    fn new(is_quiet: bool) -> Self {
        let has_bar = std::io::stderr().is_terminal() && !is_quiet;
        let template = "{bar:30} {percent:>3} %  {msg}";
        Self {
            bar: has_bar.then(|| {
                let style = ProgressStyle::with_template(template).expect("a constant");
                ProgressBar::new(1000).with_style(style)
            }),
            printed: Instant::now(),
            is_quiet,
        }
    }

    fn show(&mut self, progress: &Progress) {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a share of 1000"
        )]
        let position = (progress.share * 1000.0) as u64;
        let text = describe(progress);
        match &self.bar {
            Some(bar) => {
                bar.set_position(position);
                bar.set_message(text);
            }
            None if !self.is_quiet && self.printed.elapsed() >= LINE_INTERVAL => {
                note(&format_args!("jostled: {:3} %, {text}", position / 10));
                self.printed = Instant::now();
            }
            None => {}
        }
    }

    fn clear(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

fn describe(progress: &Progress) -> String {
    let runs = counted(progress.runs, "run");
    let mut text = format!("{} of {runs}", progress.finished);
    if progress.faulted > 0 {
        text.push_str(&format!(", {} ended early", progress.faulted));
    }
    if let Some(left) = progress.left_secs {
        text.push_str(&format!(", {} left", duration::text(left)));
    }
    text
}

/// The outcome on standard output.
fn describe_outcome(
    options: &Options,
    output: &Path,
    outcome: &Outcome,
    progress: &Progress,
) -> String {
    let (runs, finished, faults) = (outcome.runs, outcome.finished, &outcome.faults);
    if let Some(error) = &outcome.checkpoint_error {
        note(&format_args!(
            "jostled: failed to write a checkpoint: {error}"
        ));
    }
    if options.json {
        let faults: Vec<_> = faults
            .iter()
            .map(|(run, reason)| json!({"run": run, "reason": reason}))
            .collect();
        let summary = json!({"runs": runs, "finished": finished, "faults": faults,
            "cancelled": outcome.is_cancelled, "elapsed_secs": progress.elapsed_secs,
            "folder": output.to_string_lossy()});
        return format!("{summary}\n");
    }
    let counted = if finished == runs {
        runs.to_string()
    } else {
        format!("{finished} of {runs}")
    };
    let mut text = String::new();
    for (name, value) in [
        ("runs finished", counted),
        ("ended early", faults.len().to_string()),
        ("took", duration::text(progress.elapsed_secs)),
        (
            "results",
            output.join("results.{parquet,csv}").display().to_string(),
        ),
    ] {
        text += &format!(" {name:13}  {value}\n");
    }
    for (run, reason) in faults.iter().take(MAX_LISTED) {
        text += &format!("{run} ended early: {reason}\n");
    }
    if faults.len() > MAX_LISTED {
        let more = faults.len() - MAX_LISTED;
        text += &format!("and {more} more: see runs.jsonl\n");
    }
    text
}

/// The command that executes the same runs again.
fn command(options: &Options, output: &Path) -> String {
    let path = |path: &Path| quoted(&operand(&path.to_string_lossy()));
    let (file, selection, output) = (
        path(&options.file),
        options.selected_runs().options(),
        path(output),
    );
    let mut command = format!("jostled run {file}{selection} -o {output}");
    if options.again {
        command.push_str(" --again");
    }
    if let Some(every) = options.checkpoint {
        command.push_str(&format!(" --checkpoint {}s", every.as_secs_f64()));
    }
    if let Some(threads) = options.threads {
        command.push_str(&format!(" --threads {threads}"));
    }
    command
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_that_continues_is_quoted_and_has_all_options() {
        let mut options = Options {
            file: "my order.toml".into(),
            output: None,
            part: Some(SelectedRuns::Part { number: 3, of: 40 }),
            runs: None,
            threads: NonZero::new(2),
            checkpoint: Some(Duration::from_millis(1500)),
            json: false,
            again: false,
            dry_run: false,
        };
        let expected = "jostled run 'my order.toml' --part 3/40 -o './-o$' --checkpoint 1.5s \
                        --threads 2";
        assert_eq!(command(&options, Path::new("-o$")), expected);
        (options.part, options.runs) = (None, Some("1, 2".to_owned()));
        (options.threads, options.checkpoint) = (None, None);
        let expected = "jostled run 'my order.toml' --runs '1, 2' -o out";
        assert_eq!(command(&options, Path::new("out")), expected);
    }
}
