//! The arguments of `claims`.

use std::num::NonZero;
use std::path::PathBuf;

use clap::{Args, ValueHint};

use crate::values;

#[derive(Debug, Args)]
pub struct ClaimsArguments {
    /// Folders with results, results.parquet or results.csv
    #[arg(required = true, value_hint = ValueHint::AnyPath)]
    pub results: Vec<PathBuf>,
    /// The folder with the results of the animations, which contain contacts
    #[arg(long, value_name = "FOLDER", value_hint = ValueHint::DirPath)]
    pub animations: Option<PathBuf>,
    /// Write a Markdown page, and its figures into a folder of the same name next to it
    #[arg(long, value_name = "FILE.md", value_hint = ValueHint::FilePath)]
    pub page: Option<PathBuf>,
    /// Compare means with these bands instead; exit code 9 if one is outside
    #[arg(long, value_name = "FILE.csv", value_hint = ValueHint::FilePath, conflicts_with_all = ["page", "animations"])]
    pub bands: Option<PathBuf>,
    /// Write such bands from these results
    #[arg(long, value_name = "FILE.csv", value_hint = ValueHint::FilePath, conflicts_with_all = ["page", "animations", "bands"])]
    pub make_bands: Option<PathBuf>,
    /// The number of runs per condition that the bands are for
    #[arg(
        long,
        value_name = "COUNT",
        requires = "make_bands",
        value_parser = values::nonzero,
        default_value = "16"
    )]
    pub runs: NonZero<usize>,
}
