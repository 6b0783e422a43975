//! `check`: executes the run of an HTML file again, and compares how it ends.

use jostle_experiment::html::{Check, HtmlFile};

use crate::arguments::CheckArguments;
use crate::failure::Failure;
use crate::output::Output;
use crate::progress;

pub fn check(output: Output, arguments: &CheckArguments) -> Result<(), Failure> {
    let path = arguments.file.display();
    let file = HtmlFile::read(&arguments.file).map_err(|error| Failure::argument(&path, error))?;
    let check = Check::of(&file).map_err(|error| Failure::argument(&path, error))?;
    let bar = progress::bar(output, Some(check.steps()), progress::STEPS, &file.name);
    let checked = check.execute(|step| {
        progress::show_step(&bar, step);
        true
    });
    bar.finish_and_clear();
    let checked = checked.map_err(|error| Failure::argument(&path, error))?;
    output.print(&checked, &checked.to_string())?;
    match checked.equal {
        true => Ok(()),
        false => Err(Failure::new(
            "different",
            format!("the run of {path} does not end as the file states"),
        )),
    }
}
