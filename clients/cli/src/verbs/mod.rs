//! The verbs: each sends requests made from its arguments and prints the replies.

mod auth;
mod batch;
mod check;
mod claims;
mod create;
mod delete;
mod diff;
mod doctor;
mod events;
mod experiment;
mod export;
mod fork;
mod help;
mod individuals;
mod inspect;
mod outage;
mod plot;
mod record;
mod replay;
mod restore;
mod results;
mod run;
mod schema;
mod shell;
mod snapshot;
mod steer;
mod verify;
mod wait;
mod watch;
mod when;
mod which;

use crate::arguments::{
    Arguments, AuthArguments, AuthVerb, Experiment, ExperimentArguments, GlobalArguments,
    MeasuresArguments, RecordArguments, SchemaArguments, Verb,
};
use crate::connect::connect;
use crate::context::Context;
use crate::failure::{Failure, Kind};
use crate::interrupt;
use crate::output::Output;
pub use crate::verbs::watch::restore_terminal;

/// Executes a verb.
pub async fn execute(arguments: Arguments, output: Output) -> Result<(), Failure> {
    let Arguments { global, verb } = arguments;
    // These need no daemon, or connect themselves.
    let verb = match verb {
        Verb::Completions(arguments) => return shell::completions(output, &arguments),
        Verb::Man(arguments) => return shell::man(output, &arguments),
        Verb::Help(arguments) => return help::help(output, &arguments),
        Verb::Claims(arguments) => return claims::compare(output, &arguments),
        Verb::Check(arguments) => return check::check(output, &arguments),
        Verb::Export(arguments) => match export::without_daemon(output, &arguments)? {
            true => return Ok(()),
            false => Verb::Export(arguments),
        },
        Verb::Measures(MeasuresArguments { name: None, .. }) => {
            return inspect::list_measures(output);
        }
        Verb::Results(arguments) => return results::results(output, &arguments.what),
        Verb::Schema(SchemaArguments { message: Some(it) }) if it == jostle_experiment::SCHEMA => {
            return schema::of_file(output);
        }
        Verb::Experiment(ExperimentArguments {
            what: Experiment::Plan(arguments),
        }) => return experiment::plan(output, &arguments),
        Verb::Experiment(ExperimentArguments {
            what: Experiment::Run(arguments),
        }) if arguments.dry_run => return experiment::dry_run(output, &arguments),
        Verb::Auth(AuthArguments {
            what: AuthVerb::Link { page: Some(page) },
        }) => return auth::link_to(output, &global, &page),
        Verb::Doctor => return interrupt::either(doctor::doctor(output, global)).await,
        Verb::Record(RecordArguments {
            recover: Some(file),
            force,
            ..
        }) => return record::recover(output, &file, force),
        Verb::Plot(arguments) => match plot::without_daemon(output, &arguments)? {
            true => return Ok(()),
            false => Verb::Plot(arguments),
        },
        verb => verb,
    };
    let records = records_to_file(&verb);
    match connected(global, output, verb).await {
        Err(Failure {
            kind: Kind::Interrupted,
            ..
        }) if records => Err(Failure::interrupted_leaving("nothing was recorded")),
        outcome => outcome,
    }
}

/// Whether a verb records to a file, which it completes before it ends.
fn records_to_file(verb: &Verb) -> bool {
    let Verb::Record(arguments) = verb else {
        return false;
    };
    arguments.name.is_some() && arguments.out.is_some()
}

/// Whether a verb writes files whose temporary ones it removes when it is interrupted.
pub fn writes_files(verb: &Verb) -> bool {
    match verb {
        Verb::Experiment(arguments) => {
            matches!(&arguments.what, Experiment::Results(results) if results.out.is_some())
        }
        verb => records_to_file(verb),
    }
}

