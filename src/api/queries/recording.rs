//! `get/recordings`: the recordings that the daemon wrote; `get/recording`: a piece of one.

use jostle_proto::NodeReply;
use jostle_proto::contract::selectors;

use crate::api::context::Context;
use crate::api::incoming::Incoming;
use crate::api::responder::Responder;
use crate::convert::commands::{CommandError, DEFAULT_TIMEOUT, check_name, selector};
use crate::convert::{self, Payload};
use crate::lanes::Lane;

impl Context {
    /// Replies with all recordings, after a look at their folders.
    pub(super) fn recordings(
        &self,
        incoming: &Incoming,
        responder: &Responder,
    ) -> Result<(), CommandError> {
        incoming.no_parameters()?;
        responder.set_deadline(DEFAULT_TIMEOUT, CommandError::read_deadline, None);
        let (node, recordings, reader) = (
            self.node.clone(),
            self.recordings.clone(),
            responder.clone(),
        );
        let turn = self.turn(incoming, "");
        self.queue_read(Lane::Files, &turn, responder, move || {
            recordings.check_all();
            let result = convert::recordings(recordings.list());
            reader.complete(move || Ok(Payload::json(&NodeReply { node, result })));
        })
    }

    /// Replies with a piece of a recording, if the client may record.
    pub(super) fn recording(
        &self,
        incoming: &Incoming,
        responder: &Responder,
    ) -> Result<(), CommandError> {
        self.rights.current().permit(&incoming.token, "record")?;
        let (mut name, mut part, mut offset) = (None, 0, 0);
        for (parameter, value) in selector(incoming.parameters(), selectors::RECORDING)? {
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
        responder.set_deadline(DEFAULT_TIMEOUT, CommandError::read_deadline, None);
        let (node, recordings, reader) = (
            self.node.clone(),
            self.recordings.clone(),
            responder.clone(),
        );
        let turn = self.turn(incoming, &name);
        self.queue_read(Lane::Files, &turn, responder, move || {
            reader.finish(recordings.piece(&name, part, offset), move |piece| {
                let result = convert::recording_piece(name, part, offset, &piece);
                Payload::json(&NodeReply { node, result })
            });
        })
    }
}
