//! The arguments of the verbs about experiments and their figures.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueHint};
use clap_complete::engine::ArgValueCompleter;

use crate::arguments::{PlanArguments, SenderArguments};
use crate::completion;
use crate::values;

/// What to do with experiments.
#[derive(Debug, Args)]
#[command(arg_required_else_help = true, subcommand_value_name = "WHAT")]
pub struct ExperimentArguments {
    /// What to do.
    #[command(subcommand)]
    pub what: Experiment,
}

/// What to do with experiments.
#[derive(Debug, Subcommand)]
pub enum Experiment {
    /// Has the daemon carry out an experiment, and shows how far it is; Ctrl-C only stops showing
    Run(RunExperimentArguments),
    /// Splits an experiment into parts that several machines execute, without a daemon
    Plan(PlanArguments),
    /// Lists experiments and how far they are
    List,
    /// Shows how far an experiment is
    Status(ExperimentNameArguments),
    /// Shows how far an experiment is until it is over
    Attach(ExperimentNameArguments),
    /// Has the runs of an experiment stand still; the next experiment begins
    Pause(ChangeExperimentArguments),
    /// Has a paused experiment go on, or one that was cancelled or failed
    Resume(ChangeExperimentArguments),
    /// Ends an experiment; what is finished is kept
    Cancel(ChangeExperimentArguments),
    /// Deletes an experiment that is over, with its results
    Delete(ChangeExperimentArguments),
    /// Shows what came of an experiment so far, or writes its tables
    Results(ResultsArguments),
}

impl Experiment {
    /// The experiment that it is about, if that is on the daemon already.
    pub fn name(&self) -> Option<&str> {
        match self {
            Experiment::Run(_) | Experiment::Plan(_) | Experiment::List => None,
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

/// Which experiment to carry out.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLE)]
pub struct RunExperimentArguments {
    /// The file that describes it, TOML; - for stdin
    #[arg(value_hint = ValueHint::FilePath)]
    pub file: PathBuf,
    /// What to call it [default: its name in the file]
    #[arg(long, value_name = "NAME", value_parser = values::name)]
    pub name: Option<String>,
    /// Do not show how far it is
    #[arg(long)]
    pub detach: bool,
    /// Who sends it.
    #[command(flatten)]
    pub sender: SenderArguments,
}

/// Which experiment.
#[derive(Debug, Args)]
pub struct ExperimentNameArguments {
    /// The experiment
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::experiments))]
    pub name: String,
}

/// Which experiment to change.
#[derive(Debug, Args)]
pub struct ChangeExperimentArguments {
    /// The experiment
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::experiments))]
    pub name: String,
    /// Who sends it.
    #[command(flatten)]
    pub sender: SenderArguments,
}

/// Whose results to show or write where.
#[derive(Debug, Args)]
pub struct ResultsArguments {
    /// The experiment
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::experiments))]
    pub name: String,
    /// Write results.parquet and results.csv into this folder, or one table to FILE.parquet or
    /// FILE.csv
    #[arg(short, long, value_name = "FOLDER|FILE", value_hint = ValueHint::AnyPath)]
    pub out: Option<PathBuf>,
    /// Print a row for each run as CSV instead of a line for each condition
    #[arg(long, conflicts_with = "out")]
    pub csv: bool,
    /// Print the order of this run over time as CSV, if the experiment measures it
    #[arg(long, value_name = "RUN", conflicts_with_all = ["out", "csv"])]
    pub order: Option<String>,
}

/// What to draw, of what, to where.
#[derive(Debug, Args)]
pub struct FigureArguments {
    /// The paper's figure, 2, 4, 5 or 6, or `snapshot` of swarms as they are now
    #[arg(value_parser = values::figure, add = ArgValueCompleter::new(completion::figures))]
    pub kind: values::Figure,
    /// A folder with results, results.parquet or results.csv; of `snapshot` swarms
    #[arg(required = true, value_name = "RESULTS|SWARM", value_hint = ValueHint::AnyPath, add = ArgValueCompleter::new(completion::swarms))]
    pub of: Vec<String>,
    /// The picture, FILE.svg or FILE.png
    #[arg(short, long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub out: PathBuf,
}
