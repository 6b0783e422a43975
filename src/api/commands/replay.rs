//! `replay`: uploads a recording in pieces, or opens one as a swarm that plays it.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::verbs::OwnVerb;
use jostle_proto::{NodeReply, OpenArgs, ReplayArgs, ReplayResult, Request, UploadArgs, keys};

use crate::api::context::{Context, Parsed, reject_preconditions};
use crate::api::responder::Responder;
use crate::convert::commands::{self, CommandError, check_name};
use crate::convert::{self, Payload};
use crate::lanes::Lane;
use crate::playback::{McapSource, ReplayError};
use crate::swarm::command::Command;
use crate::swarm::handle::{Outcome, ReplyTo};
use crate::swarm::registry::SwarmRegistry;
use crate::swarm::sender::{Creation, Origin};

/// The default timeout of opening a recording, which reads all of its index.
const OPEN_TIMEOUT: Duration = Duration::from_secs(60);

impl Context {
    pub(super) fn replay(&self, command: &Parsed<'_>) -> Result<(), CommandError> {
        match command.request.args()? {
            ReplayArgs::Upload(piece) => self.upload(piece, command),
            ReplayArgs::Open(args) => self.open(args, command),
        }
    }

    /// Stores a piece of a recording. A piece that is stored already succeeds, so its request id is
    /// not looked up.
    fn upload(&self, piece: UploadArgs, command: &Parsed<'_>) -> Result<(), CommandError> {
        let Parsed {
            request, responder, ..
        } = *command;
        reject_preconditions(request)?;
        commands::sender("replay", request)?;
        let check = || {
            check_name("name", &piece.name)?;
            jostle_convert::value::whole("offset", piece.offset)?;
            jostle_convert::value::whole("length", piece.length)?;
            let bytes = STANDARD.decode(piece.bytes.as_bytes());
            bytes.map_err(|_| CommandError::Field {
                field: "bytes",
                problem: "is not base64",
            })
        };
        let bytes = check().map_err(|error| error.within("upload".to_owned()))?;
        responder.set_deadline(
            commands::timeout(request)?,
            CommandError::node_deadline,
            None,
        );
        let (node, responder) = (self.node.clone(), responder.clone());
        let uploads = self.uploads.clone();
        self.queue_command(Lane::Recordings, &command.turn, move || {
            let received = uploads.receive(&piece.name, piece.offset, piece.length, &bytes);
            responder.finish(received, move |uploaded| {
                let result = ReplayResult {
                    uploaded: Some(uploaded),
                    replay: None,
                };
                Payload::json(&NodeReply { node, result })
            });
        })
    }

    fn open(&self, args: OpenArgs, command: &Parsed<'_>) -> Result<(), CommandError> {
        let begun = self.begin::<ReplayArgs>("replay", command, OPEN_TIMEOUT, |_| true)?;
        if begun.is_none() {
            return Ok(());
        }
        let within = |error: CommandError| error.within("open".to_owned());
        check_name("name", &args.name).map_err(within)?;
        if let Some(recording) = &args.recording {
            check_name("recording", recording).map_err(within)?;
        }
        let (node, responder) = (self.node.clone(), command.responder.clone());
        let registry = self.registry.clone();
        let (uploads, recordings) = (self.uploads.clone(), self.recordings.clone());
        let identity = command.identity();
        let has_identity = identity.is_some();
        let creation = command.creation("replay");
        let task = Self::creation(
            &command.turn,
            identity.as_ref(),
            command.responder,
            move |_| {
                let source = match &args.recording {
                    Some(name) => {
                        let parts = recordings.parts(name).into_iter();
                        let is_mcap = |it: &PathBuf| it.extension().is_some_and(|it| it == "mcap");
                        match parts.filter(is_mcap).collect::<Vec<_>>() {
                            none if none.is_empty() => Err(ReplayError::Unknown(name.clone())),
                            parts => McapSource::open(&parts, &read_command),
                        }
                    }
                    None => uploads.open_upload(&args.name, &read_command),
                };
                match source {
                    Ok(source) if responder.commits() || has_identity => {
                        play(&registry, node, (&args.name, creation), source, &responder);
                    }
                    Ok(_) => {}
                    Err(error) => responder.reject(&error.into(), None),
                }
            },
        );
        Ok(self.lanes.submit(Lane::Files, task)?)
    }
}

/// Plays a recording, and replies once its first state is published.
fn play(
    registry: &Arc<SwarmRegistry>,
    node: String,
    (name, creation): (&str, Creation),
    source: McapSource,
    responder: &Responder,
) {
    let frames = source.index().len();
    // A file may have any text in place of the name, and the list of swarms is one message.
    let origin = source.origin();
    let swarm = origin.swarm.filter(|it| keys::is_name(it));
    let creation = Creation {
        origin: Some(Origin { swarm, ..origin }),
        ..creation
    };
    let answer = || {
        let (responder, swarm) = (responder.clone(), name.to_owned());
        ReplyTo::new(move |answered| {
            responder.respond(answered, move |stamp, outcome| match outcome {
                Outcome::State(seen) => {
                    let result = ReplayResult {
                        uploaded: None,
                        replay: seen.replay.as_ref().map(convert::replay),
                    };
                    Payload::json(&NodeReply { node, result })
                }
                other => convert::outcome(&swarm, &stamp, other, None),
            });
        })
    };
    tracing::debug!(name, frames, "opened a recording");
    if let Err(error) = registry.play(name, Box::new(source), creation, answer) {
        responder.reject(&error.into(), None);
    }
}

/// Parses a recorded command.
fn read_command(verb: &str, args: &str) -> Result<Command, String> {
    let request = Request::from_json(args.as_bytes()).map_err(|error| error.to_string())?;
    // Of what a swarm gave itself, a recording has only the conditions that held.
    let read = match OwnVerb::of(verb) {
        Some(OwnVerb::Fired) => commands::own(OwnVerb::Fired, &request),
        Some(OwnVerb::Deadline | OwnVerb::Lost | OwnVerb::Control | OwnVerb::Idle) | None => {
            commands::read(verb, &request).map(|(message, _)| message.command)
        }
    };
    read.map_err(|error| error.to_string())
}
