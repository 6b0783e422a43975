//! The arguments of `claims`.

use std::num::NonZero;
use std::path::PathBuf;

use clap::{Args, ValueHint};

/// Which results to hold against the paper's claims, or against bands.
#[derive(Debug, Args)]
pub struct ClaimsArguments {
    /// Folders with results, results.parquet or results.csv
    #[arg(required = true, value_hint = ValueHint::AnyPath)]
    pub results: Vec<PathBuf>,
    /// The folder of the animations' results, which tell of contacts
    #[arg(long, value_name = "FOLDER", value_hint = ValueHint::DirPath)]
    pub animations: Option<PathBuf>,
    /// Write a page of it all, its figures in a folder of the same name beside it
    #[arg(long, value_name = "FILE.md", value_hint = ValueHint::FilePath)]
    pub page: Option<PathBuf>,
    /// Hold means against these bands instead; exit code 9 if one lies outside
    #[arg(long, value_name = "FILE.csv", value_hint = ValueHint::FilePath, conflicts_with_all = ["page", "animations"])]
    pub bands: Option<PathBuf>,
    /// Make such bands of what these results measured
    #[arg(long, value_name = "FILE.csv", value_hint = ValueHint::FilePath, conflicts_with_all = ["page", "animations", "bands"])]
    pub make_bands: Option<PathBuf>,
    /// How many runs of a condition the bands are for
    #[arg(
        long,
        value_name = "COUNT",
        requires = "make_bands",
        default_value = "16"
    )]
    pub runs: NonZero<usize>,
}
