//! The arguments of the verbs about parts of an experiment, which several machines execute.

use std::num::NonZero;
use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum, ValueHint};

use crate::values;

/// How to split an experiment.
#[derive(Debug, Args)]
pub struct PlanArguments {
    /// The file that describes it, TOML
    #[arg(value_hint = ValueHint::FilePath)]
    pub file: PathBuf,
    /// Number of parts, which need about the same time [default: 1]
    #[arg(long, value_name = "COUNT", conflicts_with = "secs")]
    pub parts: Option<NonZero<usize>>,
    /// As many parts as are needed for each to take this long on one core, about
    #[arg(long, value_name = "SECS", value_parser = values::seconds)]
    pub secs: Option<f64>,
    /// Only what is not finished in these folders of parts, or in a folder with them: with --parts the incomplete parts, otherwise the
    /// missing runs
    #[arg(long, value_name = "FOLDER", num_args = 1.., value_hint = ValueHint::DirPath)]
    pub missing: Vec<PathBuf>,
    /// Print a Slurm script of a job array, or a line of JSON for each part, instead of a table
    #[arg(long, value_enum)]
    pub emit: Option<Emit>,
    /// The folder in which the printed commands write parts [default: the experiment's name and
    /// `-parts`]
    #[arg(short, long, value_name = "FOLDER", value_hint = ValueHint::DirPath)]
    pub out: Option<String>,
}

/// What to print of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Emit {
    /// A batch script for `sbatch`.
    Slurm,
    /// A line of JSON for each part, with its command.
    Jsonl,
}

/// What to do with results.
#[derive(Debug, Args)]
#[command(arg_required_else_help = true, subcommand_value_name = "WHAT")]
pub struct ResultsVerbArguments {
    /// What to do.
    #[command(subcommand)]
    pub what: Results,
}

/// What to do with results.
#[derive(Debug, Subcommand)]
pub enum Results {
    /// Merges the parts of an experiment that several machines executed
    Merge(MergeArguments),
}

/// Which parts to merge, and where to.
#[derive(Debug, Args)]
pub struct MergeArguments {
    /// The folders of all parts, as `jostled run --part` wrote them, or a folder with all of them
    #[arg(required = true, value_name = "FOLDER", value_hint = ValueHint::DirPath)]
    pub parts: Vec<PathBuf>,
    /// The folder of the merged results, which must not exist or be empty
    #[arg(short, long, value_name = "FOLDER", value_hint = ValueHint::DirPath)]
    pub out: PathBuf,
    /// First repeat this share of the runs of each part, such as 1%, drawn at random, and compare
    /// the results; exit code 9 if one differs
    #[arg(long, value_name = "SHARE", value_parser = values::percentage)]
    pub verify: Option<f64>,
    /// Runs to repeat at a time [default: one a core]
    #[arg(long, value_name = "COUNT", requires = "verify")]
    pub threads: Option<NonZero<usize>>,
}
