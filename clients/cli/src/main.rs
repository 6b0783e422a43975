//! `jostle`: reads arguments, sends requests to a daemon, prints a table or JSON.

// A binary: its functions have one error type, and its items are not public API.
#![allow(missing_docs, clippy::missing_errors_doc)]

mod arguments;
mod bound;
mod completion;
mod connect;
mod context;
mod failure;
mod file;
#[cfg(test)]
mod fixtures;
mod format;
mod instant;
mod interrupt;
mod narrow;
mod output;
mod progress;
mod screen;
mod selection;
mod stdout;
mod suggest;
mod table;
mod units;
mod values;
mod verbs;

use std::process::ExitCode;

use crate::arguments::Arguments;
use crate::failure::Failure;
use crate::output::Output;

fn main() -> ExitCode {
    completion::complete_if_requested(arguments::command);
    let arguments = match Arguments::read(std::env::args_os()) {
        Ok(arguments) => arguments,
        Err(error) => return output::usage(&error),
    };
    let output = Output {
        json: arguments.global.json,
    };
    match execute(arguments, output) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => output.failure(&failure),
    }
}

/// Runs a verb to its end, or until interrupted.
fn execute(arguments: Arguments, output: Output) -> Result<(), Failure> {
    // zenoh panics on a current-thread runtime.
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .map_err(Failure::output)?;
    let context = runtime.enter();
    interrupt::catch_interrupts();
    if verbs::writes_files(&arguments.verb) {
        interrupt::catch_termination();
    }
    drop(context);
    let outcome = runtime.block_on(interrupt::run_interruptible(move || {
        verbs::execute(arguments, output)
    }));
    verbs::restore_terminal();
    // A thread may still block in a name lookup or in a write to stdout, and a verb that did not end in
    // time still runs: it would panic in a runtime that is shut down.
    std::mem::forget(runtime);
    outcome
}
