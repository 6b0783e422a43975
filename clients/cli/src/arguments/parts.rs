//! The arguments of the verbs about parts of an experiment, which several machines execute.

use std::num::NonZero;
use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum, ValueHint};

use crate::values;

#[derive(Debug, Args)]
pub struct PlanArguments {
    /// The experiment file, TOML
    #[arg(value_hint = ValueHint::FilePath)]
    pub file: PathBuf,
    /// Number of parts, of nearly equal expected time [default: 1]
    #[arg(long, value_name = "COUNT", value_parser = values::nonzero, conflicts_with = "secs")]
    pub parts: Option<NonZero<usize>>,
    /// Expected seconds of a part on one core; determines the number of parts
    #[arg(long, value_name = "SECS", value_parser = values::seconds)]
    pub secs: Option<f64>,
    /// Plan only what these folders lack, which are folders of parts or contain them. With --parts:
    /// the incomplete parts, with their numbers. Without: the missing runs, split again
    #[arg(long, value_name = "FOLDER", num_args = 1.., value_hint = ValueHint::DirPath)]
    pub missing: Vec<PathBuf>,
    /// Print a Slurm script of a job array, or a line of JSON for each part, instead of a table
    #[arg(long, value_enum)]
    pub emit: Option<Emit>,
    /// The folder in which the printed commands write parts [default: NAME-parts, from the
    /// experiment's name]
    #[arg(short, long, value_name = "FOLDER", value_hint = ValueHint::DirPath)]
    pub out: Option<String>,
}

/// The formats of `experiment plan --emit`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Emit {
    /// A batch script for `sbatch`.
    Slurm,
    /// A line of JSON for each part, with its command.
    Jsonl,
}

#[derive(Debug, Args)]
#[command(arg_required_else_help = true, subcommand_value_name = "WHAT")]
pub struct ResultsVerbArguments {
    #[command(subcommand)]
    pub what: Results,
}

#[derive(Debug, Subcommand)]
pub enum Results {
    /// Merges the parts of an experiment that several machines executed
    Merge(MergeArguments),
}

#[derive(Debug, Args)]
pub struct MergeArguments {
    /// The folders of all parts, as `jostled run --part` wrote them, or one folder that contains them
    #[arg(required = true, value_name = "FOLDER", value_hint = ValueHint::DirPath)]
    pub parts: Vec<PathBuf>,
    /// The folder of the merged results, which must be empty or not exist
    #[arg(short, long, value_name = "FOLDER", value_hint = ValueHint::DirPath)]
    pub out: PathBuf,
    /// First execute a random share of the runs of each part again, such as 1%, and compare the
    /// results; exit code 9 if one differs
    #[arg(long, value_name = "SHARE", value_parser = values::percentage)]
    pub verify: Option<f64>,
    /// Number of runs to verify in parallel [default: number of cores]
    #[arg(long, value_name = "COUNT", value_parser = values::nonzero, requires = "verify")]
    pub threads: Option<NonZero<usize>>,
}
