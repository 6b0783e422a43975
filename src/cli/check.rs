//! `jostled check`: executes the run of an HTML file again.

use std::error::Error;
use std::io::IsTerminal as _;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use jostle_experiment::html::{Check, Checked, HtmlFile};
use jostle_experiment::stdout;
use serde_json::json;

use crate::cli::{fail, printed};

/// The exit code if the run ends otherwise than the file states.
const EXIT_DIFFERENT: u8 = 1;

/// The exit code if there is nothing to compare.
const EXIT_UNCHECKED: u8 = 2;

/// The number of steps between updates of the progress bar.
const UPDATE_STEPS: u64 = 100;

/// Execute the run of an HTML file of `jostle export` again, and compare how it ends.
#[derive(Args, Clone, Debug)]
pub struct Options {
    /// The HTML file.
    file: PathBuf,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Checks a file, prints the result and returns the exit code.
pub fn run(options: &Options) -> ExitCode {
    let checked = match check(options) {
        Ok(checked) => checked,
        Err(error) => {
            let path = options.file.display();
            return fail(EXIT_UNCHECKED, &format_args!("{path}: {error}"));
        }
    };
    let text = match options.json {
        true => format!("{}\n", json!(checked)),
        false => format!("{checked}\n"),
    };
    let code = printed(stdout::write(text.as_bytes()));
    match checked.equal {
        true => code,
        false => ExitCode::from(EXIT_DIFFERENT),
    }
}

fn check(options: &Options) -> Result<Checked, Box<dyn Error>> {
    let check = Check::of(&HtmlFile::read(&options.file)?)?;
    let bar = match std::io::stderr().is_terminal() && !options.json {
        true => ProgressBar::with_draw_target(Some(check.steps()), ProgressDrawTarget::stderr()),
        false => ProgressBar::hidden(),
    };
    let template = "{bar:30} {percent:>3} %  {eta} left";
    bar.set_style(ProgressStyle::with_template(template).expect("a constant"));
    let checked = check.execute(|step| {
        if step.is_multiple_of(UPDATE_STEPS) {
            bar.set_position(step);
        }
        true
    });
    bar.finish_and_clear();
    Ok(checked?)
}
