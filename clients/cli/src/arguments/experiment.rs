//! The arguments of `experiment` and `plot`.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueHint};
use clap_complete::engine::ArgValueCompleter;

use crate::arguments::{PlanArguments, SenderArguments};
use crate::completion;
use crate::values;

#[derive(Debug, Args)]
#[command(arg_required_else_help = true, subcommand_value_name = "WHAT")]
pub struct ExperimentArguments {
    #[command(subcommand)]
    pub what: Experiment,
}

#[derive(Debug, Subcommand)]
pub enum Experiment {
    /// Starts an experiment on the daemon and shows its progress, which Ctrl-C ends
    Run(RunExperimentArguments),
    /// Creates the swarm of a run, to be watched and steered, with the commands of its protocol
    Play(PlayArguments),
    /// Splits an experiment into parts that several machines execute, without a daemon
    Plan(PlanArguments),
    /// Lists the experiments with their progress
    List,
    /// Shows the progress of an experiment
    Status(ExperimentNameArguments),
    /// Shows the progress of an experiment until it ends
    Attach(ExperimentNameArguments),
    /// Pauses the runs of an experiment; the next experiment starts
    Pause(ChangeExperimentArguments),
    /// Resumes an experiment that was paused, was cancelled, has failed, or is finished and lacks files
    Resume(ChangeExperimentArguments),
    /// Cancels an experiment and keeps the finished runs
    Cancel(ChangeExperimentArguments),
    /// Deletes an experiment that has ended, with its results
    Delete(ChangeExperimentArguments),
    /// Shows the results of an experiment so far, or writes its tables
    Results(ResultsArguments),
}

impl Experiment {
    /// The name of an experiment that the daemon should have.
    pub fn name(&self) -> Option<&str> {
        match self {
            Experiment::Run(_) | Experiment::Play(_) | Experiment::Plan(_) | Experiment::List => {
                None
            }
            Experiment::Status(arguments) | Experiment::Attach(arguments) => Some(&arguments.name),
            Experiment::Pause(arguments)
            | Experiment::Resume(arguments)
            | Experiment::Cancel(arguments)
            | Experiment::Delete(arguments) => Some(&arguments.name),
            Experiment::Results(arguments) => Some(&arguments.name),
        }
    }
}

/// An example of an experiment file, for the help text.
const EXAMPLE: &str = "\
Such a file, of 18 runs:
  name = \"order\"
  seed = 1
  replicates = 3
  duration = 100

  [[grid]]
  pi1 = [1, 4]
  n = [5, 10, 20]

  [measure]
  order_every = 50";

#[derive(Debug, Args)]
#[command(after_help = EXAMPLE)]
pub struct RunExperimentArguments {
    /// The experiment file, TOML; - for stdin
    #[arg(value_hint = ValueHint::FilePath)]
    pub file: PathBuf,
    /// Its name [default: the one in the file]
    #[arg(long, value_name = "NAME", value_parser = values::name)]
    pub name: Option<String>,
    /// If another version of the model executed the runs of NAME: execute all runs again beside them, as
    /// `NAME-model2` under version 2
    #[arg(long, conflicts_with = "dry_run")]
    pub again: bool,
    /// Do not show its progress
    #[arg(long)]
    pub detach: bool,
    /// Show its conditions, the protocol of its first run, and an estimate of processor time and
    /// disk space; needs no daemon
    #[arg(long, conflicts_with = "detach")]
    pub dry_run: bool,
    #[command(flatten)]
    pub sender: SenderArguments,
}

#[derive(Debug, Args)]
pub struct PlayArguments {
    /// The experiment file, TOML; - for stdin
    #[arg(value_hint = ValueHint::FilePath)]
    pub file: PathBuf,
    /// The run, by its number, from 1, or by its name [default: 1]
    #[arg(long, value_name = "RUN")]
    pub run: Option<String>,
    /// The new swarm's name [default: the one in the file]
    #[arg(long = "as", value_name = "NAME", value_parser = values::name)]
    pub swarm: Option<String>,
    #[command(flatten)]
    pub sender: SenderArguments,
}

/// The name of an experiment.
#[derive(Debug, Args)]
pub struct ExperimentNameArguments {
    /// The experiment
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::experiments))]
    pub name: String,
}

/// The arguments of the verbs that change an experiment.
#[derive(Debug, Args)]
pub struct ChangeExperimentArguments {
    /// The experiment
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::experiments))]
    pub name: String,
    #[command(flatten)]
    pub sender: SenderArguments,
}

