//! Recordings on the bus: what is to be done with them, and how they stand.

use std::sync::Arc;

use jostle_proto::{NodeReply, RecordArgs, Request, keys};
use tracing::warn;

use crate::command::{self, CommandError, check_name};
use crate::host::Host;
use crate::recording::{RecordError, Recordings, Source, Standing};
use crate::server::answer::{Keeper, Promise};
use crate::server::clerk::Clerk;
use crate::server::copies::refuse_when;
use crate::server::experiments::Errands;
use crate::swarm::handle::Ticket;
use crate::swarm::outcome::{OrderError, Outcome, Refusal};
use crate::wire::{self, Payload, WireError};

impl Clerk {
    /// Does what is asked for with a recording.
    pub(super) fn record(&self, promise: &Promise, request: &Request) -> Result<(), CommandError> {
        refuse_when(request)?;
        command::sender("record", request)?;
        let args: RecordArgs = request.args()?;
        check(&args)?;
        let timeout = command::timeout(request)?;
        let key = keys::node_cmd(&self.prefix, &self.node, "record");
        let is_new = self.enter(&key, request, promise)?;
        promise.keep_within(timeout, CommandError::deadline, || None);
        if !is_new {
            return Ok(());
        }
        let (errands, node) = (self.to_record.clone(), self.node.clone());
        match args {
            RecordArgs::Begin(args) => {
                let Some(handle) = self.host.find(&args.swarm) else {
                    return Err(CommandError::UnknownSwarm(args.swarm));
                };
                let (keeper, tapped) = (Keeper::new(promise.clone()), handle.clone());
                handle.send(Ticket::Look(Box::new(move |answered| match answered {
                    Ok((_, Outcome::Seen(now))) => {
                        let source = Source::tap(&tapped, &now, args.every, 0);
                        errands.hand_in(&keeper.leave(), move |recordings, keeper| {
                            let name = args.recording.as_deref();
                            let format = wire::recording_format(args.format);
                            let begun = recordings.begin(name, format, args.every, source);
                            answer(keeper, node, begun);
                        });
                    }
                    Ok(_) => keeper.0.refuse(&CommandError::Internal, None),
                    Err(Refusal { step, error }) => keeper.0.refuse(&error.into(), step),
                })));
            }
            RecordArgs::Stop(args) => errands.hand_in(promise, move |recordings, keeper| {
                let stopped = recordings.stop(&args.recording);
                answer(keeper, node, stopped.map(|it| (args.recording, it)));
            }),
            RecordArgs::Delete(args) => errands.hand_in(promise, move |recordings, keeper| {
                let deleted = recordings.delete(&args.recording);
                answer(keeper, node, deleted.map(|it| (args.recording, it)));
            }),
        }
        Ok(())
    }
}

/// Refuses arguments that cannot be.
fn check(args: &RecordArgs) -> Result<(), CommandError> {
    let (action, checked) = match args {
        RecordArgs::Begin(args) => {
            let mut named = args.recording.iter();
            let checked = check_name("swarm", &args.swarm)
                .and_then(|()| named.try_for_each(|it| check_name("recording", it)))
                .and_then(|()| match args.every {
                    Some(0) => Err(WireError::out_of_range("every", 0).into()),
                    Some(every) => Ok(wire::whole("every", every).map(drop)?),
                    None => Ok(()),
                });
            ("begin", checked)
        }
        RecordArgs::Stop(args) => ("stop", check_name("recording", &args.recording)),
        RecordArgs::Delete(args) => ("delete", check_name("recording", &args.recording)),
    };
    checked.map_err(|error: CommandError| error.within(action.to_owned()))
}

fn answer(keeper: Keeper, node: String, done: Result<(String, Standing), RecordError>) {
    match done {
        Ok((name, standing)) => keeper.leave().fulfil(move || {
            let result = wire::recording(name, standing);
            Ok(Payload::json(&NodeReply { node, result }))
        }),
        Err(error) => keeper.leave().refuse(&error.into(), None),
    }
}

/// Has the recordings go on that went on when the daemon ended.
pub fn go_on(recordings: &Recordings, errands: &Errands<Recordings>, host: &Arc<Host>) {
    for (name, standing) in recordings.interrupted() {
        let go_on = {
            let (errands, name) = (errands.clone(), name.clone());
            move |source| errands.run(move |recordings| recordings.go_on(&name, source))
        };
        let Some(handle) = host.find(&standing.swarm) else {
            go_on(None);
            continue;
        };
        let tapped = handle.clone();
        handle.send(Ticket::Look(Box::new(move |answered| match answered {
            Ok((_, Outcome::Seen(now))) => {
                let source = Source::tap(&tapped, &now, standing.every, standing.missed);
                go_on(Some(source));
            }
            Err(Refusal {
                error: OrderError::Gone,
                ..
            }) => go_on(None),
            // It goes on when the daemon starts anew.
            _ => warn!(recording = name, "its swarm does not answer"),
        })));
    }
}
