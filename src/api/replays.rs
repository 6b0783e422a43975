//! Recordings shown as swarms: taken in, opened, sought through.

use std::path::PathBuf;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::{NodeReply, OpenArgs, ReplayArgs, ReplayResult, Request, SeekArgs, keys};

use crate::api::commands::{self, CommandError, check_name, seek};
use crate::api::context::Clerk;
use crate::api::copies::refuse_when;
use crate::api::responder::{Asked, Keeper, Promise};
use crate::convert::{self, Payload};
use crate::playback::film::Film as _;
use crate::playback::{Reel, ReplayError};
use crate::swarm::handle::Ticket;
use crate::swarm::order::Order;
use crate::swarm::outcome::{Answer, Outcome, Refusal};
use crate::swarm::registry::{Host, Showing};

/// How long a recording may take to be opened before its asker hears that it takes longer.
const PATIENCE: Duration = Duration::from_secs(60);

impl Clerk {
    /// Takes a piece of a recording in, or shows one.
    pub(crate) fn replay(&self, promise: &Promise, request: &Request) -> Result<(), CommandError> {
        refuse_when(request)?;
        commands::sender("replay", request)?;
        match request.args()? {
            ReplayArgs::Upload(piece) => {
                let within = |error: CommandError| error.within("upload".to_owned());
                check_name("name", &piece.name).map_err(within)?;
                let whole = |field, number| {
                    jostle_convert::value::whole(field, number).map_err(CommandError::from)
                };
                whole("offset", piece.offset).map_err(within)?;
                whole("length", piece.length).map_err(within)?;
                let bytes = STANDARD.decode(piece.bytes.as_bytes()).map_err(|_| {
                    within(CommandError::Field {
                        field: "bytes",
                        problem: "is not base64",
                    })
                })?;
                promise.keep_within(commands::timeout(request)?, CommandError::deadline, || None);
                let (uploads, node) = (self.uploads.clone(), self.node.clone());
                self.errands.hand_in(promise, move |_, keeper| {
                    match uploads.take_in(&piece.name, piece.offset, piece.length, &bytes) {
                        Ok(uploaded) => keeper.leave().keep(move || {
                            Ok(told(
                                node,
                                ReplayResult {
                                    uploaded: Some(uploaded),
                                    replay: None,
                                },
                            ))
                        }),
                        Err(error) => keeper.leave().refuse(&error.into(), None),
                    }
                });
                Ok(())
            }
            ReplayArgs::Open(args) => self.open_replay(promise, request, args),
        }
    }

    fn open_replay(
        &self,
        promise: &Promise,
        request: &Request,
        args: OpenArgs,
    ) -> Result<(), CommandError> {
        let within = |error: CommandError| error.within("open".to_owned());
        check_name("name", &args.name).map_err(within)?;
        if let Some(recording) = &args.recording {
            check_name("recording", recording).map_err(within)?;
        }
        let patience = match request.timeout_secs {
            Some(_) => commands::timeout(request)?,
            None => PATIENCE,
        };
        let key = keys::node_cmd(&self.prefix, &self.node, "replay");
        let is_new = self.enter(&key, request, promise)?;
        promise.keep_within(patience, CommandError::deadline, || None);
        if !is_new {
            return Ok(());
        }
        let (host, node, keeper) = (
            self.host.clone(),
            self.node.clone(),
            Keeper::new(promise.clone()),
        );
        let (uploads, recordings) = (self.uploads.clone(), self.recordings.clone());
        let opened = thread::Builder::new().name("replay".into()).spawn(move || {
            let reel = match &args.recording {
                Some(name) => {
                    let parts = recordings.parts(name).into_iter();
                    let is_mcap = |it: &PathBuf| it.extension().is_some_and(|it| it == "mcap");
                    match parts.filter(is_mcap).collect::<Vec<_>>() {
                        none if none.is_empty() => Err(ReplayError::Unknown(name.clone())),
                        parts => Reel::open(&parts, &read_order),
                    }
                }
                None => uploads.reel(&args.name, &read_order),
            };
            match reel {
                Ok(reel) => show(&host, node, &args.name, reel, keeper),
                Err(error) => keeper.leave().refuse(&error.into(), None),
            }
        });
        opened.map(drop).map_err(|_| CommandError::Busy)
    }

    /// Has a recording go somewhere.
    pub(crate) fn seek(&self, swarm: &Arc<str>, asked: &Asked) {
        let query = &asked.query;
        let promise = self
            .desk
            .promise(asked, query.key_expr().as_str().to_owned());
        let read = self.request(query).and_then(|request| {
            refuse_when(&request)?;
            let to = seek::seek(request.args::<SeekArgs>()?)?;
            let sender = Arc::new(commands::sender("seek", &request)?);
            Ok((to, sender, commands::timeout(&request)?))
        });
        let (to, sender, timeout) = match read {
            Ok(read) => read,
            Err(error) => {
                let step = self.host.find(swarm).and_then(|handle| handle.step());
                return promise.refuse(&error, step);
            }
        };
        let name = swarm.clone();
        let patience = (timeout, CommandError::deadline as fn(f64) -> CommandError);
        self.send(swarm, &promise, patience, |answer| {
            Ticket::Seek(
                to,
                sender,
                Box::new(move |answered| {
                    answer(answered, move |place, outcome| {
                        convert::outcome(&name, &place, outcome, None)
                    });
                }),
            )
        });
    }
}

/// Shows it, and answers when it can be seen.
fn show(host: &Arc<Host>, node: String, name: &str, reel: Reel, keeper: Keeper) {
    let frames = reel.marks().len();
    let showing = Showing {
        recipe: reel.recipe().clone(),
        most_individuals: reel.most_individuals(),
        bytes: reel.bytes(),
        film: Box::new(reel),
    };
    let promise = keeper.leave();
    let owed = promise.clone();
    let answer = move || -> Answer {
        let keeper = Keeper::new(owed);
        Box::new(move |answered| match answered {
            Ok((_, Outcome::Seen(seen))) => keeper.0.fulfil(move || {
                Ok(told(
                    node,
                    ReplayResult {
                        uploaded: None,
                        replay: seen.replay.as_ref().map(convert::replay),
                    },
                ))
            }),
            Ok(_) => keeper.0.refuse(&CommandError::Internal, None),
            Err(Refusal { step, error }) => keeper.0.refuse(&error.into(), step),
        })
    };
    tracing::debug!(name, frames, "opened a recording");
    if let Err(error) = host.show(name, showing, answer) {
        promise.refuse(&error.into(), None);
    }
}

fn told(node: String, result: ReplayResult) -> Payload {
    Payload::json(&NodeReply { node, result })
}

/// What a recorded command ordered.
fn read_order(verb: &str, args: &str) -> Result<Order, String> {
    let request = Request::from_json(args.as_bytes()).map_err(|error| error.to_string())?;
    let command = commands::read(verb, &request).map_err(|error| error.to_string())?;
    Ok(command.order)
}
