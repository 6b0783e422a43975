//! `jostle`: arguments in, one request to a daemon, a table or JSON out.

mod arguments;
mod bus;
mod completion;
mod failure;
mod file;
mod format;
mod interrupt;
mod nearest;
mod output;
mod screen;
mod selection;
mod table;
mod values;
mod verbs;

use std::process::ExitCode;

use crate::arguments::Arguments;
use crate::failure::Failure;
use crate::output::Output;

fn main() -> ExitCode {
    completion::complete_if_asked();
    let arguments = match Arguments::read(std::env::args_os()) {
        Ok(arguments) => arguments,
        Err(error) => return output::usage(&error),
    };
    let output = Output {
        json: arguments.global.json,
    };
    match carry_out(arguments, output) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => output.failure(&failure),
    }
}

/// Runs a verb to its end, or until interrupted.
fn carry_out(arguments: Arguments, output: Output) -> Result<(), Failure> {
    // zenoh refuses to live on a current-thread runtime.
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .map_err(Failure::Output)?;
    let context = runtime.enter();
    interrupt::catch_interrupts();
    if verbs::records_to_file(&arguments.verb) {
        interrupt::catch_endings();
    }
    drop(context);
    let grace = verbs::grace(&arguments.verb);
    let outcome = runtime.block_on(interrupt::watched(grace, verbs::execute(arguments, output)));
    verbs::give_back_the_terminal();
    // A thread may still wait for a name server or a reader that never comes.
    runtime.shutdown_background();
    outcome
}