/// Connects, executes a verb and closes the session.
async fn connected(global: GlobalArguments, output: Output, verb: Verb) -> Result<(), Failure> {
    let reply_timeout = global.timeout;
    let timeout = global.is_timeout_given.then_some(global.timeout);
    let client = interrupt::either(connect(&global, output)).await?;
    let context = Context { client, output };
    let outcome = match verb {
        // These handle interrupts themselves.
        Verb::Run(arguments) => run::run(&context, &arguments, timeout).await,
        Verb::Wait(arguments) => wait::wait(&context, &arguments, timeout).await,
        Verb::Step(arguments) => steer::step(&context, &arguments).await,
        Verb::Fork(arguments) => fork::fork(&context, &arguments).await,
        Verb::Watch(arguments) => watch::watch(&context, &arguments, reply_timeout).await,
        Verb::Record(arguments) => record::record(&context, &arguments).await,
        Verb::Experiment(arguments) => experiment::experiment(&context, &arguments.what).await,
        verb => interrupt::either(interruptible(&context, verb, timeout)).await,
    };
    if !matches!(&outcome, Err(failure) if failure.code() == "interrupted") {
        context.client.close().await;
    }
    outcome
}

/// The verbs that end at once when interrupted.
async fn interruptible(context: &Context, verb: Verb, timeout: Option<f64>) -> Result<(), Failure> {
    match verb {
        Verb::Create(arguments) => create::create(context, &arguments).await,
        Verb::List(arguments) => inspect::list(context, &arguments).await,
        Verb::Status(arguments) => inspect::status(context, &arguments.name).await,
        Verb::Parameters(arguments) => inspect::parameters(context, &arguments.name).await,
        Verb::Measures(arguments) => inspect::measures(context, &arguments).await,
        Verb::Controllers(arguments) => inspect::controllers(context, &arguments.name).await,
        Verb::Spec(arguments) => inspect::spec(context, &arguments.name).await,
        Verb::Journal(arguments) => inspect::journal(context, &arguments).await,
        Verb::Audit(arguments) => inspect::audit(context, &arguments).await,
        Verb::Nodes => inspect::nodes(context).await,
        Verb::Top(arguments) => inspect::top(context, &arguments).await,
        Verb::Events(arguments) => events::events(context, &arguments).await,
        Verb::Pause(arguments) => steer::pause(context, &arguments).await,
        Verb::Reset(arguments) => steer::reset(context, &arguments).await,
        Verb::Set(arguments) => steer::set(context, &arguments).await,
        Verb::Leave(arguments) => steer::leave(context, &arguments).await,
        Verb::Annotate(arguments) => steer::annotate(context, &arguments).await,
        Verb::When(arguments) => when::when(context, &arguments).await,
        Verb::Protect(arguments) => steer::protect(context, &arguments).await,
        Verb::Delete(arguments) => delete::delete(context, &arguments).await,
        Verb::Inform(arguments) => individuals::inform(context, &arguments).await,
        Verb::Uninform(arguments) => individuals::uninform(context, &arguments).await,
        Verb::Inject(arguments) => individuals::inject(context, &arguments).await,
        Verb::Remove(arguments) => individuals::remove(context, &arguments).await,
        Verb::Batch(arguments) => batch::batch(context, &arguments).await,
        Verb::Snapshot(arguments) => snapshot::snapshot(context, &arguments).await,
        Verb::Restore(arguments) => restore::restore(context, &arguments).await,
        Verb::Export(arguments) => export::of_daemon(context, &arguments).await,
        Verb::Verify(arguments) => verify::verify(context, &arguments.name, timeout).await,
        Verb::Replay(arguments) => replay::replay(context, &arguments).await,
        Verb::Seek(arguments) => replay::seek(context, &arguments).await,
        Verb::Auth(arguments) => auth::auth(context, &arguments.what).await,
        Verb::Diff(arguments) => diff::diff(context, &arguments).await,
        Verb::Plot(arguments) => plot::of_daemon(context, &arguments).await,
        Verb::Schema(arguments) => schema::schema(context, &arguments).await,
        Verb::Run(_)
        | Verb::Wait(_)
        | Verb::Step(_)
        | Verb::Fork(_)
        | Verb::Watch(_)
        | Verb::Record(_)
        | Verb::Experiment(_)
        | Verb::Claims(_)
        | Verb::Check(_)
        | Verb::Results(_)
        | Verb::Doctor
        | Verb::Completions(_)
        | Verb::Man(_)
        | Verb::Help(_) => {
            unreachable!("these are executed elsewhere")
        }
    }
}
