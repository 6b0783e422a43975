//! Recordings on the bus: what is to be done with them, and how they stand.

use std::sync::Arc;

use jostle_convert::WireError;
use jostle_proto::{DEFAULT_MAX_RECORDING_BYTES, NodeReply, RecordArgs, Request, keys};
use tracing::warn;

use crate::api::commands::{self, CommandError, DEFAULT_TIMEOUT, check_name, selector};
use crate::api::context::Clerk;
use crate::api::copies::refuse_when;
use crate::api::experiments::Errands;
use crate::api::responder::{Asked, Keeper, Promise};
use crate::convert::{self, Payload};
use crate::health::RecordingCounts;
use crate::recording::{OnFailed, Phase, RecordError, Recordings, Source, Standing, Wanted};
use crate::swarm::handle::Ticket;
use crate::swarm::outcome::{OrderError, Outcome, Refusal};
use crate::swarm::registry::Host;
use crate::transport::zenoh::query::token;

impl Clerk {
    /// Does what is asked for with a recording.
    pub(crate) fn record(&self, promise: &Promise, request: &Request) -> Result<(), CommandError> {
        refuse_when(request)?;
        commands::sender("record", request)?;
        let args: RecordArgs = request.args()?;
        check(&args)?;
        let timeout = commands::timeout(request)?;
        let key = keys::node_cmd(&self.prefix, &self.node, "record");
        let is_new = self.enter(&key, request, promise)?;
        promise.keep_within(timeout, CommandError::deadline, || None);
        if !is_new {
            return Ok(());
        }
        let (errands, node) = (self.to_record.clone(), self.node.clone());
        match args {
            RecordArgs::Begin(args) => {
                if let Some(contest) = self.claims.contest_of(&args.swarm) {
                    return Err(contest.into());
                }
                let Some(handle) = self.host.find(&args.swarm) else {
                    return Err(CommandError::UnknownSwarm(args.swarm));
                };
                let (keeper, tapped) = (Keeper::new(promise.clone()), handle.clone());
                handle.send(Ticket::Look(Box::new(move |answered| match answered {
                    Ok((_, Outcome::Seen(now))) => {
                        let choice = (args.every, args.steps, args.drop_when_behind);
                        let source = Source::tap(&tapped, &now, choice, 0);
                        errands.hand_in(&keeper.leave(), move |recordings, keeper| {
                            let wanted = Wanted {
                                name: args.recording,
                                format: convert::recording_format(args.format),
                                max_bytes: args.max_bytes.unwrap_or(DEFAULT_MAX_RECORDING_BYTES),
                                temporary: args.temporary,
                            };
                            answer(keeper, node, recordings.begin(&wanted, source));
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

    /// Answers with a piece of a recording, if the sender may record.
    pub(crate) fn recording(&self, asked: &Asked, promise: &Promise) -> Result<(), CommandError> {
        self.rights
            .current()
            .permit(&token(&asked.query), "record")?;
        let parameters = asked.query.parameters();
        let (mut name, mut part, mut offset) = (None, 0, 0);
        for (parameter, value) in selector(parameters.iter(), &["name", "part", "offset"])? {
            let number = |field| {
                let wrong = |_| CommandError::Field {
                    field,
                    problem: "is not a whole number",
                };
                value.parse().map_err(wrong)
            };
            match parameter {
                "name" => name = Some(value.to_owned()),
                "part" => part = number("part")?,
                _ => offset = number("offset")?,
            }
        }
        let name = name.ok_or(CommandError::Field {
            field: "name",
            problem: "is missing: get/recordings lists the recordings",
        })?;
        check_name("name", &name)?;
        promise.keep_within(DEFAULT_TIMEOUT, CommandError::deadline, || None);
        let node = self.node.clone();
        self.to_record.hand_in(promise, move |recordings, keeper| {
            match recordings.piece(&name, part, offset) {
                Ok(piece) => keeper.leave().keep(move || {
                    let result = convert::recording_piece(name, part, offset, &piece);
                    Ok(Payload::json(&NodeReply { node, result }))
                }),
                Err(error) => keeper.leave().refuse(&error.into(), None),
            }
        });
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
                .and_then(|()| positive("every", args.every))
                .and_then(|()| positive("steps", args.steps))
                .and_then(|()| positive("max_bytes", args.max_bytes));
            ("begin", checked)
        }
        RecordArgs::Stop(args) => ("stop", check_name("recording", &args.recording)),
        RecordArgs::Delete(args) => ("delete", check_name("recording", &args.recording)),
    };
    checked.map_err(|error: CommandError| error.within(action.to_owned()))
}

/// Refuses a number that is given and counts nothing.
fn positive(field: &'static str, number: Option<u64>) -> Result<(), CommandError> {
    match number {
        Some(0) => Err(WireError::out_of_range(field, 0).into()),
        Some(number) => Ok(jostle_convert::value::whole(field, number).map(drop)?),
        None => Ok(()),
    }
}

fn answer(keeper: Keeper, node: String, done: Result<(String, Standing), RecordError>) {
    match done {
        Ok((name, standing)) => keeper.leave().fulfil(move || {
            let result = convert::recording(name, standing);
            Ok(Payload::json(&NodeReply { node, result }))
        }),
        Err(error) => keeper.leave().refuse(&error.into(), None),
    }
}

/// Publishes a failed recording as an event of its swarm, if that is still there.
pub fn publish_failure(host: Arc<Host>) -> OnFailed {
    Box::new(move |swarm, recording, reason| {
        if let Some(handle) = host.find(swarm) {
            handle.send(Ticket::RecordingFailed(recording.into(), reason.into()));
        }
    })
}

/// Counts the recordings for health and metrics.
pub fn count(recordings: &Recordings) -> RecordingCounts {
    let mut counts = RecordingCounts::default();
    for (name, standing) in recordings.list() {
        match standing.phase {
            Phase::Recording => counts.recording += 1,
            Phase::Ended => counts.ended += 1,
            Phase::Failed => {
                let reason = standing.reason.unwrap_or_default();
                counts.failed.push((name, reason));
            }
        }
    }
    counts
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
                let Standing {
                    every,
                    steps_left,
                    drop_when_behind,
                    missed,
                    ..
                } = standing;
                let choice = (every, steps_left, drop_when_behind);
                let source = Source::tap(&tapped, &now, choice, missed);
                go_on(Some(source));
            }
            Err(Refusal {
                error: OrderError::Gone,
                ..
            }) => go_on(None),
            // It goes on when the daemon restarts.
            _ => warn!(recording = name, "its swarm does not answer"),
        })));
    }
}
