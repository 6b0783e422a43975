//! The arguments of `export` and `check`.

use std::path::PathBuf;

use clap::{Args, ValueHint};
use clap_complete::engine::ArgValueCompleter;

use crate::completion;

/// Where what is exported comes from, for the help text.
const SOURCES: &str = "\
What can be exported:
  jostle export school -o school.html                 # a swarm, from its start to its current step
  jostle export order.toml --run 17 -o run.html       # a run, which is executed now
  jostle export results --run 17 -o run.html          # a run that `jostled run -o results` executed
  jostle export school.mcap -o school.html            # a recording, whose frames are in the file

A folder of results comes before a swarm of its name.

The file needs no network and no daemon. It has the commands or the experiment, the wasm module
that steps swarms, and the state hash at the end: the browser computes it and says whether it is
equal, as `jostle check FILE` does without a browser.";

#[derive(Debug, Args)]
#[command(after_help = SOURCES)]
pub struct ExportArguments {
    /// A swarm; or an experiment file, .toml, a folder of its results, or a recording, .mcap
    #[arg(value_name = "SWARM|FILE|FOLDER", value_hint = ValueHint::AnyPath, add = ArgValueCompleter::new(completion::swarms))]
    pub what: String,
    /// The output, FILE.html
    #[arg(short, long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub out: PathBuf,
    /// Of an experiment: the run, by its number, from 1, or by its name [default: 1]
    #[arg(long, value_name = "RUN")]
    pub run: Option<String>,
    /// Leave out the wasm module; the file then plays frames of the run, which is executed for them
    #[arg(long)]
    pub no_engine: bool,
    /// The wasm module, compressed by gzip [default: the installed one, share/jostle/jostle.wasm.gz]
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, conflicts_with = "no_engine")]
    pub wasm: Option<PathBuf>,
    /// Replace an existing file
    #[arg(long)]
    pub force: bool,
}

#[derive(Debug, Args)]
pub struct CheckArguments {
    /// The HTML file that `export` wrote
    #[arg(value_hint = ValueHint::FilePath)]
    pub file: PathBuf,
}
