//! `record`: the recordings that the daemon writes.

use jostle_convert::WireError;
use jostle_proto::{DEFAULT_MAX_RECORDING_BYTES, NodeReply, RecordArgs, RecordingFormat};
use tracing::info;

use crate::api::context::{Context, Parsed};
use crate::api::responder::Responder;
use crate::convert::commands::{CommandError, check_name};
use crate::convert::{self, Payload};
use crate::health::RecordingCounts;
use crate::lanes::{Lane, Task};
use crate::recording::{Phase, RecordError, Recordings, Source, Status};
use crate::swarm::handle::{Message, Outcome, Rejection, ReplyTo};

impl Context {
    pub(super) fn record(
        &self,
        command: &Parsed<'_>,
        args: RecordArgs,
    ) -> Result<(), CommandError> {
        check(&args)?;
        let (node, responder) = (self.node.clone(), command.responder.clone());
        let recordings = self.recordings.clone();
        let client = command.request.client.clone();
        match args {
            RecordArgs::Begin(args) => {
                let is_same = |name: &String| *name == args.swarm;
                let mut contests = self.peers.contests().into_iter();
                let contest = contests.find(|(swarm, _)| swarm.as_ref().is_none_or(is_same));
                if let Some((swarm, claimants)) = contest {
                    return Err(CommandError::Contested { swarm, claimants });
                }
                let handle = self.find(&args.swarm)?;
                let tapped = handle.clone();
                let status = Status {
                    every: args.every,
                    steps_left: args.steps,
                    drop_when_behind: args.drop_when_behind,
                    max_bytes: Some(args.max_bytes.unwrap_or(DEFAULT_MAX_RECORDING_BYTES)),
                    temporary: args.temporary,
                    ..Status::new(args.swarm)
                };
                let (lanes, turn) = (self.lanes.clone(), command.turn.clone());
                handle.send(Message::Query(ReplyTo::new(
                    move |answered| match answered {
                        Ok((_, Outcome::State(now))) => {
                            let source = Source::subscribe(&tapped, &now, &status);
                            let begun = responder.clone();
                            let task = Task::new(&turn, move |_| {
                                let name = args.recording.as_deref();
                                let begun_as = recordings.begin(name, status, source);
                                log(&begun_as, client.as_deref(), "started to record");
                                reply(&begun, node, begun_as);
                            });
                            if lanes.submit(Lane::Recordings, task).is_err() {
                                responder.reject(&CommandError::Busy, None);
                            }
                        }
                        Ok(_) => responder.reject(&CommandError::Internal, None),
                        Err(Rejection { step, error }) => responder.reject(&error.into(), step),
                    },
                )));
            }
            RecordArgs::Stop(args) => {
                return self.queue_command(Lane::Recordings, &command.turn, move || {
                    let stopped = recordings.stop(&args.recording);
                    let stopped = stopped.map(|it| (args.recording, it));
                    log(&stopped, client.as_deref(), "stopped");
                    reply(&responder, node, stopped);
                });
            }
            RecordArgs::Delete(args) => {
                return self.queue_command(Lane::Recordings, &command.turn, move || {
                    let deleted = recordings.delete(&args.recording);
                    let deleted = deleted.map(|it| (args.recording, it));
                    log(&deleted, client.as_deref(), "deleted");
                    reply(&responder, node, deleted);
                });
            }
        }
        Ok(())
    }
}

/// Rejects arguments out of range.
fn check(args: &RecordArgs) -> Result<(), CommandError> {
    let (action, checked) = match args {
        RecordArgs::Begin(args) => {
            let mut named = args.recording.iter();
            let checked = check_name("swarm", &args.swarm)
                .and_then(|()| named.try_for_each(|it| check_name("recording", it)))
                .and_then(|()| is_mcap(args.format))
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

/// Rejects the format that only earlier versions recorded.
fn is_mcap(format: Option<RecordingFormat>) -> Result<(), CommandError> {
    match format {
        None | Some(RecordingFormat::Mcap) => Ok(()),
        Some(RecordingFormat::Parquet) => Err(CommandError::Field {
            field: "format",
            problem: "parquet is no longer recorded by the daemon: leave it out for MCAP, or record \
                      with `jostle record SWARM -o FILE.parquet`",
        }),
    }
}

/// Rejects 0 where something is counted.
fn positive(field: &'static str, number: Option<u64>) -> Result<(), CommandError> {
    match number {
        Some(0) => Err(WireError::out_of_range(field, 0).into()),
        Some(number) => Ok(jostle_convert::value::whole(field, number).map(drop)?),
        None => Ok(()),
    }
}

fn log(done: &Result<(String, Status), RecordError>, client: Option<&str>, what: &str) {
    if let Ok((name, status)) = done {
        info!(recording = name, swarm = status.swarm, client, "{what}");
    }
}

fn reply(responder: &Responder, node: String, done: Result<(String, Status), RecordError>) {
    responder.finish(done, move |(name, standing)| {
        let result = convert::recording(name, standing);
        Payload::json(&NodeReply { node, result })
    });
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