#[derive(Debug, Args)]
pub struct ResultsArguments {
    /// The experiment
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::experiments))]
    pub name: String,
    /// Write results.parquet and results.csv into this folder, and series.parquet if the experiment
    /// has `series_every`; or one table to FILE.parquet or FILE.csv
    #[arg(short, long, value_name = "FOLDER|FILE", value_hint = ValueHint::AnyPath)]
    pub out: Option<PathBuf>,
    /// Replace tables of another experiment, or with runs that these results do not have, or a
    /// trajectory
    #[arg(long, requires = "out")]
    pub force: bool,
    /// Print a row for each run as CSV instead of a line for each condition
    #[arg(long, conflicts_with = "out")]
    pub csv: bool,
    /// Average over the runs that share the values of these axes, such as pi3,pi4; `run` for each run
    /// [default: all axes that vary]
    #[arg(long, value_name = "AXES", value_delimiter = ',', conflicts_with_all = ["out", "csv", "order", "series", "trajectory"])]
    pub by: Option<Vec<String>>,
    /// Print only so many lines [default: all, with --json 1000]
    #[arg(long, value_name = "COUNT", value_parser = values::count, allow_negative_numbers = true, conflicts_with_all = ["out", "csv"])]
    pub limit: Option<usize>,
    /// Print all lines with --json, too
    #[arg(long, conflicts_with_all = ["out", "csv", "limit"])]
    pub all: bool,
    /// Print the order of this run over time as CSV, if the experiment measures it
    #[arg(long, value_name = "RUN", conflicts_with_all = ["out", "csv"])]
    pub order: Option<String>,
    /// Print the chosen measures of this run over time as CSV, or those of all runs, if the
    /// experiment has `series_every`
    #[arg(long, value_name = "RUN", num_args = 0..=1, conflicts_with_all = ["out", "csv", "order"])]
    #[expect(
        clippy::option_option,
        reason = "the option without a value means all runs"
    )]
    pub series: Option<Option<String>>,
    /// Write the trajectory of this run to the FILE.parquet or FILE.csv of `-o`, or print it as CSV, if
    /// the experiment has `record_every`
    #[arg(long, value_name = "RUN", conflicts_with_all = ["csv", "order", "series"])]
    pub trajectory: Option<String>,
}

/// Examples of charts, for the help text.
const PLOTS: &str = "\
Pictures of results:
  jostle plot order --y v --x n -o v.svg                 # of an experiment of the daemon
  jostle plot results --y stopped_at -o stopped.png      # of a folder with results
  jostle plot results --y milling --over-time -o m.svg   # needs series_every in [measure]
  jostle plot 2 results -o figure-2.svg                  # the paper's figure 2, 4, 5 or 6
  jostle plot snapshot demo -o now.png                   # the current state of swarms

Points are means over the runs of a condition, bars and bands the 95 % interval of the mean
(Student's t). There is a curve for each combination of the other values that vary. Runs without a
value are left out, and the picture says how many.";

#[derive(Debug, Args)]
#[command(after_help = PLOTS)]
pub struct PlotArguments {
    /// With `--y` an experiment, or a folder or file with results; otherwise a figure of the paper,
    /// 2, 4, 5 or 6, or `snapshot`
    #[arg(value_name = "EXPERIMENT|FOLDER|FIGURE", value_hint = ValueHint::AnyPath, add = ArgValueCompleter::new(completion::plots))]
    pub what: String,
    /// For a figure a folder with results, results.parquet or results.csv; for `snapshot` names of
    /// swarms
    #[arg(value_name = "RESULTS|SWARM", value_hint = ValueHint::AnyPath, add = ArgValueCompleter::new(completion::swarms))]
    pub of: Vec<String>,
    /// The column of the results that is drawn, such as v, stopped_at or milling
    #[arg(long, value_name = "COLUMN")]
    pub y: Option<String>,
    /// The value over which it is drawn [default: the only number that varies]
    #[arg(
        long,
        value_name = "VARIABLE",
        requires = "y",
        conflicts_with = "over_time"
    )]
    pub x: Option<String>,
    /// Draw a measure over time, with a curve for each condition
    #[arg(long, requires = "y")]
    pub over_time: bool,
    /// The output, FILE.svg or FILE.png
    #[arg(short, long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub out: PathBuf,
}
